"""The controllers of an engine's environments: asked together, each with a memory of its own."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from zoac.controllers.stateful_controller import StatefulController, state_of
from zoac.core.errors import ControllerError, ZoacError, as_text, suggest
from zoac.core.state import OwnObject
from zoac.core.types import all_finite

if TYPE_CHECKING:
    from zoac.rollout.task import Task

_Answer = tuple[np.ndarray, Mapping[str, np.ndarray], Mapping[str, np.ndarray]]
"""Actions (n, m), memory and diagnostics, as `Controller.act` returns them."""


class Controllers:
    """One batched controller for n environments, and what it remembers of each."""

    def __init__(
        self,
        task: Task,
        n: int,
        action_shape: tuple[int, ...],
        parameters: Mapping[str, np.ndarray],
        place: Callable[[int], str],
        priced: Callable[[ZoacError], str],
    ) -> None:
        """
        Args:
            task: Makes the controller.
            n: Number of environments.
            action_shape: Of one action.
            parameters: Values (n,) by name, which the caller keeps up to date.
            place: Says for a message where an environment stands.
            priced: Returns what is told of a failure, or raises it.
        """
        self._controller, self._n = task.make_controller(), n
        self._action_shape = action_shape
        self._parameters, self._place, self._priced = parameters, place, priced
        self._names = (*parameters, *task.fixed)
        self._initial_memory = _copied(self._controller.init(n))
        self._memory = _copied(self._initial_memory)
        self._kinds = _kinds(self._initial_memory)
        self._objects = bool(self._stateful(0))

    def act(
        self, rows: np.ndarray, observations: np.ndarray, failures: dict[int, str]
    ) -> tuple[np.ndarray, Mapping[str, np.ndarray]]:
        """Ask for the actions of some environments.

        Args:
            rows: Which ones (k,).
            observations: Of all n environments.
            failures: Takes what is told of each that fails, where failures have a price; its
                action is zero.

        Returns:
            Actions (n, m) and diagnostics; those of environments not in `rows` are zero.

        Raises:
            ControllerError: If the controller raises or returns what is no finite action, and
                failures have no price.
        """
        if not len(rows):
            return np.zeros((self._n, *self._action_shape)), {}
        some, memory, diagnostics = self._call(rows, observations, failures)
        if len(rows) == self._n:
            self._memory = dict(memory)
            return some, diagnostics
        self._memory = _copied(self._memory)
        for name, values in memory.items():
            self._memory[name][rows] = values
        actions = _scatter(some, rows, self._n)
        return actions, {name: _scatter(v, rows, self._n) for name, v in diagnostics.items()}

    def _call(
        self, rows: np.ndarray, observations: np.ndarray, failures: dict[int, str]
    ) -> _Answer:
        """Ask the controller; with a penalty, one that fails acts with zero."""
        # Asking one environment at a time shows which one fails; only a controller without
        # objects that remember may be asked twice.
        if len(rows) == 1 or not self._objects:
            try:
                return self._checked_call(rows, observations)
            except ControllerError as error:
                raised, told = error.__cause__ is not None, str(error)
                if not raised or len(rows) == 1:
                    told = self._priced(error)
                if len(rows) == 1:
                    failures[int(rows[0])] = told
                    return np.zeros((1, *self._action_shape)), _taken(self._memory, rows), {}
        parts = []
        for k in range(len(rows)):
            actions, memory, diagnostics = self._call(rows[k : k + 1], observations, failures)
            parts.append((actions, _copied(memory), _copied(diagnostics)))
        return _joined(parts)

    def _checked_call(self, rows: np.ndarray, observations: np.ndarray) -> _Answer:
        """Ask the controller, and check that its actions can be used."""
        parameters: Mapping[str, np.ndarray] = self._parameters
        memory: Mapping[str, np.ndarray] = self._memory
        if len(rows) < self._n:
            parameters, memory = _taken(parameters, rows), _taken(memory, rows)
            observations = observations[rows]
        try:
            actions, memory, diagnostics = self._controller.act(parameters, observations, memory)
        except ZoacError:
            raise
        except Exception as error:
            raise ControllerError(
                f"the controller raised {as_text(error)}{self._nearest(error)}. "
                f"{self._place(rows[0])}"
            ) from error
        # Copied: the next call may change an array that the controller keeps.
        actions = np.array(actions, dtype=np.float64)
        expected = (len(rows), *self._action_shape)
        if actions.shape != expected:
            raise ControllerError(
                f"the controller returned actions of shape {actions.shape}, expected {expected} "
                f"(environments, action size). {self._place(rows[0])}"
            )
        if not all_finite(actions):
            finite = np.isfinite(actions).reshape(len(rows), -1).all(axis=1)
            row = int(np.flatnonzero(~finite)[0])
            raise ControllerError(
                f"the controller returned the action {actions[row].tolist()}; every number must "
                f"be finite. {self._place(rows[row])}"
            )
        self._check_memory(memory)
        return actions, memory, diagnostics

    def _check_memory(self, memory: Mapping[str, np.ndarray]) -> None:
        """See that a memory is of the kind that it began with.

        Otherwise numbers would depend on which environments act together.
        """
        found, began = _kinds(memory), self._kinds
        if found != began:
            name = next(n for n in (found | began) if found.get(n) != began.get(n))
            now, first = (
                f"{kinds[name][0]} of shape {('n', *kinds[name][1])}"
                if name in kinds
                else "nothing"
                for kinds in (found, began)
            )
            raise ControllerError(
                f"the controller's memory {name!r} is {now}, and began as {first}; it must begin "
                "as it goes on"
            )

    def _nearest(self, error: Exception) -> str:
        """Return which parameters there are, if a controller asked for one that there is not."""
        name = error.args[0] if isinstance(error, KeyError) and error.args else None
        if not isinstance(name, str) or name in self._names:
            return ""
        return f" (no parameter has this name; {suggest(name, self._names)})"

    def begin(self, row: int) -> None:
        """Have stateful controller objects begin an episode; see `StatefulController`."""
        for stateful in self._stateful(row).values():
            stateful.begin()

    def reset(self, row: int) -> None:
        """Give an environment's controller the memory of an episode's start."""
        self._remember(row, {name: v[row] for name, v in self._initial_memory.items()})
        self.begin(row)

    def snapshot(self, row: int) -> dict[str, Any]:
        """Return a copy of an environment's memory, by name."""
        return {name: state_of(rows[row]) for name, rows in self._memory.items()}

    def restore(self, row: int, snapshot: Mapping[str, Any]) -> None:
        """Restore what `snapshot` returned."""
        memory, stateful = dict(snapshot), self._stateful(row)
        for name, value in memory.items():
            if name in stateful:
                stateful[name].restore(value)
                memory[name] = stateful[name]
            elif isinstance(value, OwnObject):
                memory[name] = value.value
        self._remember(row, memory)

    def _stateful(self, row: int) -> dict[str, StatefulController]:
        """Return the controller objects that change in place, by the memory's name."""
        rows = {name: value[row] for name, value in self._initial_memory.items()}
        return {
            name: value for name, value in rows.items() if isinstance(value, StatefulController)
        }

    def _remember(self, row: int, memory: Mapping[str, Any]) -> None:
        self._memory = _copied(self._memory)
        for name, value in memory.items():
            self._memory[name][row] = value


