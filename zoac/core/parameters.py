"""Parameters of a controller and the box they are searched in.

Tuners search the mapped box Theta_m = [-1, 1]^d (section III-C of the paper); controllers see
physical values. `ParameterSpace` is the only place that maps between the two, and the only
place that clips.

A number, real or whole, is one coordinate of the box; a choice among K options is K coordinates,
of which the largest decides, so that no order is imposed on the options. Under ZOAC's
perturbation z = theta + sigma epsilon the cost averaged over epsilon is smooth in theta for
discrete parameters too, and eq. (10) estimates its gradient: `docs/discrete.md`.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from zoac.core.errors import ConfigError, suggest
from zoac.core.types import is_number

Scale = Literal["linear", "log"]
Kind = Literal["real", "integer", "choice"]

CHOSEN = 0.1
"""Coordinate of an option that is given as a value; the others get its negative. One ordinary
perturbation (sigma = 0.1) then changes the choice now and then."""


@dataclass(frozen=True, slots=True)
class Parameter:
    """One bounded parameter.

    Args:
        name: Its name, unique in a space.
        low: Lower bound, in `unit`.
        high: Upper bound, in `unit`.
        scale: "linear" or "log": how [-1, 1] maps to [low, high]; "log" by magnitude, where both
            bounds are negative.
        unit: Unit for people to read, such as "N/rad"; empty for a pure number.
        kind: "real"; "integer": every whole number from low to high, each an equal part of
            [-1, 1]; "choice": see `choice`.
        options: What may be chosen, for a choice.

    Raises:
        ConfigError: If the bounds are not finite, not in order, or not of one sign on a log scale,
            or not whole for an integer.
    """

    name: str
    low: float
    high: float
    scale: Scale = "linear"
    unit: str = ""
    kind: Kind = "real"
    options: tuple[Any, ...] = ()

    def __post_init__(self) -> None:
        if self.kind == "choice":
            return
        where, got = f"parameter {self.name!r}", f"got [{self.low}, {self.high}]"
        if self.scale not in ("linear", "log"):
            raise ConfigError(
                f"{where}: unknown scale {self.scale!r}; {suggest(self.scale, ('linear', 'log'))}"
            )
        if not (math.isfinite(self.low) and math.isfinite(self.high)):
            raise ConfigError(f"{where}: bounds must be finite, {got}")
        if self.low >= self.high:
            raise ConfigError(f"{where}: the lower bound must be below the upper, {got}")
        if self.scale == "log" and self.low * self.high <= 0:
            raise ConfigError(
                f"{where}: a log scale needs a positive lower bound, or a negative upper one, {got}"
            )
        if self.kind == "integer" and self.scale == "log":
            raise ConfigError(f"{where}: an integer has no log scale; tune its logarithm")
        if self.kind == "integer" and (self.low % 1 or self.high % 1):
            raise ConfigError(f"{where}: bounds of an integer must be whole, {got}")

    @property
    def numeric(self) -> bool:
        """Whether its values are numbers."""
        return all(is_number(o) for o in self.options)

    def centre(self, values: Any) -> Any:
        """Return where in [-1, 1] the middle of a whole number's share is, any shape."""
        return (values - self.low + 0.5) / (self.high - self.low + 1.0) * 2.0 - 1.0

    def plain(self, value: float) -> Any:
        """Return a value that `ParameterSpace.values` gives as int, float or option."""
        if self.kind == "choice":
            if not self.numeric:
                return self.options[int(value)]
            return next(option for option in self.options if float(option) == float(value))
        return round(value) if self.kind == "integer" else float(value)


def integer(name: str, low: int, high: int, unit: str = "") -> Parameter:
    """Return a whole number from `low` to `high`, both included."""
    return Parameter(name, low, high, unit=unit, kind="integer")


