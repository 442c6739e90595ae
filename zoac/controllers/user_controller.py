"""A user's own controller, whatever form it has, as a `zoac.rollout.task.Controller`."""

import copy
import inspect
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import numpy as np

from zoac.controllers.stateful_controller import StatefulController
from zoac.core.controller import Controller, Diagnostics, Memory, Parameters
from zoac.core.errors import ConfigError, as_text
from zoac.core.parameters import ParameterSpace
from zoac.envs.single_env import takes


def as_controller(given: Any, fixed: Mapping[str, float], space: ParameterSpace) -> Controller:
    """Return the controller that a user gives.

    Args:
        given: A function `act(params, obs)`; an object with such a method; a batched `Controller`,
            whose `act(params, obs, memory)` takes three arguments; a class of either; or a function
            without arguments that makes any of these.
        fixed: Parameters that are not tuned, handed on with the others.
        space: Of the tuned ones.

    Raises:
        ConfigError: If it is none of these.
    """
    made = given
    makes = inspect.isclass(given) or _makes(given)
    if makes:
        try:
            made = given()
        except Exception as error:  # whatever a user's constructor raises
            raise ConfigError(
                f"controller: calling {_name(given)} without arguments raised "
                f"{as_text(error)}; give an object, or a function without arguments "
                "that makes one"
            ) from error
    act = getattr(made, "act", made)
    if not callable(act):
        raise ConfigError(
            f"controller={given!r}: expected a function act(params, obs), an object with a method "
            f"of that name, or what makes one{f', got {made!r} from it' if makes else ''}"
        )
    if not takes(act, None, None):
        if takes(act, None, None, None) and hasattr(made, "init"):
            return WithFixed(made, fixed) if fixed else made
        raise ConfigError(
            f"controller: {_name(act)}{inspect.signature(act)} cannot be called as "
            "act(params, obs); a batched controller has act(params, obs, memory) and init(n)"
        )
    if act is made:
        owner = getattr(made, "__self__", made)
        if hasattr(owner, "reset") and not inspect.isclass(owner):
            raise ConfigError(
                f"controller: {_name(made)} belongs to an object with reset(), to be called "
                "before every episode, and each environment needs such an object of its own: give "
                "the object itself, with a method act(params, obs), or its class"
            )
        return ScalarController(made, fixed, space)
    make = given if makes else partial(_copy, given)
    return ScalarController(make, fixed, space, remembers=True)


def _makes(given: Any) -> bool:
    """Tell whether something is a function without arguments that makes a controller."""
    is_function = callable(given) and not hasattr(given, "act")
    return is_function and takes(given) and not takes(given, None, None)


def _name(thing: Any) -> str:
    return getattr(thing, "__qualname__", type(thing).__qualname__)


def _copy(controller: Any) -> Any:
    """Return a copy of a controller object, for one environment."""
    try:
        return copy.deepcopy(controller)
    except Exception as error:  # whatever a user's object raises when it is copied
        raise ConfigError(
            f"the controller, a {_name(type(controller))}, cannot be copied "
            f"({as_text(error)}), and each environment needs one of its own: "
            "give its class, or a function without arguments that makes one"
        ) from error


class ScalarController:
    """`act(params, obs)` for one environment, as a `Controller`."""

    def __init__(
        self,
        controller: Callable[..., Any],
        fixed: Mapping[str, float],
        space: ParameterSpace,
        remembers: bool = False,
    ) -> None:
        """
        Args:
            controller: A function `act(params, obs)`, where params is {name: number} and obs (o,);
                returns a number or an array (m,).
            fixed: Parameters that are not tuned, handed on with the others.
            space: Of the tuned ones, so that whole numbers come as int and options as such.
            remembers: `controller` makes an object with such a method; see `StatefulController`.
        """
        self._controller, self._remembers = controller, remembers
        self._plain = {p.name: p.plain for p in space.parameters if p.kind != "real"}
        self._fixed = dict(fixed)

    def init(self, n: int) -> Memory:
        """Return an object for each environment, if it may remember."""
        if not self._remembers:
            return {}
        rows = np.empty(n, dtype=object)
        rows[:] = [StatefulController(self._controller) for _ in range(n)]
        if len({row.identity for row in rows}) < n:
            raise ConfigError(
                "controller: what makes a controller returned the same object again, and each "
                "environment needs one of its own: make a new one at every call"
            )
        return {"controller": rows}

    def act(
        self, params: Parameters, obs: np.ndarray, memory: Memory
    ) -> tuple[np.ndarray, Memory, Diagnostics]:
        """See `Controller.act`; but objects in `memory` change in place."""
        n, names, actions = len(obs), tuple(params), []
        rows = zip(*[values.tolist() for values in params.values()], strict=True)
        own = [o.act for o in memory["controller"]] if self._remembers else [self._controller] * n
        for act, numbers, observation in zip(own, rows, obs.copy(), strict=True):
            values = dict(zip(names, numbers, strict=True))
            values |= self._fixed
            for name, plain in self._plain.items():
                values[name] = plain(values[name])
            action = act(values, observation)
            if action is None:
                raise TypeError("act returned None, expected a number or an array")
            # Copied: the next call may change an array that the controller keeps.
            actions.append(np.array(action, dtype=np.float64).reshape(-1))
        return np.array(actions), memory, {}


class WithFixed:
    """A batched `Controller` that also gets parameters that are not tuned."""

    def __init__(self, controller: Controller, fixed: Mapping[str, float]) -> None:
        self._controller, self._fixed = controller, dict(fixed)

    def init(self, n: int) -> Memory:
        """See `Controller.init`."""
        return self._controller.init(n)

    def act(
        self, params: Parameters, obs: np.ndarray, memory: Memory
    ) -> tuple[np.ndarray, Memory, Diagnostics]:
        """See `Controller.act`."""
        fixed = {name: np.full(len(obs), float(v)) for name, v in self._fixed.items()}
        return self._controller.act({**params, **fixed}, obs, memory)

    @property
    def export(self) -> Callable[..., Any]:
        """What writes the controller, if it has one; see `zoac.mpc.Mpc.export`."""
        return self._controller.export  # type: ignore[attr-defined]
