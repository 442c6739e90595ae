"""What figures draw beside a signal: its reference, and the limits that specs put on it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from zoac.specs.spec import Spec


class Limit(NamedTuple):
    """A level that a signal shall not cross from one time to another.

    Args:
        level: In the signal's unit.
        since: [s].
        until: [s].
    """

    level: float
    since: float
    until: float


def plain(spec: Spec) -> dict[str, Any]:
    """Return what is drawn of a spec, as JSON can hold it."""
    return {
        "figure": spec.name,
        "signals": list(spec.signals),
        "options": dict(spec.options),
        "window": None if spec.window is None else list(spec.window),
        "max": spec.max,
        "min": spec.min,
    }


def references(rows: Iterable[Mapping[str, Any]]) -> dict[str, str]:
    """Return the reference of each signal that has one, from what `plain` returned."""
    return {row["signals"][0]: row["signals"][1] for row in rows if len(row["signals"]) == 2}


def limits(
    rows: Iterable[Mapping[str, Any]], name: str, time: np.ndarray, values: Mapping[str, np.ndarray]
) -> list[Limit]:
    """Return the limits of a signal that have a level.

    Args:
        rows: From `plain`.
        name: Of the signal.
        time: (K,) [s].
        values: Samples (K,) of every signal, by name.
    """
    found: list[Limit] = []
    for row in rows:
        if row["signals"][:1] != [name] or row["max"] is None:
            continue
        start, end = row["window"] or (time[0], time[-1])
        inside = (time >= start) & (time <= end)
        if not inside.any():
            continue
        start, end = float(time[inside][0]), float(time[inside][-1])
        samples = [values[signal][inside] for signal in row["signals"]]
        found += [
            Limit(float(level), float(since), end)
            for level, since in _levels(row, start, end, samples)
            if since < end
        ]
    return found


def _levels(
    row: Mapping[str, Any], start: float, end: float, samples: Sequence[np.ndarray]
) -> list[tuple[float, float]]:
    """Return levels and from when [s] they hold."""
    most, figure = row["max"], row["figure"]
    if figure == "peak":
        return [(most, start), (-most, start)] if (samples[0] < 0).any() else [(most, start)]
    if len(samples) < 2:
        return []
    target, step = samples[1][-1], samples[1][-1] - samples[0][0]
    if figure == "overshoot":
        return [(target + most * step, start)]
    if figure == "settling_time":
        half = row["options"]["band"] * (abs(step) or 1.0)
        return [(target + half, start + most), (target - half, start + most)]
    if figure == "steady_state_error":
        since = end - row["options"]["last"] * (end - start)
        return [(target + most, since), (target - most, since)]
    return []
