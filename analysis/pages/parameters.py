"""The part of a report that shows parameters before and after, within their bounds."""

from collections.abc import Mapping
from html import escape
from typing import Any

import numpy as np

from zoac.analysis.data.baseline import Before
from zoac.analysis.data.runs import Run
from zoac.analysis.figures.labels import unit_label
from zoac.analysis.pages import html
from zoac.analysis.pages.formatting import NOTHING, without_empty_columns
from zoac.core.parameters import Parameter, ParameterSpace

NEAR_BOUND = 0.01
"""Fraction of the range within which a parameter counts as being at its bound."""

RANGE = "Range"


def parameters(run: Run, compared: Before | None) -> str:
    """Return a table of the parameters; those at a bound are named below it."""
    before = (compared and compared.parameters) or {}
    first = run.start or {}
    start = {} if _alike(first, before) else first
    marks = {"before": before, "after": run.outcome["parameters"], "start": start}
    lines = [["Name", "Start of tuning", "Before", "After", RANGE]]
    at_bound = []
    for record in run.identity["parameters"]:
        parameter = Parameter(**record)
        name, scale = parameter.name, " (log)" if parameter.scale == "log" else ""
        values = {mark: found[name] for mark, found in marks.items() if name in found}
        if parameter.kind == "choice":
            shown = escape(", ".join(map(str, parameter.options)))
        else:
            places = {mark: _place(parameter, value) for mark, value in values.items()}
            shown = html.placed(places, f"{parameter.low:g}", f"{parameter.high:g}")
            for bound, distance in (("low", places["after"]), ("high", 1 - places["after"])):
                if distance < NEAR_BOUND:
                    at_bound.append(f"{escape(name)} ({bound})")
        label = escape(unit_label(name, parameter.unit)) + scale
        cells = [_value(values.get(mark)) for mark in ("start", "before", "after")]
        lines.append([label, *cells, shown])
    told = {"before": "before", "after": "after", "start": "start of tuning"}
    text = html.keys({mark: text for mark, text in told.items() if marks[mark]})
    text += html.table(without_empty_columns(lines), wide=[RANGE])
    if at_bound:
        text += html.paragraph(
            f"At a bound: {', '.join(at_bound)}. Where the bound is not physical, a wider range "
            "may do better.",
            "warning",
        )
    return text


def _alike(one: Mapping[str, Any], other: Mapping[str, Any]) -> bool:
    """Tell whether two sets of parameters are the same up to rounding."""
    return one.keys() == other.keys() and all(
        one[k] == other[k] if isinstance(one[k], str) else bool(np.isclose(one[k], other[k]))
        for k in one
    )


def _value(value: float | str | None) -> str:
    if isinstance(value, str):
        return escape(value)
    return NOTHING if value is None else f"{value:.6g}"


def _place(parameter: Parameter, value: float) -> float:
    """Return where in its range, 0 to 1, `value` lies."""
    inside = float(np.clip(value, parameter.low, parameter.high))
    return (float(ParameterSpace([parameter]).normalise({parameter.name: inside})[0]) + 1) / 2
