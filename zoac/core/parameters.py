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
        where, log, whole = f"parameter {self.name!r}", self.scale == "log", self.kind == "integer"
        if self.scale not in ("linear", "log"):
            raise ConfigError(
                f"{where}: unknown scale {self.scale!r}; {suggest(self.scale, ('linear', 'log'))}"
            )
        if whole and log:
            raise ConfigError(f"{where}: an integer has no log scale; tune its logarithm")
        for fault, expected in (
            (not (math.isfinite(self.low) and math.isfinite(self.high)), "bounds must be finite"),
            (self.low >= self.high, "the lower bound must be below the upper"),
            (log and self.low * self.high <= 0,
             "a log scale needs a positive lower bound, or a negative upper one"),
            (whole and (self.low % 1 or self.high % 1), "bounds of an integer must be whole"),
        ):  # fmt: skip
            if fault:
                raise ConfigError(f"{where}: {expected}, got [{self.low}, {self.high}]")

    @property
    def coordinates(self) -> tuple[str, ...]:
        """Names of its coordinates (w,): one a number, one an option."""
        return tuple(f"{self.name}={option}" for option in self.options) or (self.name,)

    @property
    def codes(self) -> np.ndarray:
        """The number that stands for each option (K,): itself, or the option's position."""
        numeric = all(map(is_number, self.options))
        return np.array(self.options if numeric else range(len(self.options)), dtype=np.float64)

    def values(self, x: np.ndarray) -> np.ndarray:
        """Map its coordinates (..., w) to physical values (...)."""
        if self.kind == "choice":
            # Not clipped: beyond the box, the larger of two coordinates still decides.
            return self.codes[x.argmax(axis=-1)]
        share = (np.clip(x[..., 0], -1.0, 1.0) + 1.0) * 0.5
        if self.kind == "integer":
            count = self.high - self.low + 1.0
            return self.low + np.minimum(np.floor(share * count), count - 1.0)
        if self.scale == "linear":
            return np.clip(self.low + share * (self.high - self.low), self.low, self.high)
        sign = np.sign(self.high)
        low, high = np.log10(np.array([self.low, self.high]) * sign)
        return np.clip(sign * np.power(10.0, low + share * (high - low)), self.low, self.high)

    def normalise(self, given: Any) -> np.ndarray:
        """Map physical values (...) to its coordinates (..., w).

        Raises:
            ConfigError: If a value cannot be one of this parameter.
        """
        where = f"parameter {self.name!r}"
        if self.kind == "choice":
            array = np.array(given, dtype=object)
            for value in array.reshape(-1):
                if value not in self.options:
                    known = suggest(str(value), map(str, self.options))
                    raise ConfigError(f"{where}: unknown option {value!r}; {known}")
            chosen = array[..., None] == np.array(self.options, dtype=object)
            return np.where(chosen, CHOSEN, -CHOSEN)
        try:
            values = np.asarray(given, dtype=np.float64)[..., None]
        except (TypeError, ValueError):
            raise ConfigError(
                f"{where}: expected a number from {self.low} to {self.high}, got {given!r}"
            ) from None
        if not np.all((values >= self.low) & (values <= self.high)):
            bounds = f"[{self.low}, {self.high}] {self.unit}".rstrip()
            raise ConfigError(f"{where}: {given} lies outside {bounds}")
        if self.kind == "integer":
            if np.any(values % 1.0):
                raise ConfigError(f"{where}: {given} is not a whole number")
            return self.centre(values)
        low, high = self.low, self.high
        if self.scale == "log":
            sign = np.sign(high)
            values, low, high = (np.log10(part * sign) for part in (values, low, high))
        return np.clip((values - low) / (high - low) * 2.0 - 1.0, -1.0, 1.0)

    def rounded(self, x: np.ndarray) -> np.ndarray:
        """Return the coordinates (..., w) that stand for the values of `x`; see the space's."""
        if self.kind == "real":
            return np.clip(x, -1.0, 1.0)
        values = self.values(x)[..., None]
        if self.kind == "integer":
            return self.centre(values)
        return np.where(values == self.codes, 1.0, -1.0)

    def centre(self, values: Any) -> Any:
        """Return where in [-1, 1] the middle of a whole number's share is, any shape."""
        return (values - self.low + 0.5) / (self.high - self.low + 1.0) * 2.0 - 1.0

    def plain(self, value: float) -> Any:
        """Return a value that `values` gives as int, float or option."""
        if self.kind == "choice":
            return self.options[self.codes.tolist().index(value)]
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
        ends = np.cumsum([len(p.coordinates) for p in self.parameters]).tolist()
        self.columns = tuple(map(slice, [0, *ends], ends))
        """Each parameter's axes of the box."""
        self.coordinates = tuple(name for p in self.parameters for name in p.coordinates)
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
        return np.clip(np.concatenate(self._parts(x), axis=-1), -1.0, 1.0)

    def _parts(self, x: np.ndarray) -> list[np.ndarray]:
        """Return the coordinates of each parameter; refuse NaN."""
        x = np.asarray(x, dtype=np.float64)
        if (missing := np.isnan(x).reshape(-1, self.dimension).any(axis=0)).any():
            named = ", ".join(np.array(self.coordinates)[missing])
            raise ConfigError(f"expected a number for every parameter, got NaN for {named}")
        return [x[..., columns] for columns in self.columns]

    def values(self, x: np.ndarray) -> np.ndarray:
        """Map `x` (..., d) from the mapped box to physical values (..., p), in `names` order.

        Values outside [-1, 1] are clipped first. A choice among numbers is that number; among
        anything else it is the option's position. For all real parameters p = d.

        Raises:
            ConfigError: If a coordinate is NaN.
        """
        parts = zip(self.parameters, self._parts(x), strict=True)
        return np.stack([p.values(part) for p, part in parts], axis=-1)

    def rounded(self, x: np.ndarray) -> np.ndarray:
        """Return a point (..., d) with the values of `x`, the same for all points that share them.

        The middle of a whole number's share; 1 for the option chosen and -1 for the others. Real
        parameters stay. For surrogate models: between such points alone does the cost change.
        """
        parts = zip(self.parameters, self._parts(x), strict=True)
        return np.concatenate([p.rounded(part) for p, part in parts], axis=-1)

    def denormalise(self, x: np.ndarray) -> dict[str, np.ndarray]:
        """Map `x` (..., d) to named physical values, each of shape (...,); options as such."""
        values = self.values(x)
        physical = {name: values[..., i] for i, name in enumerate(self.names)}
        for p in self.parameters:
            if p.options and not all(map(is_number, p.options)):
                physical[p.name] = np.array(p.options, dtype=object)[physical[p.name].astype(int)]
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
        parts = [p.normalise(parameters[p.name]) for p in self.parameters]
        shape = np.broadcast_shapes(*(part.shape[:-1] for part in parts))
        wide = [np.broadcast_to(part, (*shape, part.shape[-1])) for part in parts]
        return np.concatenate(wide, axis=-1)
