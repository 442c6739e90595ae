"""Tuned parameters on other plants, and the cost of being a little off: table and figure.

    python -m zoac.analysis.robustness runs --task pid_acc --vary preceding_std=0.02,0.2

What may vary is every number among the task's options in `run.json`; of a Gymnasium environment,
`plant.NAME` is an attribute of it. Without --vary only the sensitivity is shown.
"""

from __future__ import annotations

import argparse
import csv
import io
import math
import sys
from collections.abc import Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from zoac.analysis import cli
from zoac.analysis.data import replay
from zoac.analysis.data.frames import numbers
from zoac.analysis.data.runs import Run
from zoac.analysis.data.selection import chosen
from zoac.analysis.figures import style
from zoac.analysis.figures.labels import unit_label
from zoac.analysis.pages.formatting import number, pipes
from zoac.core.errors import ConfigError, RunFolderError, suggest
from zoac.core.seeding import stream
from zoac.rollout.task import Task

TAIL = 0.1
"""Fraction of the costliest episodes whose mean is the tail risk (CVaR)."""

STEP = 0.1
"""Step of the sensitivity in a normalised coordinate: a twentieth of the range."""

TUNED, BASELINE = "tuned", "baseline"


@dataclass(frozen=True, eq=False)
class Variation:
    """Costs of controllers on varied plants.

    Args:
        plants: Value of each varied number on each plant, (P,) by name; the task's own plant first.
        costs: (P, E) by controller.
        ranges: From which the plants were drawn, by name.
    """

    plants: Mapping[str, np.ndarray]
    costs: Mapping[str, np.ndarray]
    ranges: Mapping[str, tuple[float, float]]


@dataclass(frozen=True)
class Sensitivity:
    """Cost around the optimum along one coordinate.

    Args:
        name: Name of the coordinate.
        below: Change of the mean cost with the coordinate lowered by `STEP`.
        above: Change of the mean cost with the coordinate raised by `STEP`.
        error: Larger standard error of the two.
    """

    name: str
    below: float
    above: float
    error: float


def main(argv: Sequence[str] | None = None) -> int:
    """Write table and figure of one run; return the exit code."""
    parser = cli.parser(
        "robustness", "Tuned parameters on varied plants.", "robustness", *cli.OPTIONS
    )
    parser.add_argument("--task", help="default: the only one there is")
    parser.add_argument("--tuner", help="default: zoac's median run, or whatever was tuned")
    parser.add_argument("--seed", type=int, help="default: the median run")
    parser.add_argument(
        "--vary", action="append", default=[], metavar="NAME=LOW,HIGH", help="may be repeated"
    )
    parser.add_argument("--plants", type=cli.count, default=20, help="plants drawn; default: 20")
    parser.add_argument("--episodes", type=cli.count, default=8, help="per plant; default: 8")
    return cli.guarded(_command, parser, argv)


def _command(options: argparse.Namespace) -> None:
    ranges = dict(_parsed(text) for text in options.vary)
    run = chosen(cli.load_one_task(options), options.tuner, options.seed)[0]
    print(f"{run.folder}: {run.method}, seed {run.seed}", file=sys.stderr)
    varied = vary(run, ranges, options.plants, options.episodes) if ranges else None
    around = sensitivity(run, options.episodes)
    text = markdown(run, varied, around)
    print(text)
    cli.write(options.out / "robustness.md", text)
    cli.write(options.out / "robustness.csv", table(varied, around))
    style.save(lambda: draw(varied, around), options, "robustness")


def _parsed(text: str) -> tuple[str, tuple[float, float]]:
    name, _, bounds = text.partition("=")
    try:
        low, high = (float(part) for part in bounds.split(","))
    except ValueError:
        raise ConfigError(f"--vary {text}: expected NAME=LOW,HIGH") from None
    if not math.isfinite(high - low):  # so that a number between them can be drawn
        raise ConfigError(f"--vary {text}: expected finite bounds, a finite distance apart")
    if low > high:
        raise ConfigError(f"--vary {text}: the lower bound must not be above the upper")
    return name, (low, high)


