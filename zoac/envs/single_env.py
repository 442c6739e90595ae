"""A user's single environment: made, copied, what its spaces say and what its methods return."""

import copy
import inspect
from collections.abc import Callable, Iterator
from typing import Any

import gymnasium
import numpy as np
from gymnasium.spaces import Box, Discrete
from gymnasium.vector import VectorEnv
from gymnasium.wrappers import ClipAction, NormalizeObservation, NormalizeReward, TimeLimit

from zoac.core.errors import (
    ConfigError,
    EnvironmentContractError,
    EnvironmentFailure,
    ZoacError,
    as_text,
)
from zoac.envs.plant_numbers import lost_number

EnvSource = str | gymnasium.Env | Callable[[], gymnasium.Env]
"""What a user gives as an environment: an id, an environment, or what makes one."""


def single_env(source: EnvSource) -> gymnasium.Env:
    """Make an environment from what a user gives; an object is copied.

    Raises:
        ConfigError: If it cannot be made, or is no `gymnasium.Env`.
    """
    if isinstance(source, gymnasium.Env):
        return copy_of(source)
    made: Any = source
    if isinstance(source, str) or (callable(source) and not isinstance(source, VectorEnv)):
        try:
            made = gymnasium.make(source) if isinstance(source, str) else source()
        except ZoacError:
            raise
        except Exception as error:  # whatever a user's constructor raises
            raise ConfigError(
                f"env={source!r}: making it raised {as_text(error)}; expected the "
                "id of a Gymnasium environment, or a function without arguments that makes one"
            ) from error
    if isinstance(made, gymnasium.Env):
        return made
    remedy = "an environment of the old Gym must be wrapped"
    if isinstance(made, VectorEnv):
        remedy = "give a single environment, of which as many are made as are needed"
    raise ConfigError(
        f"env={source!r}: {'it is' if made is source else 'it makes'} {made!r}, expected a "
        f"gymnasium.Env; {remedy}"
    )


def copy_of(env: gymnasium.Env) -> gymnasium.Env:
    """Return a copy of an environment object with the same numbers.

    Raises:
        ConfigError: If it cannot be copied, or its copy has other numbers: some are built anew
            from the arguments that made them.
    """
    remedy = "give a function that makes the environment instead, such as env=make_env"
    try:
        twin = copy.deepcopy(env)
    except Exception as error:  # whatever a user's environment raises when it is copied
        raise ConfigError(
            f"env={env}: every environment needs a copy, and copying raised "
            f"{as_text(error)}; {remedy}"
        ) from error
    if (name := lost_number(env, twin)) is not None:
        found, value = getattr(twin.unwrapped, name, None), getattr(env.unwrapped, name)
        raise ConfigError(
            f"env={env}: every environment needs a copy, and in a copy {name!r} is {found!r}, not "
            f"{value!r}; {remedy}"
        )
    return twin


def check_reset(env: gymnasium.Env) -> None:
    """See that an environment and its wrappers can be reset with a seed.

    Raises:
        ConfigError: If one cannot.
    """
    layer: Any = env
    while layer is not None:
        if not takes(layer.reset, seed=0):
            raise ConfigError(
                f"{type(layer).__name__}.reset{inspect.signature(layer.reset)} takes no seed, "
                "without which no episode can be repeated; expected reset(self, *, seed=None, "
                "options=None), which calls super().reset(seed=seed) and draws from self.np_random"
            )
        layer = layer.env if isinstance(layer, gymnasium.Wrapper) else None


def takes(function: Callable[..., Any], *arguments: Any, **options: Any) -> bool:
    """Tell whether a function can be called with such arguments; True where nothing tells."""
    try:
        signature = inspect.signature(function)
    except (TypeError, ValueError):  # of C, say
        return True
    try:
        signature.bind(*arguments, **options)
    except TypeError:
        return False
    return True


