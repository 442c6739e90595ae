"""Measure which tuner suits how many parameters and experiments: the rule of `tuner="auto"`.

    OMP_NUM_THREADS=1 python -m benchmarks.auto_tuner        # launches what is missing
    python -m benchmarks.auto_tuner --only-table
    python -m benchmarks.auto_tuner --held-out       # four problems on which it was not chosen

One thread: the models of `bo` and `optuna` are small, and threads that wait for each other cost ten
times the CPU time.

Each tuner begins without knowing any gains: the problems have no baseline. An experiment is an
episode of full length. The table gives the median over the seeds of (cost - best) / (untuned -
best): `best` is the lowest cost that any run found on the problem, `untuned` the median cost of
random gains. Costs are those of the final episodes, which no tuner has seen and which are the same
for all. With `--held-out` the table gives their medians, and that of `tuner="auto"`.
"""

from __future__ import annotations

import argparse
import time
import warnings
from collections.abc import Iterator, Mapping, Sequence
from itertools import product
from pathlib import Path

import numpy as np

import zoac
from benchmarks.auto_problems import HELD_OUT, PROBLEMS, without_baseline
from zoac.core.segments import Proposal
from zoac.rollout.engine import RolloutEngine
from zoac.rollout.task import Task
from zoac.runs import schema

TUNERS = ("zoac", "zoac_plus", "cmaes_full", "bo", "optuna", "nevergrad")
EXPERIMENTS = (30, 100, 300)
MODELS = {"bo": 100, "optuna": 100}
"""Tuners whose models take seconds a point, and the most experiments that they are given."""

NUM_ENVS, RANDOM_POINTS = 10, 50
OF_PARTS = ("zoac", "zoac_plus")
"""Tuners that see parts of episodes; the others compare points on common random numbers."""


def run(task: Task, tuner: str, experiments: int, seed: int, folder: Path) -> None:
    """Tune once, unless the folder holds the result."""
    budget = experiments * task.horizon.steps
    zoac.tune(
        task=task,
        tuner=tuner,
        budget=budget,
        seed=seed,
        num_envs=NUM_ENVS,
        common_random_numbers=None if tuner == "auto" else tuner not in OF_PARTS,
        eval_every=budget,
        episodes=1,
        final_episodes=20,
        folder=folder,
        quiet=True,
        executor="serial",
    )


def untuned(task: Task) -> float:
    """Return the median cost of random gains, an episode each."""
    rng = np.random.default_rng(0)
    points = rng.uniform(-1.0, 1.0, (RANDOM_POINTS, task.space.dimension))
    engine = RolloutEngine(task, range(RANDOM_POINTS), range(RANDOM_POINTS))
    segments = engine.rollout([Proposal(x, k) for k, x in enumerate(points)])
    return float(np.median([s.costs.sum() for s in segments]))


Costs = Mapping[tuple[str, str, int], list[float]]
"""Costs of the seeds by problem, tuner and experiments."""


def scores(costs: Costs, untuned: Mapping[str, float]) -> dict[tuple[str, str, int], float]:
    """Return the median of (cost - best) / (untuned - best) of each entry.

    Args:
        costs: Of all runs.
        untuned: By problem.
    """
    best = {
        name: min(min(values) for (problem, *_), values in costs.items() if problem == name)
        for name in untuned
    }
    return {
        key: float(np.median([(c - best[key[0]]) / (untuned[key[0]] - best[key[0]])
                              for c in values]))
        for key, values in costs.items()
    }  # fmt: skip


def table(
    found: Mapping[tuple[str, str, int], float], sizes: Mapping[str, int], tuners: Sequence[str]
) -> str:
    """Return one Markdown table: a row per problem and number of experiments."""
    lines = [
        f"| problem | parameters | experiments | {' | '.join(tuners)} |",
        f"|---|---|---|{'---|' * len(tuners)}",
    ]
    rows = sorted({(name, count) for name, _, count in found}, key=lambda r: (sizes[r[0]], r))
    for name, count in rows:
        values = [found.get((name, tuner, count)) for tuner in tuners]
        least = min(v for v in values if v is not None)
        cells = ["" if v is None else f"**{v:.3f}**" if v == least else f"{v:.3f}" for v in values]
        lines.append(f"| {name} | {sizes[name]} | {count} | {' | '.join(cells)} |")
    return "\n".join(lines)


def jobs(
    sizes: Mapping[str, int], seeds: int, tuners: Sequence[str], experiments: Sequence[int]
) -> Iterator[tuple[str, str, int, int]]:
    """Yield problem, tuner, experiments and seed of all runs; all of one seed come first."""
    for seed, count, name, tuner in product(range(seeds), experiments, sizes, tuners):
        single = sizes[name] == 1 and tuner == "cmaes_full"  # which needs two parameters
        if not single and count <= MODELS.get(tuner, count):
            yield name, tuner, count, seed


def carry_out(folder: Path, names: Sequence[str], seeds: int, launch: bool, held_out: bool) -> str:
    """Launch what is missing; return the table of what is there.

    Args:
        folder: Of all runs.
        names: Of the problems.
        seeds: How many.
        launch: Whether to launch anything.
        held_out: Whether the problems are those on which the rule was not chosen.
    """
    makers, tuners = (HELD_OUT, ("auto", *TUNERS)) if held_out else (PROBLEMS, TUNERS)
    tasks = {name: without_baseline(makers[name]) for name in names}
    sizes = {name: task.space.dimension for name, task in tasks.items()}
    costs: dict[tuple[str, str, int], list[float]] = {}
    for name, tuner, count, seed in jobs(sizes, seeds, tuners, (100,) if held_out else EXPERIMENTS):
        where = folder / name / tuner / str(count) / f"seed={seed}"
        if launch and not schema.is_done(where):
            begun = time.process_time()
            run(tasks[name], tuner, count, seed, where)
            print(f"{where}: {time.process_time() - begun:.1f} s", flush=True)
        if schema.is_done(where):
            cost = schema.read_result(where)["cost_mean"]
            costs.setdefault((name, tuner, count), []).append(cost)
    if held_out:
        medians = {key: float(np.median(values)) for key, values in costs.items()}
        return table(medians, sizes, tuners)
    return table(
        scores(costs, {name: untuned(task) for name, task in tasks.items()}), sizes, tuners
    )


def main() -> None:
    """Launch what is missing, print one table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--folder", type=Path, default=Path("auto_tuner_runs"))
    parser.add_argument("--problems", nargs="+", choices=PROBLEMS, default=list(PROBLEMS))
    parser.add_argument("--held-out", action="store_true")
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--only-table", action="store_true")
    given = parser.parse_args()
    warnings.simplefilter("ignore")
    names = list(HELD_OUT) if given.held_out else given.problems
    print(carry_out(given.folder, names, given.seeds, not given.only_table, given.held_out))


if __name__ == "__main__":
    main()
