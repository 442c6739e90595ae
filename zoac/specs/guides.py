"""What figures draw: named signals, their references, and the limits that specs put on them."""

from collections.abc import Collection, Iterable, Mapping, Sequence
from contextlib import suppress
from typing import Any, NamedTuple

import numpy as np

from zoac.core.errors import ConfigError
from zoac.core.measures import Trace
from zoac.core.segments import Segment
from zoac.specs.signals import Episode, Signal
from zoac.specs.spec import Spec


class Limit(NamedTuple):
    """A level that a signal shall not cross from one time [s] to another.

    Args:
        upper: Whether values above the level are forbidden, rather than values below.
    """

    level: float
    since: float
    until: float
    upper: bool


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


def references(rows: Iterable[Mapping[str, Any]], names: Collection[str]) -> dict[str, str]:
    """Return the reference of each signal that has one.

    A spec names it. Otherwise `r` is the reference of `y`, and `<name>_ref` that of `<name>`,
    unless a spec names this signal too.

    Args:
        rows: From `plain`.
        names: Of all signals.
    """
    rows = list(rows)
    named = {row["signals"][0]: row["signals"][1] for row in rows if len(row["signals"]) == 2}
    judged = {name for row in rows for name in row["signals"]}
    pairs = [(name.removesuffix("_ref"), name) for name in names if name.endswith("_ref")]
    by_name = {
        name: reference
        for name, reference in (*pairs, ("y", "r"))
        if {name, reference} <= set(names) and reference not in judged
    }
    return by_name | named


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
        with suppress(ConfigError):  # no sample of this episode is in the window
            part = Episode(time, values).within(row["window"])
            start, end = float(part.time[0]), float(part.time[-1])
            samples = [part.values[signal] for signal in row["signals"]]
            levels = _levels(row, start, end, samples)
            found += [Limit(float(x), float(t), end, up) for x, t, up in levels if t < end]
    return found


def _levels(
    row: Mapping[str, Any], start: float, end: float, samples: Sequence[np.ndarray]
) -> list[tuple[float, float, bool]]:
    """Return levels, from when [s] they hold, and whether they are upper limits."""
    most, figure = row["max"], row["figure"]
    if figure == "peak":
        above, below = (most, start, True), (-most, start, False)
        return [above, below] if (samples[0] < 0).any() else [above]
    if len(samples) < 2:
        return []
    target, step = samples[1][-1], samples[1][-1] - samples[0][0]
    if figure == "overshoot":
        return [(target + most * step, start, step >= 0)]
    if figure == "settling_time":
        half = row["options"]["band"] * (abs(step) or 1.0)
        return [(target + half, start + most, True), (target - half, start + most, False)]
    if figure == "steady_state_error":
        since = end - row["options"]["last"] * (end - start)
        return [(target + most, since, True), (target - most, since, False)]
    return []


def signal_traces(
    segment: Segment,
    signals: Mapping[str, Signal],
    sample_time: float | None,
    specs: Sequence[Spec],
) -> list[Trace]:
    """Return a trace of each signal, over seconds if they are known, with its reference and limits.

    References of other signals have no trace of their own; of m loops side by side the first is
    shown. Where no spec is the objective, the cost comes last.
    """
    episode = Episode.of(segment, signals, sample_time or 1.0)
    first = {name: v if v.ndim == 1 else v[:, 0] for name, v in episode.values.items()}
    rows = [plain(spec) for spec in specs]
    named = references(rows, first)
    x_label = "Step" if sample_time is None else "Time [s]"
    traces = []
    for name, samples in first.items():
        if name in named.values():
            continue
        reference = named.get(name)
        levels = limits(rows, name, episode.time, first)
        unit = signals[name].unit
        title = f"{name} [{unit}]" if unit else name
        line = None if reference is None else (episode.time, first[reference])
        marked = tuple(dict.fromkeys(limit.level for limit in levels))
        traces.append(Trace(title, episode.time, samples, x_label, line, marked))
    if all(spec.hard for spec in specs):
        traces.append(Trace("Cost", episode.time[: segment.length], np.asarray(segment.costs),
                            x_label))  # fmt: skip
    return traces
