"""A user's own `gymnasium.Env` as a vectorised environment: n copies, stepped in turn."""

import contextlib
import copy
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import gymnasium
import numpy as np
from gymnasium.spaces import Box, Discrete

from zoac.core.errors import (
    ConfigError,
    EnvironmentContractError,
    EnvironmentFailure,
    ZoacError,
    as_text,
)
from zoac.core.seeding import stream
from zoac.core.state import OwnObject
from zoac.core.types import all_finite, is_number
from zoac.envs.base import VecEnv, Watch
from zoac.envs.objective import Objective
from zoac.envs.plant_numbers import Bounds, PlantNumbers
from zoac.envs.single_env import (
    applied_action_space,
    check_reset,
    env_actions,
    is_true,
    not_finite,
    own_time_limit,
    parts_of,
    remarks,
)
from zoac.envs.snapshots import restored, saved, saved_by
from zoac.specs.signals import INFO, INFO_BEFORE

MAX_EPISODE_STEPS = 10_000
"""Steps after which an episode that nothing limits is an error."""


class GymnasiumVecEnv(VecEnv):
    """n copies of a `gymnasium.Env`, stepped one after the other; see `zoac.envs.snapshots`."""

    def __init__(
        self,
        envs: Sequence[gymnasium.Env],
        max_episode_steps: int | None,
        plant: Mapping[str, float] | None = None,
        vary: Mapping[str, Bounds] | None = None,
        make: Callable[[], gymnasium.Env] | None = None,
        objective: str = "auto",
        info: Sequence[str] = (),
    ) -> None:
        """
        Args:
            envs: The copies.
            max_episode_steps: Cut episodes here; None: where the environment's own limit does. An
                environment without either must end by itself within `MAX_EPISODE_STEPS` steps.
            plant: Attributes of the innermost environment, and the numbers they are set to before
                every reset.
            vary: Likewise, and the range (low, high) from which every episode draws uniformly.
            make: Makes an environment in place of one that raised; None: that one is reset.
            objective: Which signal is the cost; see `zoac.envs.objective.Objective`.
            info: Keys of the environments' info whose numbers a step reports as `measured`.

        Raises:
            ConfigError: If its spaces are of a kind that cannot be tuned on, or it has no such
                attribute.
        """
        first = envs[0]
        check_reset(first)
        if len({id(env.unwrapped) for env in envs}) < len(envs):
            raise ConfigError(
                f"env: what makes an environment returned the same {type(first.unwrapped).__name__}"
                " again; expected a new one at every call"
            )
        if not isinstance(first.observation_space, Box):
            raise ConfigError(
                f"the environment's observations are {first.observation_space}; expected a Box "
                "(wrap it, for instance with gymnasium.wrappers.FlattenObservation)"
            )
        if not isinstance(first.action_space, Box | Discrete):
            raise ConfigError(
                f"the environment's actions are {first.action_space}; expected a Box or Discrete"
            )
        size = int(np.prod(first.observation_space.shape))
        flat = int(np.prod(first.action_space.shape or ()))
        observations, actions = (Box(-np.inf, np.inf, (k,), np.float64) for k in (size, flat))
        limits = [max_episode_steps, own_time_limit(first)]
        limit = min((steps for steps in limits if steps is not None), default=None)
        super().__init__(len(envs), observations, actions, limit or MAX_EPISODE_STEPS)
        self.limited = limit is not None
        self.remarks = tuple(remarks(first))
        self.saved_by = saved_by(first)
        self._envs = list(envs)
        self._taken = applied_action_space(first)
        self._make, self._objective = make, Objective(objective)
        self._info = {key: np.zeros(len(envs)) for key in dict.fromkeys(info)}
        self._numbers = PlantNumbers(first, plant or {}, vary or {})
        for env in self._envs:
            self._numbers.put(env, self._numbers.fixed)
        self._episode_numbers = [self._numbers.fixed] * len(envs)
        self._begun = np.zeros(len(envs), bool)  # whether it was reset ever
        self._draws: list[np.random.Generator] = [np.random.default_rng(0) for _ in envs]
        self._seen = np.zeros((len(envs), size))
        self._row_shape, self._dtype = (size,), first.observation_space.dtype
        self._watch: Watch | None = None

    def watch(self, watch: Watch) -> None:
        self._watch = watch

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """See `VecEnv.reset`.

        Raises:
            ConfigError: If the environment's reset puts its own number where `plant` or `vary` put
                another.
            EnvironmentContractError: If it breaks the rules of Gymnasium's interface.

        Infos name each environment that raised or gave an observation that is not finite in
        `failures`, env_index -> `EnvironmentFailure`.
        """
        failures: dict[int, EnvironmentFailure] = {}
        inner = {k: v for k, v in (options or {}).items() if k != "reset_mask"}
        for env_index, env_seed in self._to_reset(seed, options):
            # Many environments hand their seed to libraries that take 32 bits.
            short = None if env_seed is None else int(env_seed) % 2**31
            if env_seed is not None and self._numbers.drawn:
                self._draws[env_index] = stream(int(env_seed), "plant")
            numbers = self._numbers.draw(self._draws[env_index])
            self._numbers.put(self._envs[env_index], numbers)  # a step may have changed them
            self._episode_numbers[env_index], self._begun[env_index] = numbers, True
            self._steps[env_index] = 0
            try:
                told = {"options": inner} if inner else {}
                result = self._call(env_index, "reset", seed=short, **told)
                observation, told_info = parts_of(result, "reset")
                self._numbers.check(self._envs[env_index], numbers)
                flat = self._flat(observation)
                if not all_finite(flat):
                    raise not_finite(flat)
                self._seen[env_index] = flat
                self._measure(env_index, told_info, "reset")
            except EnvironmentFailure as failure:
                failures[env_index] = failure
        return self._seen.copy(), {"failures": failures}

    def step(
        self, actions: np.ndarray, mask: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """See `VecEnv.step`.

        Raises:
            ConfigError: If an episode that nothing limits does not end.
            EnvironmentContractError: If the environment breaks the rules of Gymnasium's interface.

        Infos name each environment that raised, or gave an observation or a cost that is not
        finite, in `failures`, env_index -> `EnvironmentFailure`; it reports cost 0 and no end.
        """
        n = self.num_envs
        failures: dict[int, EnvironmentFailure] = {}
        costs, terminated, truncated = np.zeros(n), np.zeros(n, bool), np.zeros(n, bool)
        taken = env_actions(self._taken, actions)
        applied = np.array(taken, dtype=np.float64).reshape(actions.shape)
        measured = {INFO_BEFORE + key: numbers.copy() for key, numbers in self._info.items()}
        self._steps += 1 if mask is None else mask
        steps, seen = self._steps.tolist(), self._seen.copy()
        for env_index in range(n) if mask is None else np.flatnonzero(mask).tolist():
            try:
                result = self._call(env_index, "step", taken[env_index])
                observation, reward, ended, cut, info = parts_of(result, "step")
                seen[env_index] = self._flat(observation)
                if self._info:
                    self._measure(env_index, info, "step")
                costs[env_index] = self._objective.cost(reward, info, steps[env_index])
            except EnvironmentFailure as failure:
                failures[env_index] = failure
                continue
            if not (isinstance(ended, bool) and isinstance(cut, bool)):
                ended, cut = is_true(ended, "terminated"), is_true(cut, "truncated")
            over_time = steps[env_index] >= self.max_episode_steps
            if over_time and not (self.limited or ended or cut):
                raise ConfigError(
                    f"an episode has not ended after {self.max_episode_steps:,} steps; the "
                    "environment needs a time limit: give max_episode_steps"
                )
            if ended:
                terminated[env_index] = True
            elif cut or over_time:
                truncated[env_index] = True
        if not all_finite(seen):
            for env_index in np.flatnonzero(~np.isfinite(seen).all(axis=1)).tolist():
                failures[env_index] = not_finite(seen[env_index])
                seen[env_index] = self._seen[env_index]
                costs[env_index], terminated[env_index], truncated[env_index] = 0.0, False, False
        self._seen = seen
        measured |= {INFO + key: numbers.copy() for key, numbers in self._info.items()}
        infos = {"cost": costs, "failures": failures, "actions": applied, "measured": measured}
        return seen.copy(), -costs, terminated, truncated, infos

    def _call(self, env_index: int, method: str, *arguments: Any, **options: Any) -> Any:
        """Call an environment's method; one that raises is replaced by a new environment.

        Raises:
            EnvironmentFailure: If it raises.
        """
        try:
            call = getattr(self._envs[env_index], method)
            if self._watch is None:
                return call(*arguments, **options)
            with self._watch(env_index, method):
                return call(*arguments, **options)
        except ZoacError:
            raise
        except Exception as error:
            if self._make is not None:
                with contextlib.suppress(Exception):  # it is broken already
                    self._envs[env_index].close()
                self._envs[env_index] = self._make()
            told = f"the environment's {method} raised {as_text(error)}"
            raise EnvironmentFailure(told) from error

    def _measure(self, env_index: int, info: Mapping[str, Any], method: str) -> None:
        """Take the numbers of `info` that are signals.

        Raises:
            EnvironmentContractError: If one is not there, or is not one number.
        """
        for key, numbers in self._info.items():
            value = info.get(key)
            if not is_number(value):
                raise EnvironmentContractError(
                    f"the environment's {method} returned {value!r} as info[{key!r}], which is a "
                    "signal; expected a number, from reset and from every step"
                )
            numbers[env_index] = value

    def _flat(self, observation: Any) -> np.ndarray:
        """Return the numbers of an observation as a row."""
        as_declared = isinstance(observation, np.ndarray) and observation.dtype == self._dtype
        if as_declared and observation.shape == self._row_shape:
            return observation
        try:
            flat = np.asarray(observation, dtype=np.float64).reshape(-1)
        except (TypeError, ValueError):
            raise EnvironmentContractError(
                f"the environment returned the observation {observation!r}, expected "
                f"{self._seen.shape[1]} numbers as its observation_space says"
            ) from None
        if flat.size != self._seen.shape[1]:
            raise EnvironmentContractError(
                f"the environment returned an observation of {flat.size} numbers, expected "
                f"{self._seen.shape[1]} as its observation_space says"
            )
        return flat

    def state(self, env_indices: Sequence[int] | np.ndarray) -> dict[str, Any]:
        rows = np.asarray(env_indices).tolist()
        return {
            # The methods of an environment that was never reset may find nothing to save.
            "envs": OwnObject(
                [
                    saved(self._envs[row]) if self._begun[row] or not self.saved_by else None
                    for row in rows
                ]
            ),
            "numbers": [self._episode_numbers[row] for row in rows],
            "draws": [copy.deepcopy(self._draws[row]) for row in rows],
            "seen": self._seen[env_indices].copy(),
            "steps": self._steps[env_indices].copy(),
            "info": {key: numbers[env_indices].copy() for key, numbers in self._info.items()},
        }

    def restore(self, env_indices: Sequence[int] | np.ndarray, state: dict[str, Any]) -> np.ndarray:
        envs, draws = state["envs"].value, state["draws"]
        rows = np.asarray(env_indices).tolist()
        for env_index, env, rng, numbers in zip(rows, envs, draws, state["numbers"], strict=True):
            self._episode_numbers[env_index], self._begun[env_index] = numbers, env is not None
            if env is not None:
                self._numbers.put(self._envs[env_index], numbers)
                self._envs[env_index] = restored(self._envs[env_index], env)
            self._draws[env_index] = copy.deepcopy(rng)
        self._seen[env_indices] = state["seen"]
        self._steps[env_indices] = state["steps"]
        for key, numbers in self._info.items():
            numbers[env_indices] = state["info"][key]
        return self._seen.copy()

    def close(self, **kwargs: Any) -> None:
        """Close every environment."""
        for env in self._envs:
            with contextlib.suppress(Exception):  # all is known of it, and the rest must be closed
                env.close()
