"""Costs of a run's parameters on other plants, and around the parameters themselves."""

import json
import sys
from collections.abc import Mapping, Sequence
from copy import deepcopy
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from zoac.analysis.data import replay
from zoac.analysis.data.runs import Run
from zoac.core.errors import ConfigError, RunFolderError, as_text, suggest
from zoac.core.seeding import stream
from zoac.core.types import is_number
from zoac.rollout.task import Task
from zoac.runs import schema

STEP = 0.1
"""Step of the sensitivity in a normalised coordinate: a twentieth of the range."""

TUNED, BASELINE = "tuned", "baseline"


@dataclass(frozen=True, eq=False)
class Variation:
    """Costs of controllers on varied plants; all are empty where nothing was varied.

    Args:
        plants: Value of each varied number on each plant, (P,) by name; the task's own plant first.
        costs: (P, E) by controller.
        ranges: From which the plants were drawn, by name.
    """

    plants: Mapping[str, np.ndarray]
    costs: Mapping[str, np.ndarray]
    ranges: Mapping[str, tuple[float, float]]

    @property
    def size(self) -> tuple[int, int]:
        """Number of drawn plants, and of episodes on each."""
        plants, episodes = next(iter(self.costs.values())).shape
        return plants - 1, episodes

    def __str__(self) -> str:
        return ", ".join(f"{n} in [{low:g}, {high:g}]" for n, (low, high) in self.ranges.items())


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


def vary(
    run: Run, ranges: Mapping[str, tuple[float, float]], plants: int, episodes: int
) -> Variation:
    """Return the costs of a run's parameters, and of the baseline, on drawn plants.

    Args:
        run: A finished run.
        ranges: Range of each varied number, by name; plants are drawn uniformly.
        plants: Number of plants.
        episodes: Number of episodes, the same on all plants and for all controllers.

    Raises:
        ConfigError: If a name is not a number of the plant, or one of its bounds is not whole where
            the number is.
    """
    if not ranges:
        return Variation({}, {}, {})
    task = replay.rebuild(run)
    rng = stream(0, "robustness")
    drawn = {name: _drawn(run, task, name, bounds, plants, rng) for name, bounds in ranges.items()}
    points = {TUNED: task.space.normalise(run.outcome["parameters"])}
    if task.baseline is not None:
        points[BASELINE] = task.space.normalise(task.baseline)
    print(f"rolling out {(plants + 1) * len(points) * episodes} episodes", file=sys.stderr)
    seed, x = int(run.config["evaluation"]["seed"]), np.stack(list(points.values()))
    rows = [replay.costs(task, x, episodes, seed)]
    for k in range(plants):
        other = on_plant(run, task, {name: values[k].item() for name, values in drawn.items()})
        rows.append(replay.costs(other, x, episodes, seed))
    costs = np.stack(rows, axis=1)
    own = _numbers(run.config["task"])
    return Variation(
        {name: np.concatenate([[own.get(name, np.nan)], v]) for name, v in drawn.items()},
        dict(zip(points, costs, strict=True)),
        ranges,
    )


def _drawn(
    run: Run,
    task: Task,
    name: str,
    bounds: tuple[float, float],
    count: int,
    rng: np.random.Generator,
) -> np.ndarray:
    """Return values of one number, (count,), uniform in its bounds: whole where it is whole."""
    node, attribute = run.config["task"], name.removeprefix("plant.")
    if hasattr(task, "varied") and ("_target_" not in node or name != attribute):
        plant = task.varied({attribute: bounds})
        return np.array([plant.draw(rng)[attribute] for _ in range(count)])
    low, high = map(float, bounds)
    if isinstance(_numbers(node).get(name), int) and low.is_integer() and high.is_integer():
        return rng.integers(int(low), int(high), count, endpoint=True)
    return rng.uniform(low, high, count)


def on_plant(run: Run, task: Task, values: Mapping[str, float]) -> Task:
    """Return a run's task on a plant with other numbers, by dotted option or `plant.NAME`.

    Raises:
        ConfigError: If a name is not a number among them.
    """
    node = run.config["task"]
    if "_target_" not in node:  # of `zoac.tune`
        if not hasattr(task, "with_plant"):
            raise ConfigError("--vary: this run's task has no numbers that can be set")
        return task.with_plant({n.removeprefix("plant."): v for n, v in values.items()})
    from zoac.config.factory import build_task

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
    return build_task({**run.config, "task": changed})


def _numbers(node: Mapping[str, Any], prefix: str = "") -> dict[str, float]:
    """Return every number among a task's options by dotted name."""
    found = {f"{prefix}{key}": value for key, value in node.items() if is_number(value)}
    for key, value in node.items():
        if isinstance(value, Mapping) and key != "space":
            found |= _numbers(value, f"{prefix}{key}.")
    return found


def sensitivity(run: Run, episodes: int) -> list[Sensitivity]:
    """Return how the mean cost changes along each coordinate around a run's parameters."""
    task = replay.rebuild(run)
    centre = task.space.normalise(run.outcome["parameters"])
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


def as_json(run: Run, varied: Variation, around: Sequence[Sensitivity]) -> str:
    """Return everything at full precision, which `read` reads."""
    record = {
        "run": {key: run.identity[key] for key in schema.IDENTITY},
        "plants": asdict(varied) if varied.plants else None,
        "sensitivity": [asdict(s) for s in around],
    }
    return schema.json_line(record)


def read(path: Path, run: Run) -> tuple[Variation, list[Sensitivity]] | None:
    """Return what `as_json` wrote; None if there is no such file, or it is of another run.

    Raises:
        RunFolderError: If it is damaged.
    """
    if not path.is_file():
        return None
    try:
        record = json.loads(path.read_text(encoding="utf-8"))
        if record["run"] != {key: run.identity[key] for key in schema.IDENTITY}:
            return None
        found = record["plants"] or {"plants": {}, "costs": {}, "ranges": {}}
        ranges = {name: (low, high) for name, (low, high) in found["ranges"].items()}
        varied = Variation(_arrays(found["plants"]), _arrays(found["costs"]), ranges)
        return varied, [Sensitivity(**s) for s in record["sensitivity"]]
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise RunFolderError(
            f"{path}: cannot be read ({as_text(error)}); run "
            "python -m zoac.analysis.robustness again"
        ) from None


def _arrays(lists: Mapping[str, Any]) -> dict[str, np.ndarray]:
    return {name: np.array(values, dtype=np.float64) for name, values in lists.items()}
