"""States of a user's environment: by its own methods, by MuJoCo's functions, or by deep copies."""

from __future__ import annotations

import copy
import inspect
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import gymnasium
from gymnasium.envs.registration import EnvSpec

from zoac.envs import mujoco_state


@dataclass(frozen=True)
class OwnState:
    """What an environment that is not copied came to.

    Args:
        state: Of the innermost environment, its random generator included.
        wrappers: Attributes of each wrapper, outermost first.
    """

    state: Any
    wrappers: list[dict[str, Any]]


class _Methods(NamedTuple):
    """What saves and restores an innermost environment, and what messages call it.

    A state that `get` returned is changed neither by later steps nor by `set`.
    """

    get: Callable[[Any], Any]
    set: Callable[[Any, Any], None]
    name: str


def saved_by(env: gymnasium.Env) -> str:
    """Return what saves an environment's state, for messages; empty: deepcopy."""
    methods = _methods(env.unwrapped)
    return "" if methods is None else methods.name


def _methods(inner: Any) -> _Methods | None:
    """Return its own `get_state()` and `set_state(state)`, else MuJoCo's; None: neither."""
    get, set_ = (getattr(inner, name, None) for name in ("get_state", "set_state"))
    if callable(get) and callable(set_) and _takes_one(set_):
        return _OWN
    return _MUJOCO if mujoco_state.is_mujoco(inner) else None


def _takes_one(set_state: Callable[..., None]) -> bool:
    """Whether it takes a state; that of Gymnasium's MuJoCo environments takes qpos and qvel."""
    try:
        inspect.signature(set_state).bind(None)
    except TypeError:
        return False
    except ValueError:  # nothing tells its arguments
        return True
    return True


def _get_own(inner: Any) -> tuple[Any, dict[str, Any]]:
    generator = {name: vars(inner).get(name) for name in ("_np_random", "_np_random_seed")}
    return copy.deepcopy((inner.get_state(), generator))


def _set_own(inner: Any, state: tuple[Any, dict[str, Any]]) -> None:
    own, generator = copy.deepcopy(state)
    inner.set_state(own)
    vars(inner).update(generator)


_OWN = _Methods(_get_own, _set_own, "get_state()")
_MUJOCO = _Methods(mujoco_state.get_state, mujoco_state.set_state, "mj_getState()")


def saved(env: gymnasium.Env) -> Any:
    """Return the state of an environment and its wrappers; later steps do not change it."""
    inner = env.unwrapped
    if (methods := _methods(inner)) is None:
        return copy.deepcopy(env)
    layers = [{k: v for k, v in vars(layer).items() if k != "env"} for layer in _wrappers(env)]
    return OwnState(methods.get(inner), _copied(layers, inner))


def restored(env: gymnasium.Env, state: Any) -> gymnasium.Env:
    """Return the environment that goes on from a state: this one, or a copy of the saved one.

    Args:
        env: An environment like the one that was saved.
        state: What `saved` returned.
    """
    if not isinstance(state, OwnState):
        return copy.deepcopy(state)
    inner = env.unwrapped
    methods = _methods(inner)
    assert methods is not None
    methods.set(inner, state.state)
    layers = _copied(state.wrappers, inner)
    for layer, attributes in zip(_wrappers(env), layers, strict=True):
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
