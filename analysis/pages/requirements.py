"""The part of a report that shows what was required: a row per spec, and the response."""

from __future__ import annotations

from html import escape

from zoac.analysis.data.runs import Run
from zoac.analysis.pages import html
from zoac.analysis.pages.formatting import NOTHING
from zoac.runs import responses, schema
from zoac.specs.verdict import restored


def requirements(run: Run) -> str:
    """Return a green or red row per spec, and the response before and after; or nothing."""
    rows = [restored(row) for row in run.outcome.get("specs", [])]
    lines = [["Spec", "Limit", "Before", "After", ""]]
    for row in rows:
        before = NOTHING if row["baseline"] is None else f"{row['baseline']:.4g}"
        verdict = {True: "met", False: "not met", None: "objective"}[row["met"]]
        cells = (row["spec"], row["limit"] or NOTHING)
        lines.append([*map(escape, cells), before, f"{row['value']:.4g}", verdict])
    css = [{True: "met", False: "unmet", None: ""}[row["met"]] for row in rows]
    text = html.subtitle("Requirements") + html.table(lines, css) if rows else ""
    if not (run.folder / schema.RESPONSES).is_file():
        return text
    figure = responses.plot(run.folder, run.outcome)
    caption = "The first final episode; before: with the baseline values"
    shown = html.picture(figure, f"{run.folder} response", "Signals over time", caption)
    return text + html.subtitle("Response") + html.gallery([shown])
