"""The state of an environment on MuJoCo, by MuJoCo's own functions."""

from __future__ import annotations

import copy
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any
from weakref import WeakKeyDictionary

import gymnasium
import numpy as np


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


def get_state(inner: Any) -> MujocoState:
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


def set_state(inner: Any, state: MujocoState) -> None:
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
