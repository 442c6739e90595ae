"""Closed loops on the demonstration episode (Figs. 5 and 6), as pictures or as a film.

python -m zoac.analysis.trajectories runs --task pid_acc --out figures
python -m zoac.analysis.trajectories runs --task mpc_tracking --animate closed_loop.gif
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from zoac.analysis import cli
from zoac.analysis.data import replay
from zoac.analysis.data.runs import Run
from zoac.analysis.data.selection import chosen
from zoac.analysis.figures import style
from zoac.analysis.figures.labels import TASKS, method_labels
from zoac.core.segments import Segment
from zoac.rollout.task import Task

REFERENCE = "Reference"


@dataclass(frozen=True, eq=False)
class Loop:
    """One controller's demonstration episode."""

    label: str
    look: style.Look
    segment: Segment


def main(argv: Sequence[str] | None = None) -> int:
    """Draw closed loops, or film one before and after tuning; return the exit code."""
    parser = cli.parser("trajectories", "Closed loops (Figs. 5 and 6).", "figures", *cli.OPTIONS)
    parser.add_argument("--task", help="default: the only one there is")
    parser.add_argument("--seed", type=int, help="default: the seed of median cost of each tuner")
    parser.add_argument(
        "--animate",
        type=cli.folder,
        metavar="FILE",
        help="write a .gif or .mp4 of one run, before and after tuning, instead",
    )
    parser.add_argument("--tuner", help="use only this tuner; --animate: default zoac")
    return cli.guarded(_command, parser, argv)


def _command(options: argparse.Namespace) -> None:
    runs = chosen(cli.load_one_task(options), options.tuner, options.seed)
    if options.animate is not None:
        from zoac.analysis.figures import film

        film.write(options.animate, runs[0])
        return
    task = replay.rebuild(runs[0])
    loops, name = loops_of(task, runs), runs[0].method.task
    style.save(lambda: draw(task, loops, TASKS.get(name, "")), options, f"trajectories_{name}")


def loops_of(task: Task, runs: Sequence[Run]) -> list[Loop]:
    """Drive the tuned controller of each run through the demonstration."""
    methods = [run.method for run in runs]
    labels, looks = method_labels(methods), style.looks(methods)
    segments = replay.demonstrate(task, [run.outcome["parameters"] for run in runs])
    return [
        Loop(labels[run.method], looks[run.method], segment)
        for run, segment in zip(runs, segments, strict=True)
    ]


def draw(task: Task, loops: Sequence[Loop], title: str, columns: int = 3) -> Figure:
    """Return a figure with one panel per trace and one line per loop."""
    traces = task.traces(loops[0].segment)
    columns = 2 if len(traces) in (2, 4) else min(columns, len(traces))
    rows = -(-len(traces) // columns)
    width = style.COLUMN if len(traces) == 1 else style.PAGE
    figure = Figure(figsize=(width, 1.55 * rows + 0.4), layout="constrained")
    grid = figure.subplots(rows, columns, squeeze=False)
    entries: dict[str, Any] = {}
    last = replay.settled(task, [loop.segment for loop in loops])
    for k, axes in enumerate(grid.flat):
        if k < len(traces):
            entries |= draw_panel(axes, task, loops, k, last)
        else:
            axes.remove()
    if REFERENCE in entries:
        entries[REFERENCE] = entries.pop(REFERENCE)
    style.legend_above(figure, entries)
    if title and len(entries) < 2:
        figure.suptitle(title)
    return figure


def draw_panel(axes: Axes, task: Task, loops: Sequence[Loop], k: int, last: int) -> dict[str, Any]:
    """Draw the `k`-th trace of each loop, up to step `last`, into `axes`; return legend entries."""
    entries: dict[str, Any] = {}
    lines = [task.traces(loop.segment)[k] for loop in loops]
    longest = max(lines, key=lambda line: len(line.x))
    if longest.reference is not None:
        x, y = longest.reference
        shown = x <= longest.x[: last + 1].max()
        (entries[REFERENCE],) = axes.plot(
            x[shown], y[shown], color=style.GREY, linewidth=2.4, alpha=0.55, solid_capstyle="butt"
        )
    for loop, line in zip(loops, lines, strict=True):
        marks = {**loop.look.line, "marker": ""}
        (entries[loop.label],) = axes.plot(line.x[: last + 1], line.y[: last + 1], **marks)
        if loop.segment.terminated and loop.segment.length <= last:
            axes.plot(line.x[-1:], line.y[-1:], "x", color=loop.look.colour, markersize=5)
    low, high = axes.get_ylim()
    for limit in longest.limits:
        if low - 0.3 * (high - low) <= limit <= high + 0.3 * (high - low):
            axes.axhline(limit, color=style.INK, linewidth=0.6, linestyle=(0, (8, 4)))
    axes.set_xlabel(longest.x_label)
    axes.set_ylabel(longest.title)
    axes.margins(x=0.01)
    return entries


if __name__ == "__main__":
    raise SystemExit(main())
