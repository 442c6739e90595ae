"""A result in a few lines or a small table: parameters, cost and specs, before and after."""

import html
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from zoac.specs import verdict

MAX_PARAMETERS = 10
"""Parameters that are shown; the rest are counted."""

MAX_SHARE = 10.0
"""From here on a difference in percent of the baseline's cost says nothing."""

ROUNDING = 1e-9
"""Of a mean: differences between equal episodes are below."""


def cost_lines(result: Mapping[str, Any]) -> Iterator[str]:
    """Yield the mean cost with half the width of a 95% interval, and how the baseline compares.

    Args:
        result: The content of `result.json`.
    """
    costs = result["cost_per_episode"]
    baseline = (result.get("baseline") or {}).get("cost_per_episode")
    if baseline is None:
        yield f"cost {with_interval(costs)} on {len(costs)} episodes"
        return
    yield (
        f"cost {with_interval(costs)}, baseline values {with_interval(baseline)} on the same "
        f"{len(costs)} episodes"
    )
    difference = _numbers(costs) - _numbers(baseline)
    mean, half = difference.mean(), _half(difference)
    if not np.isfinite(mean) or mean == 0:
        return
    by = _with_half(abs(mean), half)
    interval = "± is a 95% interval"
    if abs(mean) <= half:
        side = "lower" if mean < 0 else "higher"
        yield f"no clear difference from the baseline values: {side} by {by} ({interval})"
        return
    share = abs(mean / _numbers(baseline).mean())
    notes = [f"{share:.0%}" if share < MAX_SHARE else "", interval if half > 0 else ""]
    told = ", ".join(filter(None, notes))
    side = "better" if mean < 0 else "worse"
    yield f"{side} than the baseline values by {by}" + (f" ({told})" if told else "")


def acceptance_line(test: Mapping[str, Any]) -> str:
    """Return the verdict of an acceptance test, `acceptance_test` of `result.json`, and why."""
    better, kept = "the tuned values beat the baseline values", "the baseline values are kept"
    return f"acceptance test: {better if test['accepted'] else kept}: {test['text']}"


def with_interval(costs: Any) -> str:
    """Return a mean with half the width of its 95% interval, if that can be told."""
    numbers = _numbers(costs)
    return _with_half(numbers.mean(), _half(numbers))


def _with_half(mean: float, half: float) -> str:
    digits = f"{half:.2g}" if half < 100 else f"{half:.0f}"
    return f"{mean:.4g} ± {digits}" if half > 0 else f"{mean:.4g}"


def as_html(result: Mapping[str, Any], run: Mapping[str, Any], fixed: Mapping[str, Any]) -> str:
    """Return a table for a notebook.

    Args:
        result: The content of `result.json`.
        run: The content of `run.json`.
        fixed: Parameters that were not tuned.
    """
    rows = [("", "baseline", "tuned", ""), *parameter_rows(result, run)]
    baseline = (result.get("baseline") or {}).get("cost_per_episode")
    before = "" if baseline is None else with_interval(baseline)
    episodes = f"{len(result['cost_per_episode'])} episodes"
    rows.append(("cost", before, with_interval(result["cost_per_episode"]), episodes))
    for row in map(verdict.restored, result.get("specs", [])):
        met = {True: "met", False: "NOT met"}.get(row["met"], "")
        values = (shown(row[which]) for which in ("baseline", "value"))
        rows.append((row["spec"], *values, f"{row['limit'] or ''} {met}".strip()))
    lines = [
        "<tr>" + "".join(f"<{tag}>{html.escape(cell)}</{tag}>" for cell in row) + "</tr>"
        for tag, row in zip(["th"] + ["td"] * len(rows), rows, strict=False)
    ]
    told = [f"WARNING: {sentence}" for sentence in result["warnings"]]
    if fixed:
        told.append("fixed: " + ", ".join(f"{k} = {shown(v)}" for k, v in fixed.items()))
    paragraphs = "".join(f"<p>{html.escape(text)}</p>" for text in told)
    return f"<table>{''.join(lines)}</table>{paragraphs}"


def parameter_rows(
    result: Mapping[str, Any], run: Mapping[str, Any]
) -> Iterator[tuple[str, str, str, str]]:
    """Yield name, baseline value, tuned value and unit of each parameter that is shown."""
    before = run.get("nominal") or {}
    units = {p["name"]: p["unit"] for p in run.get("parameters", [])}
    parameters = result["parameters"]
    for name, value in list(parameters.items())[:MAX_PARAMETERS]:
        yield name, shown(before.get(name)), shown(value), units.get(name, "")
    if (more := len(parameters) - MAX_PARAMETERS) > 0:
        yield f"and {more} more in result.json", "", "", ""


def shown(value: Any) -> str:
    """Return a parameter's value with six digits."""
    if value is None:
        return ""
    return format(value, ".6g") if isinstance(value, float) else str(value)


def _numbers(costs: Sequence[float | None]) -> np.ndarray:
    return np.asarray(costs, dtype=np.float64)  # null where a cost was not finite


def _half(numbers: np.ndarray) -> float:
    """Return half the width of the 95% interval of a mean; 0 if it is rounding alone.

    NaN if there is one number.
    """
    n = len(numbers)
    if n < 2:
        return float("nan")
    half = float(1.96 * numbers.std(ddof=1) / np.sqrt(n))
    return half if half > ROUNDING * abs(numbers.mean()) else 0.0
