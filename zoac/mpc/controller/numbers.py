"""The numbers of an MPC by name: values, and bounds within which a tuner may move them."""

import math
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from zoac.core.errors import ConfigError, suggest
from zoac.core.types import is_number


class Numbers:
    """Values by name, in groups; a controller's parameters replace those that are tuned."""

    def __init__(self) -> None:
        self.values: dict[str, float] = {}
        self._groups: dict[str, list[str]] = {}
        self._least: dict[str, float] = {}

    def add(self, group: str, name: str, value: Any, least: float = -math.inf) -> str:
        """Add one number; return its name.

        Raises:
            ConfigError: If it is no finite number from `least`, or the name is taken.
        """
        _check(name, value, least)
        if name in self.values:
            raise ConfigError(f"{name} would be two numbers of this MPC; rename one of the model's")
        self.values[name], self._least[name] = float(value), least
        self._groups.setdefault(group, []).append(name)
        return name

    def check(self, parameters: Mapping[str, Any]) -> None:
        """See that parameters are numbers of this MPC, in the range of each.

        Raises:
            ConfigError: If one is not.
        """
        for name, value in parameters.items():
            self._value("parameters", name, self.values)
            _check(name, value, self._least[name])

    def rows(self, params: Mapping[str, np.ndarray], n: int) -> dict[str, np.ndarray]:
        """Return every number for n environments (n,): the parameter of that name, or its value."""
        return {
            name: np.asarray(params[name], np.float64) if name in params else np.full(n, value)
            for name, value in self.values.items()
        }

    def space(
        self, names: Iterable[str], within: float, bounds: Mapping[str, Any]
    ) -> dict[str, dict[str, Any]]:
        """Return a space for `zoac.tune`; see `zoac.mpc.Mpc.space`."""
        known = [*self.values, *self._groups]
        if not (is_number(within) and within > 1):
            raise ConfigError(f"within={within!r}: expected a factor above 1")
        found: dict[str, dict[str, Any]] = {}
        for name in names:
            for member in self._groups.get(name, [name]):
                value = self._value("space", member, known)
                ends = sorted((value / within, value * within))
                if value != 0.0:
                    found[member] = dict(zip(("low", "high"), ends, strict=True), scale="log")
                elif member == name:
                    raise ConfigError(f"{name} is 0, no scale for bounds; give space({name}=(...))")
        for name, given in bounds.items():
            self._value("space", name, known)
            by_place = zip(("low", "high", "scale", "unit"), given, strict=False)
            found[name] = dict(given if isinstance(given, Mapping) else by_place)
        for name, fields in found.items():
            fields.setdefault("baseline", self.values[name])
            if not fields["low"] <= fields["baseline"] <= fields["high"]:
                raise ConfigError(
                    f"space: {name} is {fields['baseline']:g} now, outside [{fields['low']:g}, "
                    f"{fields['high']:g}]; widen the bounds, or build the MPC with a value inside"
                )
        if not found:
            raise ConfigError(f"space: name what is tuned; known: {', '.join(sorted(known))}")
        return found

    def _value(self, what: str, name: str, known: Iterable[str]) -> float:
        if name not in self.values:
            raise ConfigError(f"{what}: this MPC has no number {name!r}; {suggest(name, known)}")
        return self.values[name]


def _check(name: str, value: Any, least: float) -> None:
    if not (is_number(value) and math.isfinite(value) and value >= least):
        from_least = "" if least == -math.inf else f" from {least:g}"
        raise ConfigError(f"{name}={value!r}: expected a finite number{from_least}")


def by_name(what: str, given: Any, known: Iterable[str]) -> dict[str, Any]:
    """Return a mapping whose keys are all known.

    Raises:
        ConfigError: If it is no mapping, or names something else.
    """
    if given is None:
        return {}
    known = list(known)
    if not isinstance(given, Mapping):
        raise ConfigError(f"{what}={given!r}: expected values by name: {', '.join(known)}")
    for name in given:
        for part in name if isinstance(name, tuple) else (name,):
            if part not in known:
                raise ConfigError(f"{what}: unknown {part!r}; {suggest(str(part), known)}")
    return dict(given)