def vary(
    run: Run, ranges: Mapping[str, tuple[float, float]], plants: int, episodes: int
) -> Variation:
    """Return the costs of a run's parameters, and of the baseline, on drawn plants.

    Args:
        run: A finished run.
        ranges: Range of each varied number, by name; plants are drawn uniformly.
        plants: Number of plants.
        episodes: Number of episodes on each plant, the same for all plants and controllers.

    Raises:
        ConfigError: If a name is not a number of the plant.
    """
    task = replay.rebuild(run)
    rng = stream(0, "robustness")
    drawn = {name: rng.uniform(low, high, plants) for name, (low, high) in ranges.items()}
    points = _points(run, task)
    print(f"rolling out {(plants + 1) * len(points) * episodes} episodes", file=sys.stderr)
    seed = int(run.config["evaluation"]["seed"])
    rows = [replay.costs(task, np.stack(list(points.values())), episodes, seed)]
    for k in range(plants):
        other = on_plant(run, task, {name: float(values[k]) for name, values in drawn.items()})
        rows.append(replay.costs(other, np.stack(list(points.values())), episodes, seed))
    costs = np.stack(rows, axis=1)
    own = {name: _own_value(run, name) for name in ranges}
    return Variation(
        {name: np.concatenate([[own[name]], values]) for name, values in drawn.items()},
        dict(zip(points, costs, strict=True)),
        ranges,
    )


def on_plant(run: Run, task: Task, values: Mapping[str, float]) -> Task:
    """Return a run's task on a plant with other numbers.

    Args:
        run: The run, for its configuration.
        task: The task of the run.
        values: Numbers by dotted name among the task's options, or `plant.NAME`.

    Raises:
        ConfigError: If a name is not a number among them.
    """
    node = run.config["task"]
    if "_target_" not in node:  # of `zoac.tune`
        if not hasattr(task, "with_plant"):
            raise ConfigError("--vary: this run's task has no numbers that can be set")
        return task.with_plant({n.removeprefix("plant."): v for n, v in values.items()})
    from zoac.runs.result import task_from_config

    changed = deepcopy(dict(node))
    known = _numbers(node)
    for name, value in values.items():
        *parents, last = name.split(".")
        if name not in known and parents != ["plant"]:
            raise ConfigError(f"--vary: no number {name!r} in the task; {suggest(name, known)}")
        inner = changed
        for parent in parents:
            if inner.get(parent) is None:
                inner[parent] = {}
            inner = inner[parent]
        inner[last] = value
        if parents == ["plant"] and changed.get("vary"):
            changed["vary"].pop(last, None)
    return task_from_config({**run.config, "task": changed})


def _numbers(node: Mapping[str, Any], prefix: str = "") -> dict[str, float]:
    """Return every number among a task's options by dotted name."""
    found = {f"{prefix}{key}": float(value) for key, value in numbers(node).items()}
    for key, value in node.items():
        if isinstance(value, Mapping) and key != "space":
            found |= _numbers(value, f"{prefix}{key}.")
    return found


def _own_value(run: Run, name: str) -> float:
    return _numbers(run.config["task"]).get(name, float("nan"))


def _points(run: Run, task: Task) -> dict[str, np.ndarray]:
    """Return the normalised parameters of each controller that is compared."""
    points = {TUNED: np.array(_normalised(run, task))}
    if task.baseline is not None:
        points[BASELINE] = task.space.normalise(task.baseline)
    return points


def _normalised(run: Run, task: Task) -> np.ndarray:
    names = task.space.names
    parameters = run.outcome["parameters"]
    missing = [name for name in names if name not in parameters]
    if missing:
        raise RunFolderError(f"{run.folder}: result.json has no {', '.join(missing)}")
    return task.space.normalise({name: parameters[name] for name in names})


def sensitivity(run: Run, episodes: int) -> list[Sensitivity]:
    """Return how the mean cost changes along each coordinate around a run's parameters.

    Args:
        run: A finished run.
        episodes: The same for every point.
    """
    task = replay.rebuild(run)
    centre = _normalised(run, task)
    steps = np.diag(np.full(task.space.dimension, STEP))
    points = task.space.clip(np.concatenate([centre[None], centre - steps, centre + steps]))
    costs = replay.costs(task, points, episodes, int(run.config["evaluation"]["seed"]))
    changes = costs[1:] - costs[0]
    means = changes.mean(axis=1).reshape(2, -1)
    errors = changes.std(axis=1, ddof=min(1, episodes - 1)).reshape(2, -1) / np.sqrt(episodes)
    return [
        Sensitivity(name, float(below), float(above), float(error))
        for name, (below, above), error in zip(
            task.space.coordinates, means.T, errors.max(axis=0), strict=True
        )
    ]


