"""How the cost of an MPC step grows, and its curves: `python -m benchmarks.qp_scaling`.

Vary horizon and states on random dense problems with two inputs, ten lanes, N 25 and six states
where not varied. Vary lanes on a thousand of the vehicle's programmes in closed loop, in calls of
so many. Vary workers on ten environments of mpc_tracking at the baseline parameters. All ways take
the same problems in turn. Print medians of CPU time per programme on one thread; for workers, of
wall time. Write them to `benchmarks/qp_scaling.csv` and draw `docs/images/scaling_solver.svg`.
`--draw` draws the numbers of that file anew and measures nothing.
"""

from __future__ import annotations

import os

for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(variable, "1")

import argparse
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd

import zoac
from benchmarks.figures import FIGURES, cycle, pyplot, save
from benchmarks.qp_solvers import LANES, closed_loop_problems
from benchmarks.qp_ways import PEERS, RICCATI, Way, cpu_seconds, installed
from tests.mpc.problems import dense_problems
from zoac.core.segments import Proposal
from zoac.mpc.problem import PER_ENV, LinearisedProblem
from zoac.rollout.executors.base import Executor, Serial
from zoac.rollout.executors.process import Process

HORIZONS = (10, 25, 50, 100, 200)
STATES = (2, 4, 6, 8, 12, 16, 24)
LANE_COUNTS = (1, 2, 5, 10, 20, 50, 100, 1000)
PROGRAMMES = 1000
SHOWN = ("riccati", "clarabel", "DAQP, condensed", "HPIPM, by CasADi")
SOLVERS = ("riccati", "clarabel")
TABLE = Path(__file__).with_suffix(".csv")
"""One row a number: time per programme [us]; for workers, steps per second with serial = 1."""
WORKERS = "workers"

Curves = dict[str, list[float]]
Panel = tuple[str, Sequence[int], Curves]
"""What varies, its sizes, and the numbers of each way."""


def grow(
    what: str,
    sizes: Sequence[int],
    problems: Callable[[int], list[LinearisedProblem]],
    ways: Mapping[str, Way],
    rounds: int,
) -> Curves:
    """Return each way's microseconds per programme at each size, and print them.

    `problems` gives those of a size, solved one after the other.
    """
    curves: Curves = {name: [] for name in ways}
    for size in sizes:
        given = problems(size)
        programmes = sum(len(problem.a) for problem in given)
        batches = {name: [run for p in given for run in way(p)] for name, way in ways.items()}
        taken: Curves = {name: [] for name in ways}
        for _ in range(rounds):
            for name, batch in batches.items():
                taken[name].append(cpu_seconds(batch[:1], batch)[0] * 1e6 / programmes)
        for name, values in taken.items():
            curves[name].append(float(np.median(values)))
    print(f"\nus per programme     {what:>8}" + "".join(f"{size:10}" for size in sizes))
    for name, values in curves.items():
        print(f"{name:29}" + "".join(f"{value:10.1f}" for value in values))
    first = curves[next(iter(curves))]
    for name, values in list(curves.items())[1:]:
        ratios = np.array(values) / first
        print(f"  {name + ', times':27}" + "".join(f"{ratio:10.1f}" for ratio in ratios))
    return curves


def merge(problems: Sequence[LinearisedProblem]) -> LinearisedProblem:
    """Return all lanes of `problems` as one problem."""
    arrays = {name: np.concatenate([getattr(p, name) for p in problems]) for name in PER_ENV}
    return replace(problems[0], **arrays)


def steps_per_second(
    solver: str, num_envs: int, workers: Sequence[int], rounds: int
) -> dict[int, list[float]]:
    """Return each round's rate for each number of workers, of which 0 means serial."""
    task = zoac.make_task("mpc_tracking", mpc_solver=solver)
    assert task.baseline is not None
    x = task.space.normalise(task.baseline)
    proposals = [Proposal(x, env_index, 20) for _ in range(5) for env_index in range(num_envs)]
    executors: dict[int, Executor] = {
        count: Process(workers=count) if count else Serial() for count in workers
    }
    rates: dict[int, list[float]] = {count: [] for count in workers}
    for executor in executors.values():
        executor.start(task, num_envs, seed=0)
        executor.rollout(proposals)  # compiles
    for _ in range(rounds):
        for count, executor in executors.items():
            begun = time.perf_counter()
            steps = sum(segment.length for segment in executor.rollout(proposals))
            rates[count].append(steps / (time.perf_counter() - begun))
    for executor in executors.values():
        executor.close()
    return rates


