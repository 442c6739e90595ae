"""Closed loops on the demonstration episode (Figs. 5 and 6), as pictures or as a film.

python -m zoac.analysis.trajectories runs --task pid_acc --out figures
python -m zoac.analysis.trajectories runs --task mpc_tracking --animate closed_loop.gif
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from zoac.analysis.data import cli, replay
from zoac.analysis.data.baseline import Before, before
from zoac.analysis.data.runs import Run
from zoac.analysis.data.selection import chosen
from zoac.analysis.figures import style
from zoac.analysis.figures.labels import TASKS, method_labels, tuner_names
from zoac.core.measures import Trace
from zoac.core.segments import Segment
from zoac.rollout.task import Task

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D

Controller = tuple[str, style.Look, Mapping[str, Any]]
"""Label, look and parameters."""

REFERENCE, LIMIT = "Reference", "Limit"

TIME_AXES = ("Time [s]", "Step")
MIN_CROSSINGS = 16
"""Eight periods: fewer are seen as they are."""
MAX_JITTER = 0.25
"""Largest standard deviation of the periods of a limit cycle, as a fraction of their mean."""
MIN_SWING = 0.1
"""Of a limit cycle, as a fraction of the range of its trace."""


@dataclass(frozen=True)
class Cycle:
    """A sustained oscillation: its period in samples, and for people to read."""

    samples: int
    period: str


@dataclass(frozen=True, eq=False)
class Loop:
    """One controller's demonstration episode, and what figures show of it."""

    label: str
    look: style.Look
    segment: Segment
    traces: list[Trace]

    @cached_property
    def cycle(self) -> Cycle | None:
        """Its limit cycle, if it is in one."""
        return limit_cycle(self.traces)


_FILM = "write a .gif or .mp4 of one run, before and after tuning, instead"


@cli.command(
    "trajectories", "Closed loops (Figs. 5 and 6).", "figures", *cli.OPTIONS,
    seed={"type": cli.seed, "help": "default: the seed of median cost of each tuner"},
    animate={"type": cli.folder, "metavar": "FILE", "help": _FILM},
    tuner={"help": "use only this tuner; --animate: default the first in the table"},
)  # fmt: skip
def main(options: argparse.Namespace) -> None:
    """Draw closed loops, or film one before and after tuning."""
    runs = chosen(cli.load_one_task(options), options.tuner, options.seed)
    if options.animate is not None:
        from zoac.analysis.figures import film

        film.write(options.animate, runs[0])
        return
    task = replay.rebuild(runs[0])
    name = runs[0].method.task
    loops = loops_of(task, runs) if len(runs) > 1 else before_and_after(task, runs[0])
    style.save(lambda: draw(task, loops, TASKS.get(name, name)), options, f"trajectories_{name}")


def loops_of(task: Task, runs: Sequence[Run]) -> list[Loop]:
    """Drive the tuned controller of each run through the demonstration."""
    methods = [run.method for run in runs]
    labels, looks = method_labels(methods, tuner_names(runs)), style.looks(methods)
    return _driven(
        task, [(labels[r.method], looks[r.method], r.outcome["parameters"]) for r in runs]
    )


def before_and_after(task: Task, run: Run, compared: Before | None = None) -> list[Loop]:
    """Drive the controllers of a run before and after tuning through the demonstration.

    Before are, unless told, its baseline values, or else where it began.
    """
    compared = compared or before(run)
    controllers: list[Controller] = [("After", style.AFTER, run.outcome["parameters"])]
    if compared is not None and compared.parameters is not None and run.tuned:
        controllers.insert(0, ("Before", style.BEFORE, compared.parameters))
    return _driven(task, controllers)


def _driven(task: Task, controllers: Sequence[Controller]) -> list[Loop]:
    segments = replay.demonstrate(task, [parameters for *_, parameters in controllers])
    return [
        Loop(label, look, segment, task.traces(segment))
        for (label, look, _), segment in zip(controllers, segments, strict=True)
    ]


def draw(task: Task, loops: Sequence[Loop], title: str) -> Figure:
    """Return a figure with one panel per trace and one line per loop."""
    count = len(loops[0].traces)
    columns = 2 if count in (2, 4) else min(3, count)
    figure, grid = style.panels(count, columns, 1.55, 0.4)
    last = replay.settled(task, [loop.segment for loop in loops])
    for k, axes in enumerate(grid):
        draw_panel(axes, loops, k, last)
    entries = style.entries(figure)
    entries |= {name: entries.pop(name) for name in (REFERENCE, LIMIT) if name in entries}
    style.legend_above(figure, entries)
    if title and len(entries) < 2:
        figure.suptitle(title)
    return figure


