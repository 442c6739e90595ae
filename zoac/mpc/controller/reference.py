"""What states and inputs of an MPC shall be: constants, parts of the observation, a function."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from zoac.core.errors import ConfigError, ControllerError
from zoac.mpc.controller.numbers import Numbers, by_name


class Reference:
    """A reference of states over the horizon, and of inputs, which is constant."""

    def __init__(
        self,
        given: Mapping[str, float | slice] | Callable[[np.ndarray], Any] | None,
        states: tuple[str, ...],
        inputs: tuple[str, ...],
        horizon: int,
        numbers: Numbers,
    ) -> None:
        """
        Args:
            given: See `zoac.mpc.Mpc`.
            states: Names of the states.
            inputs: Names of the inputs.
            horizon: N.
            numbers: Gets the constants as "reference_<name>".

        Raises:
            ConfigError: If a name is unknown, or a value is neither number nor slice.
        """
        self.function = given if callable(given) else None
        """The function of observations that computes it, if one does."""
        self._shape = horizon, len(states)
        self._columns: dict[int, slice] = {}
        self._constants: list[tuple[int, str]] = []
        self._inputs: list[tuple[int, str]] = []
        entries = {} if callable(given) else by_name("reference", given, (*states, *inputs))
        for name, value in entries.items():
            if isinstance(value, slice) and name in states:
                self._columns[states.index(name)] = value
                continue
            number = numbers.add("reference", f"reference_{name}", value)
            if name in states:
                self._constants.append((states.index(name), number))
            else:
                self._inputs.append((inputs.index(name), number))
        self.of_inputs = frozenset(inputs[j] for j, _ in self._inputs)
        """Names of the inputs that have one."""
        self._count = len(inputs)
        if self.function is None and given is not None and not entries:
            raise ConfigError("reference={}: expected numbers or slices by name, or a function")

    @property
    def columns(self) -> list[slice]:
        """The parts of the observation that are references of states."""
        return list(self._columns.values())

    def of_rest(self, values: Mapping[str, np.ndarray], n: int) -> np.ndarray:
        """Return the references (n, nu) of inputs, 0 where none is given."""
        inputs = np.zeros((n, self._count))
        for j, name in self._inputs:
            inputs[:, j] = values[name]
        return inputs

    def __call__(self, obs: np.ndarray, values: Mapping[str, np.ndarray]) -> np.ndarray:
        """Return the references (n, N, nx) of states, 0 where none is given.

        Raises:
            ControllerError: If an observation or the function's answer does not fit.
        """
        n, (horizon, nx) = len(obs), self._shape
        if self.function is not None:
            found = np.asarray(self.function(obs.copy()), dtype=np.float64)
            try:
                return np.broadcast_to(found, (n, horizon, nx)).copy()
            except ValueError:
                raise ControllerError(
                    f"reference=...: the function returned {found.shape}, expected "
                    f"{(n, horizon, nx)}, or what broadcasts to it"
                ) from None
        states = np.zeros((n, horizon, nx))
        for i, name in self._constants:
            states[:, :, i] = values[name][:, None]
        for i, columns in self._columns.items():
            found = obs[:, columns]
            if found.shape[1] not in (1, horizon):
                raise ControllerError(
                    f"reference: {columns} of an observation of {obs.shape[1]} numbers are "
                    f"{found.shape[1]} columns, expected 1 or {horizon}, the horizon"
                )
            states[:, :, i] = found
        return states
