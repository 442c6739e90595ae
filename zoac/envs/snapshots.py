"""States of a user's environment: by its own methods, by MuJoCo's functions, or by deep copies."""

import copy
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any
from weakref import WeakKeyDictionary

import gymnasium
import numpy as np
from gymnasium.envs.registration import EnvSpec

from zoac.envs.single_env import takes


@dataclass(frozen=True)
class OwnState:
    """What an environment that is not copied came to.

    Args:
        state: Of the innermost environment, its random generator included.
        wrappers: Attributes of each wrapper, outermost first.
    """

    state: Any
    wrappers: list[dict[str, Any]]


def saved_by(env: gymnasium.Env) -> str:
    """Return what saves an environment's state, for messages; empty: deepcopy."""
    inner = env.unwrapped
    get, set_ = (getattr(inner, name, None) for name in ("get_state", "set_state"))
    # The `set_state` of Gymnasium's MuJoCo environments takes qpos and qvel.
    if callable(get) and callable(set_) and takes(set_, None):
        return OWN
    return "mj_getState()" if is_mujoco(inner) else ""


OWN = "get_state()"


@dataclass(frozen=True)
class MujocoState:
    """What a step of MuJoCo begins with, and what an environment may read before it.

    Args:
        integration: By `mj_getState`, all that the next steps depend on.
        computed: Arrays of `MjData` by name. They are of the last step: `mj_forward` at the
            restored positions would give others, such as body positions one step ahead.
        attributes: Numbers, text, arrays and generators of the environment itself, by name.
    """

    integration: np.ndarray
    computed: dict[str, np.ndarray]
    attributes: dict[str, Any]


def is_mujoco(inner: gymnasium.Env) -> bool:
    """Whether an innermost environment steps a `MjModel` and `MjData` that are its attributes.

    That is so for all of `gymnasium.envs.mujoco`.
    """
    if (mujoco := sys.modules.get("mujoco")) is None:  # nobody made an environment with it
        return False
    model, data = (vars(inner).get(name) for name in ("model", "data"))
    return isinstance(model, mujoco.MjModel) and isinstance(data, mujoco.MjData)


def _get_mujoco(inner: Any) -> MujocoState:
    """Return the state of an environment for which `is_mujoco` holds."""
    import mujoco

    model, data = inner.model, inner.data
    kind = mujoco.mjtState.mjSTATE_INTEGRATION
    integration = np.empty(mujoco.mj_stateSize(model, kind))
    mujoco.mj_getState(model, data, integration, kind)
    if (names := _names.get(model)) is None:
        names = _names[model] = _fixed_arrays(mujoco.MjData(model))
    computed = {name: getattr(data, name).copy() for name in names}
    kept = {name: v for name, v in vars(inner).items() if _is_plain(v)}
    return MujocoState(integration, computed, copy.deepcopy(kept))


def _set_mujoco(inner: Any, state: MujocoState) -> None:
    """Bring an environment to a state of this one, or of another that was made alike."""
    import mujoco

    kind = mujoco.mjtState.mjSTATE_INTEGRATION
    mujoco.mj_setState(inner.model, inner.data, state.integration, kind)
    for name, values in state.computed.items():
        getattr(inner.data, name)[...] = values
    vars(inner).update(copy.deepcopy(state.attributes))


_names: WeakKeyDictionary[Any, tuple[str, ...]] = WeakKeyDictionary()
"""Names of `_fixed_arrays`, by model."""


def _fixed_arrays(unused: Any) -> tuple[str, ...]:
    """Return the names of arrays of `MjData` whose size does not depend on contacts.

    Args:
        unused: A `MjData` that no step has filled: the other arrays are empty.
    """
    found = ((name, getattr(unused, name, None)) for name in dir(unused))
    return tuple(n for n, array in found if isinstance(array, np.ndarray) and array.size)


def _is_plain(value: Any) -> bool:
    if isinstance(value, Mapping):
        return all(map(_is_plain, value.values()))
    if isinstance(value, list | tuple):
        return all(map(_is_plain, value))
    kinds = (bool, int, float, str, np.ndarray, np.generic, np.random.Generator, type(None))
    return isinstance(value, kinds)


def saved(env: gymnasium.Env) -> Any:
    """Return the state of an environment and its wrappers; later steps do not change it."""
    inner: Any = env.unwrapped
    if not (how := saved_by(env)):
        return copy.deepcopy(env)
    if how == OWN:
        generator = {name: vars(inner).get(name) for name in ("_np_random", "_np_random_seed")}
        state: Any = copy.deepcopy((inner.get_state(), generator))
    else:
        state = _get_mujoco(inner)
    layers = [{k: v for k, v in vars(layer).items() if k != "env"} for layer in _wrappers(env)]
    return OwnState(state, _copied(layers, inner))


def restored(env: gymnasium.Env, state: Any) -> gymnasium.Env:
    """Return the environment that goes on from a state: this one, or a copy of the saved one.

    Args:
        env: An environment like the one that was saved.
        state: What `saved` returned, which `env` does not change later.
    """
    if not isinstance(state, OwnState):
        return copy.deepcopy(state)
    inner: Any = env.unwrapped
    if isinstance(state.state, MujocoState):
        _set_mujoco(inner, state.state)
    else:
        own, generator = copy.deepcopy(state.state)
        inner.set_state(own)
        vars(inner).update(generator)
    for layer, attributes in zip(_wrappers(env), _copied(state.wrappers, inner), strict=True):
        vars(layer).update(attributes)
    return env


def _wrappers(env: Any) -> list[Any]:
    """Return the wrappers around the innermost environment, outermost first."""
    found = []
    while env is not env.unwrapped:
        found.append(env)
        env = env.env
    return found


def _copied(layers: list[dict[str, Any]], inner: gymnasium.Env) -> list[dict[str, Any]]:
    """Return a copy of the attributes of wrappers; what never changes is not copied."""
    values = [value for attributes in layers for value in attributes.values()]
    kept = [inner, *(value for value in values if isinstance(value, EnvSpec))]
    return copy.deepcopy(layers, {id(value): value for value in kept})
