"""How the cost of an MPC step grows, and its curves: `python -m benchmarks.qp_scaling`.

Vary horizon and states on random dense problems with two inputs, ten lanes, N 25 and six states
where not varied. Vary lanes on a thousand of the vehicle's programmes in closed loop, in calls of
so many. Vary workers on ten environments of mpc_tracking at the baseline parameters. All ways take
the same problems in turn. Print medians of CPU time per programme on one thread; for workers, of
wall time. Write `docs/images/scaling_solver.svg`.
"""

from __future__ import annotations

import os

for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(variable, "1")

import argparse
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from benchmarks.executors import steps_per_second
from benchmarks.figures import FIGURES, pyplot, save
from benchmarks.qp_solvers import LANES, closed_loop_problems
from benchmarks.qp_ways import PEERS, RICCATI, Way, cpu_seconds, installed
from tests.mpc.problems import dense_problems
from zoac.analysis.figures import style
from zoac.mpc.problem import PER_ENV, LinearisedProblem

HORIZONS = (10, 25, 50, 100, 200)
STATES = (2, 4, 6, 8, 12, 16, 24)
LANE_COUNTS = (1, 2, 5, 10, 20, 50, 100, 1000)
PROGRAMMES = 1000
SHOWN = ("riccati", "clarabel", "DAQP, condensed", "HPIPM, by CasADi")
SOLVERS = ("riccati", "clarabel")

Curves = dict[str, list[float]]


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


def over_workers(workers: Sequence[int], rounds: int) -> Curves:
    """Return steps per second by the number of workers (0: serial), for each solver."""
    curves: Curves = {}
    for solver in SOLVERS:
        rates = steps_per_second(solver, LANES, workers, rounds)
        curves[solver] = [float(np.median(rates[count])) for count in workers]
        print(f"\nsteps/s, {solver}: " + ", ".join(
            f"{count} workers {rate:,.0f} ({rate / curves[solver][0]:.2f} x)"
            for count, rate in zip(workers, curves[solver], strict=True)
        ))  # fmt: skip
    return curves


def draw(
    panels: Sequence[tuple[str, Sequence[int], Curves]], workers: Sequence[int], rates: Curves
) -> None:
    """Write the figure of `docs/solver.md`."""
    figure, axes = pyplot().subplots(2, 2, figsize=(9, 6.4), layout="constrained")
    looks = dict(zip(SHOWN, style.cycle(), strict=False))
    for axis, (what, sizes, curves) in zip(axes.flat, panels, strict=False):
        for name, values in curves.items():
            axis.loglog(sizes, values, label=name, **looks[name])
        axis.set(xlabel=what, ylabel="Time per programme [µs]")
        axis.set_xticks(sizes, [str(size) for size in sizes])
        axis.minorticks_off()
    axes[0, 0].legend(fontsize=7)
    last = axes[1, 1]
    for name, values in rates.items():
        ratios = np.array(values) / values[0]
        last.plot(workers, ratios, label=name, **looks[name])
    last.set(xlabel="workers (0: serial)", ylabel="Steps per second, serial = 1", ylim=(0.0, None))
    last.set_xticks(workers)
    save(figure, FIGURES / "scaling_solver.svg")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=15)
    parser.add_argument("--workers", type=int, nargs="+", default=[1, 2], help="besides none")
    options = parser.parse_args()
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
    ) -> tuple[str, Sequence[int], Curves]:
        return what, sizes, grow(what, sizes, make, which, options.rounds)

    panels = [
        measure("horizon", HORIZONS, lambda n: [dense_problems(LANES, n, 6, 2, 0)], ways),
        measure("states", STATES, lambda nx: [dense_problems(LANES, 25, nx, 2, 0)], ways),
        measure("environments", LANE_COUNTS, split, own),
    ]
    draw(panels, workers, over_workers(workers, options.rounds))


if __name__ == "__main__":
    main()
