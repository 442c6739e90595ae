"""What figures show of a segment whose signals have names."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from zoac.core.measures import Trace
from zoac.core.segments import Segment
from zoac.specs import guides
from zoac.specs.signals import Episode, Signal
from zoac.specs.spec import Spec


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
    rows = [guides.plain(spec) for spec in specs]
    references = guides.references(rows)
    x_label = "Step" if sample_time is None else "Time [s]"
    traces = []
    for name, samples in first.items():
        if name in references.values():
            continue
        reference = references.get(name)
        levels = guides.limits(rows, name, episode.time, first)
        unit = signals[name].unit
        traces.append(
            Trace(
                f"{name} [{unit}]" if unit else name,
                episode.time,
                samples,
                x_label,
                None if reference is None else (episode.time, first[reference]),
                tuple(dict.fromkeys(limit.level for limit in levels)),
            )
        )
    if all(spec.hard for spec in specs):
        traces.append(Trace("Cost", episode.time[: segment.length], np.asarray(segment.costs),
                            x_label))  # fmt: skip
    return traces
