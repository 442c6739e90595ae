"""States of a user's environment: by its own `get_state` and `set_state`, or by deep copies."""

from __future__ import annotations

import copy
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import gymnasium


@dataclass(frozen=True)
class OwnState:
    """What an environment with `get_state` and `set_state` came to.

    Args:
        state: What its `get_state` returned.
        layers: Attributes of each wrapper, outermost first; of the environment itself its random
            generator.
    """

    state: Any
    layers: list[dict[str, Any]]


def saves_itself(env: gymnasium.Env) -> bool:
    """Whether the innermost environment has `get_state()` and `set_state(state)`."""
    return all(callable(getattr(env.unwrapped, name, None)) for name in ("get_state", "set_state"))


def saved(env: gymnasium.Env) -> Any:
    """Return the state of an environment and its wrappers; later steps do not change it."""
    if not saves_itself(env):
        return copy.deepcopy(env)
    return OwnState(copy.deepcopy(env.unwrapped.get_state()), _layers(env))  # type: ignore[attr-defined]


def restored(env: gymnasium.Env, state: Any) -> gymnasium.Env:
    """Return the environment that goes on from a state: this one, or a copy of the saved one.

    Args:
        env: An environment like the one that was saved.
        state: What `saved` returned.
    """
    if not isinstance(state, OwnState):
        return copy.deepcopy(state)
    env.unwrapped.set_state(copy.deepcopy(state.state))  # type: ignore[attr-defined]
    layer: Any = env
    for attributes in copy.deepcopy(state.layers):
        vars(layer).update(attributes)
        layer = getattr(layer, "env", layer)
    return env


def _layers(env: gymnasium.Env) -> list[dict[str, Any]]:
    """Return the attributes of each wrapper, and the innermost environment's generator."""
    layers = []
    layer: Any = env
    inner = env.unwrapped
    while layer is not inner:
        kept: Mapping[str, Any] = {k: v for k, v in vars(layer).items() if k != "env"}
        layers.append(copy.deepcopy(kept, {id(inner): inner}))
        layer = layer.env
    layers.append(copy.deepcopy({k: vars(inner).get(k) for k in ("_np_random", "_np_random_seed")}))
    return [dict(attributes) for attributes in layers]
