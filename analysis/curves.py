"""Learning curves (Fig. 3): `python -m zoac.analysis.curves runs --out figures`.

Mean over seeds of any logged number, against environment steps or time, with the 95% interval
of `zoac.analysis.statistics.intervals` shaded; for fewer than five seeds, their range. Of more than
four methods the interval stands right of the curves, at the end alone.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from zoac.analysis.data import cli
from zoac.analysis.data.fairness import refuse_unequal, unmixed
from zoac.analysis.data.runs import Collection, Method, Run
from zoac.analysis.figures import style
from zoac.analysis.figures.labels import (
    METRICS,
    TASKS,
    big_axis,
    family,
    method_labels,
    needs_log,
    tuner_names,
)
from zoac.analysis.statistics.intervals import Scores, mean, summarise
from zoac.core.errors import ConfigError, suggest
from zoac.core.seeding import stream
from zoac.core.types import is_number

AXES = ("env_steps", "wall_seconds", "compute_seconds")
MAX_BANDS = 4
"""Bands of more curves in one panel cover one another."""

MAX_POINTS = 100
"""Of a curve; against time, evaluations of different seeds never coincide."""


@dataclass(frozen=True, eq=False)
class Curve:
    """One method: centre, and a band around it, each (K,) at `x`; one value if not tuned."""

    method: Method
    x: np.ndarray
    centre: np.ndarray
    low: np.ndarray
    high: np.ndarray


@dataclass(frozen=True, eq=False)
class Panel:
    """One picture: a metric on a family of tasks.

    Args:
        task: Name of the task.
        metric: Name of the logged number.
        curves: One per method.
        names: Names of tuners, see `tuner_names`.
        studies: Whether the x axis counts experiments, not steps.
        episodes: Evaluation episodes of which a cost is the mean.
    """

    task: str
    metric: str
    curves: tuple[Curve, ...]
    names: Mapping[str, str] = field(default_factory=dict)
    studies: bool = False
    episodes: int = 1


@cli.command(
    "curves", "Learning curves (Fig. 3).", "figures", "variant", "format",
    task={"help": "default: all tasks"},
    tuners={"metavar": "NAME,...", "help": "show only these, such as zoac,zoac_reg,bo"},
    metric={"help": "any logged number; default: cost and prediction error"},
    against={"choices": AXES, "default": AXES[0]},
)  # fmt: skip
def main(options: argparse.Namespace) -> None:
    """Draw learning curves."""
    collection = cli.load_runs(options).of_variant(options.variant)
    if options.tuners is not None:
        collection = collection.of_rows(options.tuners.split(","))
    panels = all_panels(collection, options.task, options.metric, options.against)
    style.save(lambda: draw(panels, options.against), options, "curves")


def all_panels(
    collection: Collection,
    task: str | None = None,
    metric: str | None = None,
    against: str = "env_steps",
) -> list[Panel]:
    """Return the panels of Fig. 3: cost on each family of tasks, prediction error where logged.

    Args:
        collection: The runs; unfinished ones are left out.
        task: Keep to this task and its regularised twin.
        metric: Show this instead.
        against: One of `AXES`.

    Raises:
        ConfigError: If no method logged that in all of its seeds.
        RunFolderError: If runs must not be averaged or compared, or none is finished.
    """
    if task is not None:
        collection = collection.of_task(*family(task))
    runs = collection.some_finished()
    panels = []
    # PID-ACC comes first, as in the paper.
    known = list(TASKS)
    bases = sorted({family(run.method.task)[0] for run in runs})
    for base in sorted(bases, key=lambda task: known.index(task) if task in known else len(known)):
        of_task = [run for run in runs if run.method.task in family(base)]
        groups = unmixed(of_task).values()
        refuse_unequal([group[0] for group in groups])
        evaluations = [r for run in of_task for r in run.metrics if r["kind"] == "eval"]
        episodes = min(len(r["cost_per_episode"]) for r in evaluations)
        studies = all("study" in run.identity for run in of_task)
        for name in [metric] if metric else ["cost_mean", "prediction_error"]:
            if name in _logged(of_task):
                curves = [_curve(group, name, against, episodes) for group in groups]
                if drawn := tuple(c for c in curves if c is not None):
                    panels.append(Panel(base, name, drawn, tuner_names(runs), studies, episodes))
                    for group, curve in zip(groups, curves, strict=True):
                        if curve is None:
                            print(f"left out {_lacking(group, name, against)}", file=sys.stderr)
    if not panels:
        if metric and metric not in (logged := _logged(runs)):
            raise ConfigError(f"no run logged {metric!r}; {suggest(metric, logged)}")
        lacking = _lacking(runs, metric or "cost_mean", against)
        raise ConfigError(f"no method has a curve in all of its seeds: {lacking}")
    return panels


def _lacking(runs: Sequence[Run], metric: str, against: str) -> str:
    """Return which method and seed lacks a curve, in words."""
    run = next(run for run in runs if not len(series(run, metric, against, 1)[0]))
    return f"{run.method}: seed {run.seed} logged no {metric!r} against {against}"


def draw(panels: Sequence[Panel], against: str) -> style.Figure:
    """Return a figure with the panels side by side and one legend above them."""
    figure, grid = style.panels(len(panels), min(3, len(panels)), 2.3, 0.1)
    methods = sorted({c.method for p in panels for c in p.curves}, key=lambda m: m.rank)
    looks, labels = style.looks(methods), method_labels(methods, panels[0].names)
    for k, (panel, axes) in enumerate(zip(panels, grid, strict=True)):
        draw_panel(axes, panel, looks, labels, against)
        title = TASKS.get(panel.task, panel.task)
        axes.set_title(f"({chr(ord('a') + k)}) {title}" if len(panels) > 1 else title)
    shown = style.entries(figure)
    style.legend_above(figure, {labels[m]: shown[labels[m]] for m in methods})
    return figure


def draw_panel(
    axes: style.Axes,
    panel: Panel,
    looks: Mapping[Method, style.Look],
    labels: Mapping[Method, str],
    against: str,
) -> None:
    """Draw one panel's curves into `axes`."""
    several = sum(len(curve.x) > 1 for curve in panel.curves) > MAX_BANDS
    end = max(curve.x[-1] for curve in panel.curves)
    for k, curve in enumerate(sorted(panel.curves, key=lambda c: c.method.rank)):
        look, label = looks[curve.method], labels[curve.method]
        if len(curve.x) == 1:
            axes.axhline(
                curve.centre[0], color=look.colour, linestyle=look.dashes, linewidth=1.2,
                label=label,
            )  # fmt: skip
            continue
        every = max(1, len(curve.x) // 8)
        axes.plot(curve.x, curve.centre, label=label, markevery=every, **look.line)
        if not several:
            style.band(axes, curve.x, curve.low, curve.high, look)
            continue
        centre, low, high = (float(part[-1]) for part in (curve.centre, curve.low, curve.high))
        axes.errorbar(
            end * (1.04 + 0.022 * k), centre, [[centre - low], [high - centre]],
            **look.line, elinewidth=0.9, capsize=1.5,
        )  # fmt: skip
    centres = np.concatenate([curve.centre for curve in panel.curves])
    above = centres[centres > 0]
    if not (centres < 0).any() and needs_log(above):
        axes.set_yscale("log")
        # A band may reach down to zero; the axis follows the curves.
        lowest = min(curve.low[curve.centre > 0].min(initial=np.inf) for curve in panel.curves)
        axes.set_ylim(bottom=0.8 * max(lowest, 0.5 * above.min()))
    axes.set_ylabel(METRICS.get(panel.metric, panel.metric))
    axes.margins(x=0.02)
    if several:
        axes.set_xticks([tick for tick in axes.get_xticks() if 0 <= tick <= 1.001 * end])
        axes.text(0.99, 0.98, "at the end", size="x-small", ha="right", va="top",
                  transform=axes.transAxes)  # fmt: skip
    of_studies = panel.studies and against == "env_steps"
    big_axis(axes, "Experiments" if of_studies else METRICS[against])


def series(run: Run, metric: str, against: str, episodes: int) -> tuple[np.ndarray, np.ndarray]:
    """Return where `metric` was logged along `against`, and its values, each (K,).

    Costs are means over the first `episodes` of each evaluation: those that all evaluations have,
    so that curves, and the end of a curve with its middle, compare.
    """
    logged = [r for r in run.metrics if metric in r and against in r]
    # Tuners may log a number of the same name about what they tried.
    rows = [r for r in logged if r["kind"] == "eval"] or logged
    values = [
        np.mean(r["cost_per_episode"][:episodes]) if metric == "cost_mean" else r[metric]
        for r in rows
    ]
    return np.array([r[against] for r in rows], float), np.array(values, float)


def _curve(runs: Sequence[Run], metric: str, against: str, episodes: int) -> Curve | None:
    """Return the curve of a method over its seeds; None if one of them logged nothing."""
    tracks = [series(run, metric, against, episodes) for run in runs]
    if not all(len(x) for x, _ in tracks):
        return None
    method, tuned = runs[0].method, runs[0].tuned
    if tuned:
        first, last = max(x[0] for x, _ in tracks), min(x[-1] for x, _ in tracks)
        x = np.unique(np.concatenate([t for t, _ in tracks]).clip(first, last))
        if len(x) > MAX_POINTS:
            x = np.linspace(first, last, MAX_POINTS)
        # Between two evaluations the earlier one counts.
        values = np.array([y[np.searchsorted(t, x, side="right") - 1] for t, y in tracks])
    else:
        x, values = np.zeros(1), np.array([[y[-1]] for _, y in tracks])
    centre, low, high = mean(values.T), values.min(axis=0), values.max(axis=0)
    for k in range(len(x)):
        if not np.isfinite(values[:, k]).all():
            centre[k] = low[k] = high[k] = np.nan
            continue
        rng = stream(0, f"analysis {method} {metric}", k)
        scores = Scores(values[:, k : k + 1], tuned=tuned)
        interval = summarise(scores, rng, resamples=2000)
        if interval.exists:
            low[k], high[k] = interval.low, interval.high
    return Curve(method, x, centre, low, high)


def _logged(runs: Iterable[Run]) -> set[str]:
    rows = [row for run in runs for row in run.metrics]
    return {name for row in rows for name, value in row.items() if is_number(value)} - set(AXES)


if __name__ == "__main__":
    raise SystemExit(main())
