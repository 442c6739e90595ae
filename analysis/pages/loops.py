"""The part of a report that shows signals over time: as they were recorded, or driven once more."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape
from typing import TYPE_CHECKING, Any

import numpy as np

from zoac.analysis import trajectories
from zoac.analysis.data import replay
from zoac.analysis.data.baseline import Before
from zoac.analysis.data.runs import Run
from zoac.analysis.pages import html
from zoac.analysis.pages.formatting import NOTHING, significant
from zoac.core.errors import RunFolderError
from zoac.core.measures import Trace
from zoac.runs import responses, schema
from zoac.specs import guides
from zoac.specs import step_info as figures

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes

MAX_VIEW = 3.0
"""Largest range of an axis, as a multiple of what the tuned controller needs."""


def recorded(run: Run) -> tuple[str, str]:
    """Return the signals of a final episode, before and after, and what is said of their steps.

    Either is empty without a record.
    """
    if not (run.folder / schema.RESPONSES).is_file():
        return "", ""
    table = responses.one_loop(responses.read(run.folder), run.outcome)
    signals, specs = run.identity.get("signals", {}), run.outcome.get("specs", [])
    units = signals.get("units", {})
    references = guides.references(specs, table.columns[2:])
    pictures = []
    for name in (n for n in table.columns[2:] if n not in references.values()):
        figure, axes = html.figure()
        responses.draw(axes, table, name, specs)
        axes.set_xlabel(trajectories.TIME_AXES[0 if signals.get("sample_time") else 1])
        axes.set_ylabel(f"{name} [{units[name]}]" if units.get(name) else name)
        _mark_limit_cycles(axes, table, name)
        label = f"{name} over time"
        pictures.append(html.picture(figure, f"{run.folder} signal {name}", label, columns=4))
    note = f"{responses.title(run.outcome)}."
    if len(set(table["parameters"])) > 1:
        note += " Before: with the baseline values."
    response = html.gallery(pictures) + html.paragraph(note, "muted")
    return response, _steps(table, references, specs, units) if signals.get("sample_time") else ""


def _mark_limit_cycles(axes: Axes, table: pd.DataFrame, name: str) -> None:
    """Shade what a signal in a limit cycle swings between."""
    lines = {str(line.get_label()): line for line in axes.get_lines()}
    for which, part in table.groupby("parameters", sort=False):
        time, values = (part[column].to_numpy(float) for column in ("time", name))
        trace = Trace(name, time, values, axes.get_xlabel())
        if (cycle := trajectories.limit_cycle([trace])) is not None:
            trajectories.shade(axes, lines[responses.LOOKS[str(which)][0]], trace, cycle)


def _steps(
    table: pd.DataFrame,
    references: Mapping[str, str],
    specs: Sequence[Mapping[str, Any]],
    units: Mapping[str, str],
) -> str:
    """Return rise, overshoot and settling of each signal whose reference steps once, or nothing."""
    tables = []
    for name, reference in references.items():
        windows = [r["window"] for r in specs if r["signals"] == [name, reference] and r["window"]]
        steps = {
            str(which): step
            for which, part in table.groupby("parameters", sort=False)
            if (step := _step(part, name, reference, windows[0] if windows else None)) is not None
        }
        if "tuned" not in steps:
            continue
        unit = f" [{units[name]}]" if units.get(name) else ""
        lines = [[f"Step of {escape(reference)}, seen in {escape(name)}", "Before", "After"]]
        for label, figure, factor in (
            ("Rise time, 10% to 90% [s]", figures.rise_time, 1.0),
            ("Overshoot [%]", figures.overshoot, 100.0),
            ("Settling time, 2% [s]", figures.settling_time, 1.0),
            (f"Error at the end{escape(unit)}", figures.steady_state_error, 1.0),
        ):
            values = {which: factor * figure(*step) for which, step in steps.items()}
            cells = {w: significant(v) if np.isfinite(v) else "never" for w, v in values.items()}
            lines.append([label, *(cells.get(which, NOTHING) for which in ("baseline", "tuned"))])
        tables.append(html.table(lines))
    note = html.paragraph("In the final evaluation episode that is shown above.", "muted")
    return "".join([*tables, note]) if tables else ""


def _step(
    part: pd.DataFrame, name: str, reference: str, window: Sequence[float] | None
) -> tuple[np.ndarray, np.ndarray, float] | None:
    """Return time, signal and target from the only step of the reference on; None without one."""
    t, y, r = (part[column].to_numpy(float) for column in ("time", name, reference))
    if window is not None:
        inside = (t >= window[0] - 1e-9) & (t <= window[1] + 1e-9)
        t, y, r = t[inside], y[inside], r[inside]
    changes = np.flatnonzero(np.diff(r))
    if not len(t) or len(changes) > 1:
        return None
    start = int(changes[0]) if len(changes) else 0
    t, y = t[start:], y[start:]
    return (t, y, float(r[-1])) if np.isfinite(y).all() and y[0] != r[-1] else None


def closed_loop(run: Run, compared: Before | None) -> str:
    """Return the demonstration episode, driven once more, before and after."""
    if "study" in run.identity:
        return ""
    try:
        task = replay.rebuild(run)
    except RunFolderError as error:
        return html.paragraph(escape(str(error)), "muted")
    loops = trajectories.before_and_after(task, run, compared)
    pictures = []
    last = replay.settled(task, [loops[-1].segment])
    for k, trace in enumerate(loops[-1].traces):
        figure, axes = html.figure()
        trajectories.draw_panel(axes, loops, k, last)
        left = keep_in_view(axes, trace)
        caption = "The controller before tuning leaves this view." if left else ""
        name = f"{run.folder} trace {k}"
        pictures.append(html.picture(figure, name, trace.title, caption, columns=4))
    totals = ", ".join(
        f"{loop.label.lower()} {significant(float(loop.segment.costs.sum()))}" for loop in loops
    )
    what = f" Before: with the {compared.what}." if len(loops) > 1 and compared else ""
    return html.gallery(pictures) + html.paragraph(
        f"The demonstration episode, driven once more. Its cost: {totals}.{escape(what)}", "muted"
    )


def keep_in_view(axes: Axes, trace: Trace) -> bool:
    """Narrow the y axis if another line would squeeze `trace` into a fraction of it; tell if so."""
    low, high = float(trace.y.min()), float(trace.y.max())
    bottom, top = axes.get_ylim()
    if not top - bottom > MAX_VIEW * (high - low) > 0:
        return False
    room = (MAX_VIEW - 1) / 2 * (high - low)
    axes.set_ylim(max(bottom, low - room), min(top, high + room))
    return True
