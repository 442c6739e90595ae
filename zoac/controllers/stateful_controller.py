"""A user's controller object that changes in place, one for each environment."""

import copy
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from zoac.core.state import OwnObject


class StatefulController:
    """One environment's controller object, which changes in place.

    An episode begins with its `reset()`; without that method, with a new object. Its state is
    saved by `get_state()` and `set_state(state)` if it has both, else by a deep copy.
    """

    def __init__(self, make: Callable[[], Any]) -> None:
        self._make = make
        self._object = make()
        self._used, self._begins = False, True

    @property
    def identity(self) -> int:
        """Which object it is."""
        return id(self._object)

    def begin(self) -> None:
        """Begin an episode with the next action."""
        self._begins = True

    def act(self, params: Mapping[str, Any], obs: np.ndarray) -> Any:
        """Return the action of `act(params, obs)`."""
        if self._begins:
            if hasattr(self._object, "reset"):
                self._object.reset()
            elif self._used:
                self._object = self._make()
            self._used, self._begins = True, False
        return self._object.act(params, obs)

    def state(self) -> OwnObject | None:
        """Return a copy of the state; None: an episode begins."""
        if self._begins:
            return None
        lasts = self._object.get_state() if self._has_protocol() else self._object
        return OwnObject(copy.deepcopy(lasts))

    def restore(self, state: OwnObject | None) -> None:
        """Restore what `state` returned; it is not copied again."""
        self._begins = state is None
        if state is None:
            return
        if self._has_protocol():
            if not self._used and hasattr(self._object, "reset"):
                self._object.reset()
            self._object.set_state(state.value)
        else:
            self._object = state.value
        self._used = True

    def _has_protocol(self) -> bool:
        return hasattr(self._object, "get_state") and hasattr(self._object, "set_state")


def stateful_in(memory: Mapping[str, np.ndarray]) -> list[StatefulController]:
    """Return the controller objects in a memory, of all its environments."""
    rows = (row for array in memory.values() if array.dtype == object for row in array)
    return [row for row in rows if isinstance(row, StatefulController)]


def state_of(row: Any) -> Any:
    """Return a copy of an environment's part of a memory, such as a state can hold."""
    if isinstance(row, StatefulController):
        return row.state()
    plain = isinstance(row, np.ndarray | np.generic) and not row.dtype.hasobject
    return copy.deepcopy(row) if plain else OwnObject(copy.deepcopy(row))