def tail_risk(costs: np.ndarray, fraction: float = TAIL) -> float:
    """Return the mean of the costliest `fraction` of costs, at least one (CVaR)."""
    ordered = np.sort(np.ravel(costs))[::-1]
    return float(ordered[: max(1, round(fraction * len(ordered)))].mean())


def _summary(varied: Variation) -> list[list[str]]:
    lines = [["Controller", "Own plant", "Mean", f"Worst {TAIL:.0%}, mean", "Worst"]]
    for name, costs in varied.costs.items():
        others = costs[1:]
        values = (costs[0].mean(), others.mean(), tail_risk(others), others.max())
        lines.append([name, *(number(float(v)) for v in values)])
    return lines


def markdown(run: Run, varied: Variation | None, around: Sequence[Sensitivity]) -> str:
    """Return both tables as Markdown."""
    parts = [f"# Robustness of {run.method}, seed {run.seed}"]
    if varied is not None:
        plants, episodes = next(iter(varied.costs.values())).shape
        ranges = ", ".join(
            f"{name} in [{low:g}, {high:g}]" for name, (low, high) in varied.ranges.items()
        )
        parts += [
            f"Cost over {plants - 1} plants of {episodes} episodes each: {ranges}.",
            pipes(_summary(varied)),
        ]
    lines = [["Parameter", "A little less", "A little more", "Standard error"]]
    lines += [
        [s.name, number(s.below, sign=True), number(s.above, sign=True), number(s.error)]
        for s in sorted(around, key=lambda s: -max(abs(s.below), abs(s.above)))
    ]
    parts += [f"Change of the mean cost with one parameter moved by {STEP / 2:.0%} of its range:"]
    return "\n\n".join([*parts, pipes(lines)]) + "\n"


def table(varied: Variation | None, around: Sequence[Sensitivity]) -> str:
    """Return every number at full precision, one row per controller and plant or parameter."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    names = [] if varied is None else list(varied.plants)
    writer.writerow(["kind", "name", "plant", *names, "cost_mean", "cost_tail", "cost_worst"])
    if varied is not None:
        for controller, costs in varied.costs.items():
            for k, row in enumerate(costs):
                plant = [repr(float(drawn[k])) for drawn in varied.plants.values()]
                values = (row.mean(), tail_risk(row), row.max())
                writer.writerow(["plant", controller, k, *plant, *(repr(float(v)) for v in values)])
    gaps = [""] * (len(names) + 1)
    for s in around:
        for direction, value in (("below", s.below), ("above", s.above)):
            writer.writerow([direction, s.name, *gaps, repr(value), "", ""])
    return out.getvalue()


def draw(varied: Variation | None, around: Sequence[Sensitivity]) -> Figure:
    """Return a figure: cost against each varied number, and the sensitivity."""
    names = [] if varied is None else list(varied.plants)
    figure = Figure(figsize=(style.PAGE, max(2.2, 0.5 + 0.16 * len(around))), layout="constrained")
    panels = figure.subplots(1, len(names) + 1, squeeze=False)[0]
    for axes, name in zip(panels, names, strict=False):
        assert varied is not None
        for slot, (controller, costs) in enumerate(varied.costs.items()):
            look = style.look(slot)
            x = varied.plants[name]
            axes.plot(x, costs.mean(axis=1), look.marker, color=look.colour, label=controller, ms=3)
            axes.plot(x, costs.max(axis=1), look.marker, color=look.colour, ms=2, alpha=0.4)
        axes.set_xlabel(unit_label(name, ""))
        axes.set_ylabel("Cost: mean, and worst (faint)" if axes is panels[0] else "")
    if names:
        panels[0].legend()
    axes, order = panels[-1], sorted(around, key=lambda s: max(abs(s.below), abs(s.above)))
    rows = np.arange(len(order))
    for shift, look, label, values in (
        (-0.2, style.look(0), "less", [s.below for s in order]),
        (0.2, style.look(1), "more", [s.above for s in order]),
    ):
        axes.barh(rows + shift, values, height=0.4, color=look.colour, label=label)
    axes.set_yticks(rows, [s.name for s in order])
    axes.set_xlabel(f"Change of cost, {STEP / 2:.0%} of the range off")
    axes.legend()
    return figure


if __name__ == "__main__":
    raise SystemExit(main())