def remarks(env: gymnasium.Env) -> Iterator[str]:
    """Yield a remark for each space that is put in a row, and wrapper with running statistics."""
    spaces = (("observations", env.observation_space), ("actions", env.action_space))
    for what, space in spaces:
        if isinstance(space, Box) and len(space.shape) > 1:
            size = int(np.prod(space.shape))
            yield f"{what} of shape {space.shape} are {size} numbers to the controller, row by row"
    while isinstance(env, gymnasium.Wrapper):
        if isinstance(env, NormalizeReward | NormalizeObservation) and env.update_running_mean:
            what = "costs" if isinstance(env, NormalizeReward) else "observations"
            yield (
                f"{type(env).__name__} scales by running statistics, so the same episode gives "
                f"other {what} later in the run, and environments differ: remove the wrapper, or "
                "set its update_running_mean to False once its statistics are final"
            )
        env = env.env


def own_time_limit(env: gymnasium.Env) -> int | None:
    """Return the time limit that an environment brings along, if it has one."""
    limits = [env.spec.max_episode_steps] if env.spec else []
    while isinstance(env, gymnasium.Wrapper):
        if isinstance(env, TimeLimit):
            limits.append(env._max_episode_steps)
        env = env.env
    return min((limit for limit in limits if limit is not None), default=None)


def env_actions(space: gymnasium.Space, actions: np.ndarray) -> np.ndarray | list[int]:
    """Return controllers' actions (n, m) as environments take them, one a row.

    Args:
        space: Their action space: Discrete, where the nearest action counts, or Box, whose bounds
            clip; of whole numbers the nearest counts.
        actions: What the controllers returned.
    """
    if isinstance(space, Discrete):
        nearest = np.clip(np.rint(actions[:, 0]) - space.start, 0, space.n - 1)
        return [int(space.start + k) for k in nearest]
    assert isinstance(space, Box)
    whole = space.dtype.kind in "iu"
    actions = (np.rint(actions) if whole else actions).reshape(-1, *space.shape)
    low, high = space.low.astype(np.float64), space.high.astype(np.float64)
    return np.minimum(np.maximum(actions, low), high).astype(space.dtype)


def env_action(space: gymnasium.Space, action: np.ndarray) -> Any:
    """Return one controller's action (m,) as its environment takes it; see `env_actions`."""
    return env_actions(space, action[None])[0]


def applied_action_space(env: gymnasium.Env) -> gymnasium.Space:
    """Return the space of actions that an environment applies: within a ClipAction, its bounds."""
    inner = env
    while isinstance(inner, gymnasium.Wrapper):
        if isinstance(inner, ClipAction):
            return applied_action_space(inner.env)
        of_gymnasium = type(inner).__module__.startswith("gymnasium.wrappers.")
        if isinstance(inner, gymnasium.ActionWrapper) or not of_gymnasium:
            break  # it may take actions in other units
        inner = inner.env
    return env.action_space


_PARTS = {
    "reset": ("observation", "info"),
    "step": ("observation", "reward", "terminated", "truncated", "info"),
}


def parts_of(result: Any, method: str) -> tuple[Any, ...]:
    """Return what an environment's method returned, if it has the parts that Gymnasium asks for.

    Raises:
        EnvironmentContractError: If it has not.
    """
    expected = _PARTS[method]
    if isinstance(result, tuple) and len(result) == len(expected) and isinstance(result[-1], dict):
        return result
    found = f"{len(result)} values" if isinstance(result, tuple) else type(result).__name__
    raise EnvironmentContractError(
        f"the environment's {method} returned {found}, expected ({', '.join(expected)}), info a "
        "dict; an environment of the old Gym must be wrapped"
    )


def is_true(value: Any, what: str) -> bool:
    """Return a truth value that an environment's step returned; None counts as False.

    Raises:
        EnvironmentContractError: If it is none.
    """
    array = np.asarray(value is not None and value)
    if array.size != 1 or array.dtype.kind not in "biuf":
        raise EnvironmentContractError(
            f"the environment's step returned {value!r} as {what}, expected True or False"
        )
    return bool(array.reshape(()))


def not_finite(observation: np.ndarray) -> EnvironmentFailure:
    """Return the failure of an environment with such an observation."""
    return EnvironmentFailure(
        f"the environment returned the observation {observation.tolist()}; every number must be "
        "finite"
    )