def draw_panel(axes: Axes, loops: Sequence[Loop], k: int, last: int) -> None:
    """Draw the `k`-th trace of each loop, up to step `last`, into `axes`."""
    longest = max((loop.traces[k] for loop in loops), key=lambda trace: len(trace.x))
    if longest.reference is not None:
        x, y = longest.reference
        shown = x <= longest.x[: last + 1].max()
        axes.plot(x[shown], y[shown], color=style.GREY, linewidth=2.4, alpha=0.55,
                  solid_capstyle="butt", label=REFERENCE)  # fmt: skip
    several = sum(loop.cycle is not None for loop in loops) > 1
    for loop in loops:
        trace, colour = loop.traces[k], loop.look.colour
        (line,) = axes.plot(trace.x[: last + 1], trace.y[: last + 1], color=colour,
                            linestyle=loop.look.dashes, label=loop.label)  # fmt: skip
        if loop.cycle is not None:
            shade(axes, line, trace, loop.cycle, several)
        if loop.segment.terminated and loop.segment.length <= last:
            axes.plot(trace.x[-1:], trace.y[-1:], "x", color=colour, markersize=5)
    low, high = axes.get_ylim()
    for limit in longest.limits:
        if low - 0.3 * (high - low) <= limit <= high + 0.3 * (high - low):
            axes.axhline(limit, color=style.INK, lw=0.8, ls="-.", label=LIMIT)
    axes.set_xlabel(longest.x_label)
    axes.set_ylabel(longest.title)
    axes.margins(x=0.01)


def shade(axes: Axes, line: Line2D, trace: Trace, cycle: Cycle, several: bool = False) -> None:
    """Shade what a trace in a limit cycle swings between, behind what settles; tell its period.

    Its line is drawn thin. Of several such traces the extremes are drawn in place of the lines,
    which would cover one another.
    """
    x = np.asarray(line.get_xdata())
    low, high = (edge[: len(x)] for edge in envelope(trace, cycle))
    axes.fill_between(x, low, high, lw=0, alpha=0.1 if several else 0.25, color=line.get_color())
    told = f"{line.get_label()} (limit cycle, {cycle.period})"
    line.set(linewidth=0.8 if several else 0.5, zorder=1.5, label=told)
    if several:
        line.set_ydata(high)
        axes.plot(x, low, color=line.get_color(), ls=line.get_linestyle(), lw=0.8, zorder=1.5)


def limit_cycle(traces: Sequence[Trace]) -> Cycle | None:
    """Return the sustained oscillation of a closed loop, None if it settles or swings slowly.

    A trace over time has one if it crosses its mean in the second half at least `MIN_CROSSINGS`
    times, after periods that are alike, and swings in the last quarter at least half as far as in
    the quarter before.
    """
    for trace in traces:
        if trace.x_label not in TIME_AXES:
            continue
        half = trace.y[len(trace.y) // 2 :]
        swings = [float(np.ptp(quarter)) for quarter in np.array_split(half, 2) if len(quarter)]
        if len(swings) < 2 or swings[1] < max(0.5 * swings[0], MIN_SWING * np.ptp(trace.y)):
            continue
        above = half > half.mean()
        crossings = np.flatnonzero(above[1:] != above[:-1])
        periods = np.diff(crossings[::2])
        if len(crossings) < MIN_CROSSINGS or periods.std() > MAX_JITTER * periods.mean():
            continue
        samples = float(periods.mean())
        seconds = samples * float(trace.x[1] - trace.x[0])
        unit = "s" if trace.x_label.endswith("[s]") else "steps"
        return Cycle(round(samples), f"{seconds:.2g} {unit}")
    return None


def envelope(trace: Trace, cycle: Cycle) -> tuple[np.ndarray, np.ndarray]:
    """Return the least and the largest value within a period around each sample."""
    count = len(trace.y)
    width = max(1, min(cycle.samples, count))
    first = np.clip(np.arange(count) - width // 2, 0, count - width)
    windows = np.lib.stride_tricks.sliding_window_view(trace.y, width)[first]
    return windows.min(axis=1), windows.max(axis=1)


if __name__ == "__main__":
    raise SystemExit(main())