def _joined(parts: Sequence[_Answer]) -> _Answer:
    """Return what environments answered one by one; diagnostics are zero where one failed."""
    actions = np.concatenate([a for a, _, _ in parts])
    memory = {name: np.concatenate([m[name] for _, m, _ in parts]) for name in parts[0][1]}
    examples = {name: np.asarray(value) for _, _, d in parts for name, value in d.items()}
    diagnostics = {
        name: np.concatenate([np.asarray(d.get(name, np.zeros_like(v))) for _, _, d in parts])
        for name, v in examples.items()
    }
    return actions, memory, diagnostics


def _kinds(memory: Mapping[str, np.ndarray]) -> dict[str, tuple[np.dtype, tuple[int, ...]]]:
    return {name: (values.dtype, values.shape[1:]) for name, values in memory.items()}


def _copied(arrays: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    return {name: np.array(value) for name, value in arrays.items()}


def _taken(arrays: Mapping[str, np.ndarray], rows: np.ndarray) -> dict[str, np.ndarray]:
    return {name: value[rows] for name, value in arrays.items()}


def _scatter(values: np.ndarray, rows: np.ndarray, n: int) -> np.ndarray:
    values = np.asarray(values)
    full = np.zeros((n, *values.shape[1:]), values.dtype)
    full[rows] = values
    return full