def choice(name: str, options: Sequence[Any], unit: str = "") -> Parameter:
    """Return a choice among options without order: strings, numbers, or True and False.

    Raises:
        ConfigError: If they are not a list of such, fewer than two, or one comes twice.
    """
    where = f"parameter {name!r}"
    if isinstance(options, str) or not isinstance(options, Sequence):
        raise ConfigError(f"{where}: expected a list of options, got {options!r}")
    known = tuple(o.item() if isinstance(o, np.generic) else o for o in options)
    for option in known:
        # What JSON and an exported file can hold.
        finite = isinstance(option, (int, float)) and math.isfinite(option)
        if not (isinstance(option, str) or finite):
            raise ConfigError(
                f"{where}: the option {option!r} is neither text nor a finite number nor a bool; "
                "choose among names, and let the controller look up what they stand for"
            )
    if len(known) < 2 or len(set(known)) < len(known):
        raise ConfigError(f"{where}: expected two or more different options, got {list(known)}")
    return Parameter(name, 0, len(known) - 1, unit=unit, kind="choice", options=known)


class ParameterSpace:
    """An ordered set of parameters and the map between it and the mapped box [-1, 1]^d.

    One to one where all parameters are real; of a discrete one, `normalise` returns the
    point that stands for the value.
    """

    def __init__(self, parameters: Sequence[Parameter]) -> None:
        """
        Raises:
            ConfigError: If there is no parameter or two share a name.
        """
        self.parameters = tuple(parameters)
        self.names = tuple(p.name for p in self.parameters)
        if not self.names:
            raise ConfigError("a parameter space needs at least one parameter")
        if repeated := {name for name in self.names if self.names.count(name) > 1}:
            raise ConfigError(f"parameter names must differ; repeated: {', '.join(repeated)}")
        self._log = np.array([p.scale == "log" for p in self.parameters])
        self._bounds = np.array([(p.low, p.high) for p in self.parameters], dtype=np.float64).T
        self._scaled = self._bounds.copy()
        self._sign = np.sign(self._bounds[1, self._log])
        self._scaled[:, self._log] = np.log10(self._bounds[:, self._log] * self._sign)
        self._integer = np.array([p.kind == "integer" for p in self.parameters])
        widths = [len(p.options) or 1 for p in self.parameters]
        self._first = np.cumsum([0, *widths[:-1]])  # each parameter's first coordinate
        self.columns = tuple(slice(i, i + w) for i, w in zip(self._first, widths, strict=True))
        """Each parameter's axes of the box."""
        self._choices = {
            i: (self.columns[i], _codes(p))
            for i, p in enumerate(self.parameters)
            if p.kind == "choice"
        }
        self.coordinates = tuple(
            f"{p.name}={option}" if p.options else p.name
            for p in self.parameters
            for option in p.options or (None,)
        )
        """Names of the box's axes, (d,)."""

    @property
    def dimension(self) -> int:
        """Number of coordinates d of the mapped box."""
        return len(self.coordinates)

    def clip(self, x: np.ndarray) -> np.ndarray:
        """Return `x`, any shape (..., d), clipped to the mapped box [-1, 1]^d.

        Raises:
            ConfigError: If a coordinate is NaN, which no bound would stop.
        """
        if (missing := np.isnan(x).reshape(-1, self.dimension).any(axis=0)).any():
            named = ", ".join(np.array(self.coordinates)[missing])
            raise ConfigError(f"expected a number for every parameter, got NaN for {named}")
        return np.clip(x, -1.0, 1.0)

    def values(self, x: np.ndarray) -> np.ndarray:
        """Map `x` (..., d) from the mapped box to physical values (..., p), in `names` order.

        Values outside [-1, 1] are clipped first. A choice among numbers is that number; among
        anything else it is the option's position. For all real parameters p = d.

        Raises:
            ConfigError: If a coordinate is NaN.
        """
        low, high = self._scaled
        x = np.asarray(x, dtype=np.float64)
        inside = self.clip(x)[..., self._first]
        values = low + (inside + 1.0) * 0.5 * (high - low)
        values[..., self._log] = self._sign * np.power(10.0, values[..., self._log])
        if self._integer.any():
            count = (high - low + 1.0)[self._integer]
            centre = np.floor((inside[..., self._integer] + 1.0) * 0.5 * count)
            values[..., self._integer] = low[self._integer] + np.minimum(centre, count - 1.0)
        values = np.clip(values, self._bounds[0], self._bounds[1])
        for i, (columns, codes) in self._choices.items():
            # Not clipped: beyond the box, the larger of two coordinates still decides.
            values[..., i] = codes[x[..., columns].argmax(axis=-1)]
        return values

    def rounded(self, x: np.ndarray) -> np.ndarray:
        """Return a point (..., d) with the values of `x`, the same for all points that share them.

        The middle of a whole number's share; 1 for the option chosen and -1 for the others. Real
        parameters stay. For surrogate models: between such points alone does the cost change.
        """
        inside = self.clip(np.array(x, dtype=np.float64))
        if not self._choices and not self._integer.any():
            return inside
        values = self.values(x)
        for i, (p, columns) in enumerate(zip(self.parameters, self.columns, strict=True)):
            if p.kind == "integer":
                inside[..., columns] = p.centre(values[..., i, None])
            elif p.kind == "choice":
                inside[..., columns] = np.where(values[..., i, None] == _codes(p), 1.0, -1.0)
        return inside

    def denormalise(self, x: np.ndarray) -> dict[str, np.ndarray]:
        """Map `x` (..., d) to named physical values, each of shape (...,); options as such."""
        values = self.values(x)
        physical = {name: values[..., i] for i, name in enumerate(self.names)}
        for i, p in enumerate(self.parameters):
            if not p.numeric:
                physical[p.name] = np.array(p.options, dtype=object)[values[..., i].astype(int)]
        return physical

    def named(self, x: np.ndarray) -> dict[str, Any]:
        """Map one `x` (d,) to plain Python values by name: float, int or option."""
        values = self.values(x)
        return {p.name: p.plain(v) for p, v in zip(self.parameters, values, strict=True)}

    def normalise(self, parameters: Mapping[str, Any]) -> np.ndarray:
        """Map named physical values, each of shape (...,), to `x` (..., d) in [-1, 1].

        Raises:
            ConfigError: If a name is missing or unknown, or a value is no number, lies outside its
                bounds, or is not whole where it must be.
        """
        for name in parameters:
            if name not in self.names:
                raise ConfigError(f"unknown parameter {name!r}; {suggest(name, self.names)}")
        if missing := [name for name in self.names if name not in parameters]:
            raise ConfigError(
                f"no value for parameter(s) {', '.join(missing)}; values are needed for all of "
                f"{', '.join(self.names)}"
            )
        given = (self._numbers(p, parameters[p.name]) for p in self.parameters)
        values = np.stack(np.broadcast_arrays(*given), axis=-1)
        for i, p in enumerate(self.parameters):
            said = f"parameter {p.name!r}: {parameters[p.name]}"
            if not np.all((values[..., i] >= p.low) & (values[..., i] <= p.high) | bool(p.options)):
                raise ConfigError(f"{said} lies outside [{p.low}, {p.high}] {p.unit}".rstrip())
            if p.kind == "integer" and np.any(values[..., i] % 1.0):
                raise ConfigError(f"{said} is not a whole number")
        codes = values.copy()
        values[..., self._log] = np.log10(values[..., self._log] * self._sign)
        low, high = self._scaled
        x = np.clip((values - low) / (high - low) * 2.0 - 1.0, -1.0, 1.0)
        for i, p in enumerate(self.parameters):
            if p.kind == "integer":
                x[..., i] = p.centre(values[..., i])
        if not self._choices:
            return x
        wide = np.repeat(x, [len(p.options) or 1 for p in self.parameters], axis=-1)
        for i, (columns, options) in self._choices.items():
            wide[..., columns] = np.where(codes[..., i, None] == options, CHOSEN, -CHOSEN)
        return wide

    def _numbers(self, p: Parameter, given: Any) -> np.ndarray:
        """Return given values of a parameter as the numbers that `values` would give."""
        if p.kind != "choice":
            try:
                return np.asarray(given, dtype=np.float64)
            except (TypeError, ValueError):
                raise ConfigError(
                    f"parameter {p.name!r}: expected a number from {p.low} to {p.high}, got "
                    f"{given!r}"
                ) from None
        codes = dict(zip(p.options, _codes(p), strict=True))
        array = np.array(given, dtype=object)
        for value in array.reshape(-1):
            if value not in codes:
                raise ConfigError(
                    f"parameter {p.name!r}: unknown option {value!r}; "
                    f"{suggest(str(value), map(str, p.options))}"
                )
        numbers = [codes[v] for v in array.reshape(-1)]
        return np.array(numbers, dtype=np.float64).reshape(array.shape)


def _codes(p: Parameter) -> np.ndarray:
    """Return the number that stands for each option (K,)."""
    return np.array(p.options if p.numeric else range(len(p.options)), dtype=np.float64)
