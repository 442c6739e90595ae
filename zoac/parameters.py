"""Parameters of a controller and the box they are searched in.

Tuners search the mapped box Theta_m = [-1, 1]^d (section III-C of the paper); controllers see
physical values. `ParameterSpace` is the only place that maps between the two, and the only
place that clips.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from zoac.errors import ConfigError, suggest

Scale = Literal["linear", "log"]


@dataclass(frozen=True, slots=True)
class Parameter:
    """One bounded parameter.

    Args:
        name: Its name, unique in a space.
        low: Lower bound, in `unit`.
        high: Upper bound, in `unit`.
        scale: "linear" or "log": how [-1, 1] maps to [low, high].
        unit: Unit for people to read, such as "N/rad"; empty for a pure number.

    Raises:
        ConfigError: If the bounds are not finite, not in order, or not positive on a log scale.
    """

    name: str
    low: float
    high: float
    scale: Scale = "linear"
    unit: str = ""

    def __post_init__(self) -> None:
        where = f"parameter {self.name!r}"
        if self.scale not in ("linear", "log"):
            raise ConfigError(
                f"{where}: unknown scale {self.scale!r}; {suggest(self.scale, ('linear', 'log'))}"
            )
        if not (math.isfinite(self.low) and math.isfinite(self.high)):
            raise ConfigError(f"{where}: bounds must be finite, got [{self.low}, {self.high}]")
        if self.low >= self.high:
            raise ConfigError(
                f"{where}: the lower bound must be below the upper, got [{self.low}, {self.high}]"
            )
        if self.scale == "log" and self.low <= 0:
            raise ConfigError(f"{where}: a log scale needs a positive lower bound, got {self.low}")


class ParameterSpace:
    """An ordered set of parameters and the one-to-one map between it and [-1, 1]^d."""

    def __init__(self, parameters: Sequence[Parameter]) -> None:
        """
        Raises:
            ConfigError: If there is no parameter or two share a name.
        """
        self.parameters = tuple(parameters)
        self.names = tuple(p.name for p in self.parameters)
        if not self.names:
            raise ConfigError("a parameter space needs at least one parameter")
        repeated = {name for name in self.names if self.names.count(name) > 1}
        if repeated:
            raise ConfigError(f"parameter names must differ; repeated: {', '.join(repeated)}")
        self._log = np.array([p.scale == "log" for p in self.parameters])
        self._bounds = np.array([(p.low, p.high) for p in self.parameters]).T
        self._scaled = self._bounds.copy()
        self._scaled[:, self._log] = np.log10(self._bounds[:, self._log])

    @property
    def dimension(self) -> int:
        """Number of parameters d."""
        return len(self.names)

    def clip(self, z: np.ndarray) -> np.ndarray:
        """Return `z`, any shape (..., d), clipped to the mapped box [-1, 1]^d."""
        return np.clip(z, -1.0, 1.0)

    def values(self, z: np.ndarray) -> np.ndarray:
        """Map `z` (..., d) from the mapped box to physical values (..., d), in `names` order.

        Values outside [-1, 1] are clipped first.
        """
        low, high = self._scaled
        values = low + (self.clip(np.asarray(z, dtype=np.float64)) + 1.0) * 0.5 * (high - low)
        values[..., self._log] = np.power(10.0, values[..., self._log])
        return np.clip(values, self._bounds[0], self._bounds[1])

    def physical(self, z: np.ndarray) -> dict[str, np.ndarray]:
        """Map `z` (..., d) to named physical values, each of shape (...,)."""
        values = self.values(z)
        return {name: values[..., i] for i, name in enumerate(self.names)}

    def unit(self, parameters: Mapping[str, float | np.ndarray]) -> np.ndarray:
        """Map named physical values, each of shape (...,), to `z` (..., d) in [-1, 1].

        Raises:
            ConfigError: If a name is missing or unknown, or a value lies outside its bounds.
        """
        for name in parameters:
            if name not in self.names:
                raise ConfigError(f"unknown parameter {name!r}; {suggest(name, self.names)}")
        missing = [name for name in self.names if name not in parameters]
        if missing:
            raise ConfigError(f"no value for parameter(s) {', '.join(missing)}")
        given = (np.asarray(parameters[name], dtype=np.float64) for name in self.names)
        values = np.stack(np.broadcast_arrays(*given), axis=-1)
        for i, p in enumerate(self.parameters):
            if not np.all((values[..., i] >= p.low) & (values[..., i] <= p.high)):
                raise ConfigError(
                    f"parameter {p.name!r}: {parameters[p.name]} lies outside "
                    f"[{p.low}, {p.high}] {p.unit}".rstrip()
                )
        values[..., self._log] = np.log10(values[..., self._log])
        low, high = self._scaled
        return self.clip((values - low) / (high - low) * 2.0 - 1.0)
