"""Specs of a recorded experiment: its signals are the columns of a table."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from zoac.core.errors import ConfigError, suggest
from zoac.specs import requirements, step_info
from zoac.specs.signals import Episode
from zoac.specs.spec import Spec

if TYPE_CHECKING:
    import pandas as pd

TIME = "time"
"""The column that tells the time [s]."""

LIMITS = ("max", "min", "weight", "window")


def episode_of(trace: pd.DataFrame, signals: Sequence[str]) -> Episode:
    """Return signals of a table with a column `time` [s] and one for each signal.

    Args:
        trace: The table, a row for each sample.
        signals: Names of the columns that are needed.
    """
    if not hasattr(trace, "columns"):
        raise ConfigError(
            f"trace: expected a DataFrame, got a {type(trace).__name__}; read a file with "
            "pandas.read_csv, make one of columns with pandas.DataFrame"
        )
    values = {}
    for name in (TIME, *signals):
        if name not in trace.columns:
            raise ConfigError(f"the trace has no column {name!r}; {suggest(name, trace.columns)}")
        if trace[name].ndim > 1:
            raise ConfigError(f"the trace has several columns {name!r}; expected one")
        if trace[name].dtype.kind in "mM":  # NumPy would make microseconds of them
            raise ConfigError(
                f"the trace's column {name!r} holds dates or durations, expected numbers, the "
                "time in seconds; (t - t[0]).dt.total_seconds() makes them of dates"
            )
        try:
            values[name] = trace[name].to_numpy(np.float64)
        except (TypeError, ValueError):
            raise ConfigError(f"the trace's column {name!r} holds what is no number") from None
        if not np.isfinite(values[name]).all():
            raise ConfigError(f"the trace's column {name!r} holds what is not finite")
    time = values.pop(TIME)
    if len(time) < 2 or not (np.diff(time) > 0).all():
        raise ConfigError("the time of the trace does not increase from row to row")
    return Episode(time - time[0], values)


def judged(
    specs: Sequence[Spec], trace: pd.DataFrame, cost: Any
) -> tuple[Any, float, dict[str, float]]:
    """Return the cost of a trace, the violation and the value of each spec by its label.

    Args:
        specs: Hard ones, and soft ones, whose weighted sum is the cost.
        trace: A table as for `episode_of`.
        cost: The cost if all specs are hard, else None.
    """
    if not specs:
        raise ConfigError("a trace needs specs to judge it; give the study specs=[...]")
    episode = episode_of(trace, [name for spec in specs for name in spec.signals])
    values = [spec.of_episode(episode) for spec in specs]
    pairs = list(zip(specs, values, strict=True))
    soft = [spec.weight * value for spec, value in pairs if not spec.hard]
    if bool(soft) != (cost is None):
        raise ConfigError(
            "the cost comes from the specs without a limit; give none beside the trace"
            if soft
            else "a trace needs a cost beside it, since every spec of the study has a limit"
        )
    violation = sum(spec.violation_of(episode, value) for spec, value in pairs)
    named = {spec.label: value for spec, value in pairs}
    return (sum(soft) if soft else cost), float(violation), named


def as_plain(spec: Spec) -> dict[str, Any]:
    """Return a spec as JSON can hold it.

    Raises:
        ConfigError: If its figure is none of `zoac.specs`, or it is over several episodes.
    """
    if spec.figure is not getattr(step_info, spec.name, None):
        raise ConfigError(
            f"{spec}: a study judges signals by figures of zoac.specs, and cannot keep a function "
            "of yours; use such a figure, or give the cost yourself"
        )
    if spec.over is not None:
        raise ConfigError(f"{spec}: a study has no use for 'over'; leave it out")
    limits = {name: limit for name in LIMITS if (limit := getattr(spec, name)) is not None}
    return {"name": spec.name, "signals": list(spec.signals), **spec.options, **limits}


def from_plain(given: Mapping[str, Any]) -> Spec:
    """Return the spec that `as_plain` wrote."""
    options = dict(given)
    make, signals = getattr(requirements, options.pop("name")), options.pop("signals")
    spec: Spec = make(*signals, **options)
    return spec