def over_workers(workers: Sequence[int], rounds: int) -> Curves:
    """Return steps per second by the number of workers (0: serial, counted as 1), by solver."""
    curves: Curves = {}
    for solver in SOLVERS:
        rates = steps_per_second(solver, LANES, workers, rounds)
        medians = np.array([np.median(rates[count]) for count in workers])
        curves[solver] = (medians / medians[0]).tolist()
        print(f"\nsteps/s, {solver}: " + ", ".join(
            f"{count} workers {rate:,.0f} ({ratio:.2f} x)"
            for count, rate, ratio in zip(workers, medians, curves[solver], strict=True)
        ))  # fmt: skip
    return curves


def keep(panels: Sequence[Panel], path: Path = TABLE) -> None:
    """Write the numbers of the figure, to three significant digits."""
    rows = [
        (what, size, name, float(f"{value:.3g}"))
        for what, sizes, curves in panels
        for name, values in curves.items()
        for size, value in zip(sizes, values, strict=True)
    ]
    pd.DataFrame(rows, columns=["panel", "size", "way", "value"]).to_csv(path, index=False)


def kept(path: Path = TABLE) -> list[Panel]:
    """Return what `keep` wrote."""
    return [
        (
            str(what),
            panel["size"].drop_duplicates().tolist(),
            {str(n): part["value"].tolist() for n, part in panel.groupby("way", sort=False)},
        )
        for what, panel in pd.read_csv(path).groupby("panel", sort=False)
    ]


def draw(panels: Sequence[Panel], folder: Path = FIGURES) -> None:
    """Write the figure of `docs/solver.md`."""
    figure, axes = pyplot().subplots(2, 2, figsize=(6.6, 5.2), layout="constrained")
    looks = dict(zip(SHOWN, cycle(), strict=False))
    for axis, (what, sizes, curves) in zip(axes.flat, panels, strict=True):
        for name, values in curves.items():
            axis.plot(sizes, values, label=name, **looks[name])
        if what == WORKERS:
            axis.set(xlabel="Workers (0: serial)", ylabel="Steps per second, serial = 1")
            axis.set_ylim(0.0)
        else:
            axis.set(
                xlabel=what.capitalize(),
                ylabel="Time per programme [µs]",
                xscale="log",
                yscale="log",
            )
        axis.set_xticks(sizes, [str(size) for size in sizes])
        axis.minorticks_off()
    axes[0, 0].legend(fontsize=7)
    save(figure, folder / "scaling_solver.svg")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=15)
    parser.add_argument("--workers", type=int, nargs="+", default=[1, 2], help="besides none")
    parser.add_argument("--draw", action="store_true", help="only draw what was measured last")
    options = parser.parse_args()
    if options.draw:
        draw(kept())
        return
    workers = [0, *options.workers]
    ways = installed({name: make for name, make in {**RICCATI, **PEERS}.items() if name in SHOWN})
    own = {name: ways[name] for name in SOLVERS}
    together = merge(closed_loop_problems(PROGRAMMES // LANES))

    def split(lanes: int) -> list[LinearisedProblem]:
        return [together.take(slice(k, k + lanes)) for k in range(0, PROGRAMMES, lanes)]

    def measure(
        what: str,
        sizes: Sequence[int],
        make: Callable[[int], list[LinearisedProblem]],
        which: Mapping[str, Way],
    ) -> Panel:
        return what, sizes, grow(what, sizes, make, which, options.rounds)

    panels = [
        measure("horizon", HORIZONS, lambda n: [dense_problems(LANES, n, 6, 2, 0)], ways),
        measure("states", STATES, lambda nx: [dense_problems(LANES, 25, nx, 2, 0)], ways),
        measure("environments", LANE_COUNTS, split, own),
        (WORKERS, workers, over_workers(workers, options.rounds)),
    ]
    keep(panels)
    draw(panels)


if __name__ == "__main__":
    main()
