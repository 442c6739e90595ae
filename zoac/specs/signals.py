"""Named signals of an episode, at the samples 0, T_s, 2 T_s, ... in seconds."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from zoac.core.errors import ConfigError
from zoac.core.measures import read_from
from zoac.core.segments import Segment


@dataclass(frozen=True)
class Signal:
    """Where a signal stands in a segment.

    Args:
        label: Its source, for people to read.
        read: Function of a segment that returns (T + 1,) samples, or (T,) of what is held over a
            step, whose last sample is then repeated. Of m loops side by side (T + 1, m) or (T, m).
        unit: For people to read.
        info: The key of the environment's `info` that it is, if it is one.
        number: The value of every sample, if it is known to be the same.
    """

    label: str
    read: Callable[[Segment], Any]
    unit: str = ""
    info: str | None = None
    number: float | None = None

    def samples(self, segment: Segment) -> np.ndarray:
        """Return (T + 1,) samples, or (T + 1, m).

        Raises:
            ConfigError: If the signal cannot be read, or is not one number per sample.
        """
        values = read_from(self.read, segment, f"signal {self.label}", np.float64)
        if values.ndim in (1, 2) and len(values) == segment.length > 0:
            values = np.concatenate([values, values[-1:]])
        if values.ndim not in (1, 2) or len(values) != segment.length + 1:
            raise ConfigError(
                f"signal {self.label}: expected {segment.length + 1} samples, or one per step, got "
                f"an array of shape {values.shape}"
            )
        return values


def observation(index: int, unit: str = "") -> Signal:
    """Return the signal of one number of the observation, by its index from 0."""
    return Signal(f"observation({index})", lambda s: s.observations[:, index], unit)


def action(index: int = 0, unit: str = "") -> Signal:
    """Return the signal of one number of the action that was applied, by its index from 0."""
    return Signal(f"action({index})", lambda s: s.actions[:, index], unit)


def info(key: str, unit: str = "") -> Signal:
    """Return the signal of a number that reset and step return in `info`, by its key.

    Raises:
        ConfigError: If the key is no text.
    """
    if not isinstance(key, str):
        raise ConfigError(f"info({key!r}): expected a key of the environment's info, such as 'y'")

    def read(segment: Segment) -> np.ndarray:
        first = segment.diagnostics[INFO_BEFORE + key][:1]
        return np.concatenate([first, segment.diagnostics[INFO + key]])

    return Signal(f"info({key!r})", read, unit, key)


INFO, INFO_BEFORE = "info:", "info before:"
"""What the diagnostics of a segment call a number of `info` after and before each step."""


def constant(value: float, unit: str = "") -> Signal:
    """Return a signal that does not change, such as a set-point."""
    number = float(value)
    return Signal(f"{value:g}", lambda s: np.full(s.length + 1, number), unit, number=number)


@dataclass(frozen=True, eq=False)
class Episode:
    """The signals of one episode.

    Args:
        time: (K,) [s], from 0.
        values: Samples (K,), or (K, m) of m loops side by side, by name.
        ended: When it ended, as a part of its time limit: 1 in time, below 1 if a termination or a
            failure ended it early.
    """

    time: np.ndarray
    values: Mapping[str, np.ndarray]
    ended: float = 1.0

    @classmethod
    def of(cls, segment: Segment, signals: Mapping[str, Signal], sample_time: float) -> Episode:
        """Return the signals of a whole episode."""
        time = sample_time * np.arange(segment.length + 1)
        values = {name: signal.samples(segment) for name, signal in signals.items()}
        return cls(time, values)

    def within(self, window: tuple[float, float] | None) -> Episode:
        """Return the part from one time to another [s], both included.

        Raises:
            ConfigError: If the episode has no sample there.
        """
        if window is None:
            return self
        # A sample that rounding puts just outside is inside.
        slack = 1e-9 * max(1.0, window[1])
        inside = (self.time >= window[0] - slack) & (self.time <= window[1] + slack)
        if not inside.any():
            raise ConfigError(
                f"window={window}: the episode has no sample there; it lasts {self.time[-1]:g} s"
            )
        values = {name: samples[inside] for name, samples in self.values.items()}
        return Episode(self.time[inside], values, self.ended)
