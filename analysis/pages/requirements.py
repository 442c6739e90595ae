"""The part of a report that shows what was required: a green or red row per spec and constraint."""

import math
from collections.abc import Mapping
from html import escape
from typing import Any

from zoac.analysis.data.runs import Run
from zoac.analysis.pages import html
from zoac.analysis.pages.formatting import NOTHING, significant, without_empty_columns
from zoac.specs.verdict import restored

TIMES = ("settling_time", "rise_time")
"""Figures that are infinite for a response that never gets there."""


def requirements(run: Run) -> str:
    """Return a table of specs and constraints, before and after; or nothing."""
    episodes = len(run.costs)
    lines, css = [["Requirement", "Limit", "Before", "After"]], []
    for row in map(restored, run.outcome.get("specs", [])):
        lines.append(_spec(row, episodes))
        css.append({True: "met", False: "unmet", None: ""}[row["met"]])
    old = (run.outcome.get("baseline") or {}).get("violations_by_constraint", {})
    for name, broken in run.outcome.get("violations_by_constraint", {}).items():
        before = _broken(old[name], episodes) if name in old else NOTHING
        lines.append([escape(name), "at every step", before, _broken(broken, episodes)])
        css.append("unmet" if broken["episodes"] else "met")
    if not css:
        return ""
    return html.table(without_empty_columns(lines), css)


def verdicts(run: Run) -> list[bool]:
    """Return for each hard spec and each constraint whether the answer keeps it."""
    specs = [row["met"] for row in run.outcome.get("specs", []) if row["met"] is not None]
    broken = run.outcome.get("violations_by_constraint", {}).values()
    return [*specs, *(not found["episodes"] for found in broken)]


def _spec(row: Mapping[str, Any], episodes: int) -> list[str]:
    after = html.verdict(_value(row, row["value"]), row["met"])
    if row["met"] is False and episodes > 1:
        after += f", broken in {row['broken']} of {episodes} episodes"
    before = NOTHING
    if row["baseline"] is not None:
        before = html.verdict(_value(row, row["baseline"]), row["baseline_met"])
    limit = escape((row["limit"] or "minimised").replace("<=", "≤").replace(">=", "≥"))
    return [escape(row["spec"]), limit, before, after]


def _value(row: Mapping[str, Any], value: float) -> str:
    return "never" if row["figure"] in TIMES and math.isinf(value) else significant(value)


def _broken(found: Mapping[str, Any], episodes: int) -> str:
    """Return in how many episodes a constraint was broken, and by how much at most."""
    count = found["episodes"]
    if not count:
        return html.verdict("kept", True)
    # What is not finite was written as null.
    worst = math.inf if found["worst"] is None else found["worst"]
    told = f"broken in {count} of {episodes} episodes, by up to {significant(worst)}"
    return html.verdict(told, False)
