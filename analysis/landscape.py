"""Parameters while they are tuned, beside the cost along each of them (Fig. 4).

    python -m zoac.analysis.landscape runs --task pid_acc --tuner zoac --out figures

The cost along a parameter is a Monte Carlo mean over fixed evaluation episodes, with the other
parameters held where the median run ended.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from zoac.analysis.data import cli, replay
from zoac.analysis.data.runs import Run, by_method
from zoac.analysis.data.selection import chosen, median_run
from zoac.analysis.figures import style
from zoac.analysis.figures.labels import big_axis, needs_log, unit_label
from zoac.core.errors import ConfigError, suggest
from zoac.core.parameters import Parameter, ParameterSpace
from zoac.rollout.task import Task

MIN_SPAN = 0.1
"""Smallest range of a cost axis, as a fraction of the cost."""


@dataclass(frozen=True, eq=False)
class Slice:
    """Cost along one parameter, the others held: physical values (P,) and costs (P, E)."""

    parameter: Parameter
    values: np.ndarray
    costs: np.ndarray


@cli.command(
    "landscape", "Parameters and cost landscape (Fig. 4).", "figures", *cli.OPTIONS,
    tuner={"default": "zoac", "help": "default: zoac"},
    parameters={"help": "names, with commas between; default: all"},
    points={"type": cli.count, "default": 25, "help": "along each parameter; default: 25"},
    episodes={"type": cli.count, "default": 8, "help": "per point; default: 8"},
)  # fmt: skip
def main(options: argparse.Namespace) -> None:
    """Draw parameters and landscape of one method."""
    collection = cli.load_one_task(options)
    method = chosen(collection, options.tuner)[0].method
    runs = by_method(collection.finished)[method]
    task = replay.rebuild(runs[0])
    names = options.parameters.split(",") if options.parameters else _numbers(task.space)
    slices = sliced(task, median_run(runs), names, options.points, options.episodes)
    style.save(lambda: draw(runs, slices), options, f"landscape_{method.task}_{method.tuner}")


def sliced(task: Task, run: Run, names: Sequence[str], points: int, episodes: int) -> list[Slice]:
    """Return the cost along each named parameter, the others as `run` left them.

    Raises:
        ConfigError: If a parameter is unknown, or a choice, which has no axis; or all are.
    """
    space: ParameterSpace = task.space
    if not _numbers(space):
        raise ConfigError(
            "no parameter has an axis to draw: all are choices "
            f"({', '.join(space.names)}); expected one that is a number"
        )
    for name in names:
        if name not in _numbers(space):
            raise ConfigError(f"unknown parameter {name!r}; {suggest(name, _numbers(space))}")
    grid = np.tile(space.normalise(run.outcome["parameters"]), (len(names), points, 1))
    for k, name in enumerate(names):
        grid[k, :, space.coordinates.index(name)] = np.linspace(-1.0, 1.0, points)
    seed = int(run.config["evaluation"]["seed"])
    print(f"rolling out {len(names) * points * episodes} episodes", file=sys.stderr)
    costs = replay.costs(task, grid.reshape(-1, space.dimension), episodes, seed)
    costs = costs.reshape(len(names), points, episodes)
    return [
        Slice(space.parameters[index], space.values(grid[k])[:, index], costs[k])
        for k, index in enumerate(space.names.index(name) for name in names)
    ]


def _numbers(space: ParameterSpace) -> list[str]:
    """Return the names of the parameters that are numbers: choices have no axis."""
    return [p.name for p in space.parameters if p.kind != "choice"]


def draw(runs: Sequence[Run], slices: Sequence[Slice]) -> style.Figure:
    """Return a figure with two panels per parameter on one axis: evolution and cost."""
    pairs = min(2 if len(slices) <= 4 else 3, len(slices))
    ratios = [1.6, 1.0] * pairs
    figure, grid = style.panels(2 * len(slices), 2 * pairs, 1.5, 0.3, width_ratios=ratios)
    if pairs == 1:
        figure.set_figwidth(style.COLUMN)
    for k, part in enumerate(slices):
        evolution, cost = grid[2 * k : 2 * k + 2]
        cost.sharey(evolution)
        _draw_evolution(evolution, runs, part.parameter)
        _draw_cost(cost, part)
        if k + pairs >= len(slices):
            big_axis(evolution, "Steps")
            cost.set_xlabel("Cost")
        else:
            evolution.tick_params(labelbottom=False)
    style.legend_above(figure, style.entries(figure))
    return figure


def _draw_evolution(axes: style.Axes, runs: Sequence[Run], parameter: Parameter) -> None:
    """Draw a parameter of each seed, the median one on top."""
    look, median = style.looks([runs[0].method])[runs[0].method], median_run(runs)
    for run in sorted(runs, key=lambda run: run is median):
        # The compact format keeps only the final parameters, unless it was told otherwise.
        rows = [row for row in run.metrics if row["kind"] == "eval" and "parameters" in row]
        steps = [row["env_steps"] for row in rows]
        values = [row["parameters"][parameter.name] for row in rows]
        other = run is not median
        label = "Other seeds" if other else f"Seed {run.seed}, median cost"
        colour, width = (style.GREY, 0.6) if other else (look.colour, 1.4)
        axes.plot(steps, values, color=colour, linewidth=width, label=label)
        axes.plot(steps[-1:], values[-1:], "o", color=colour, markersize=2.4, clip_on=False)
    nominal = (runs[0].identity["nominal"] or {}).get(parameter.name)
    if nominal is not None:
        line = {"color": style.NOMINAL.colour, "linestyle": style.NOMINAL.dashes}
        axes.axhline(nominal, linewidth=0.9, label="Baseline", **line)
    if parameter.scale == "log" and parameter.low > 0:
        axes.set_yscale("log")
    axes.set_ylim(parameter.low, parameter.high)
    axes.set_ylabel(unit_label(parameter.name, parameter.unit))


def _draw_cost(axes: style.Axes, part: Slice) -> None:
    """Draw the cost along a parameter, its band and its least value."""
    costs = np.where(np.isfinite(part.costs), part.costs, np.nan)
    mean = costs.mean(axis=1)
    finite = mean[np.isfinite(mean)]
    axes.plot(mean, part.values, color=style.INK, linewidth=1.1, label="Mean cost")
    low, high = np.quantile(costs, [0.1, 0.9], axis=1)
    told = "10% to 90% of the episodes"
    axes.fill_betweenx(part.values, low, high, color="#d4d4d4", lw=0, label=told)
    axes.tick_params(labelleft=False)
    if not finite.size:
        return
    least, most = float(finite.min()), float(finite.max())
    axes.plot(least, part.values[mean == least][0], "*", color=style.LOOKS["bo"].colour, ms=6,
              zorder=5, label="Least mean cost")  # fmt: skip
    if needs_log(finite):
        axes.set_xscale("log")
    else:
        # The line of a parameter that hardly matters must look flat.
        span = max(most - least, MIN_SPAN * abs(least))
        axes.set_xlim(least - 0.1 * span, least + 1.1 * span)
        from matplotlib.ticker import MaxNLocator

        axes.xaxis.set_major_locator(MaxNLocator(2))
        axes.ticklabel_format(axis="x", useOffset=False)


if __name__ == "__main__":
    raise SystemExit(main())
