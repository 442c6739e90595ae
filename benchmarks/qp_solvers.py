"""Compare solvers of the MPC's quadratic programme, in ratios: `python -m benchmarks.qp_solvers`.

The programmes come from closed loops with random parameters from the whole box, three
linearisations a step, ten lanes. Every solver takes the same ten in turn, so that a busy machine
slows all alike. The medians over the tens of CPU time per programme on one thread are compared. The
times of `riccati` and `clarabel` include turning the linearisation into their matrices. The other
solvers receive ready-made matrices, condensed or sparse; their times are for updating and solving.

With `--agreement N`, check N programmes about random rollouts: by the KKT conditions, against the
condensed problem solved in 80-bit arithmetic from quadprog's active set, and against
Clarabel in the optimal value; one in a hundred against quadprog and DAQP as they are.
"""

from __future__ import annotations

import os

for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(variable, "1")

import argparse
from dataclasses import replace
from itertools import pairwise

import numpy as np

from benchmarks.qp_ways import PEERS, RICCATI, cpu_seconds, daqp, installed
from tests.mpc.problems import box_points, tracking_problems
from tests.riccati.oracle import (
    kkt_error,
    optimal_value,
    solve_condensed,
    solve_in_extended_precision,
)
from zoac.core.seeding import stream
from zoac.core.segments import Proposal
from zoac.mpc.problem import LinearisedProblem, Solution, Status
from zoac.mpc.solvers.clarabel_qp import ClarabelSolver
from zoac.mpc.solvers.riccati import Riccati
from zoac.rollout.engine import RolloutEngine
from zoac.tasks.mpc_tracking import MpcTracking
from zoac.tasks.mpc_tracking.controller import SPACE

LANES = 10


class Recorder(Riccati):
    """Record the problems that it solves."""

    def __init__(self) -> None:
        super().__init__()
        self.problems: list[LinearisedProblem] = []

    def solve(self, problem: LinearisedProblem, robust: bool = False) -> Solution:
        if len(problem.a) == LANES:
            self.problems.append(replace(problem, inputs=problem.inputs.copy()))
        return super().solve(problem, robust)


def closed_loop_problems(count: int) -> list[LinearisedProblem]:
    """Return `count` problems of ten lanes, as a tuner meets them."""
    recorder = Recorder()
    group = RolloutEngine(MpcTracking(solver=recorder), range(LANES), range(LANES))
    rng = stream(0, "qp_solvers")
    while len(recorder.problems) < 4 * count:
        z = rng.uniform(-1.0, 1.0, (LANES, SPACE.dimension))
        group.rollout([Proposal(row, lane=lane, horizon=20) for lane, row in enumerate(z)])
    return recorder.problems[:: len(recorder.problems) // count][:count]


def compare(count: int) -> None:
    """Print CPU time per programme of every solver, against riccati, and its errors."""
    ways = installed({**RICCATI, **PEERS})
    seconds: dict[str, list[float]] = {name: [] for name in ways}
    errors: dict[str, list[np.ndarray]] = {name: [] for name in ways}
    recursions = []
    problems = closed_loop_problems(count + 1)
    for earlier, problem in pairwise(problems):
        solution = Riccati().solve(problem)
        recursions.append(solution.iterations)
        truth = solution.inputs - problem.inputs
        for name, prepare in ways.items():
            spent, plans = cpu_seconds(prepare(earlier), prepare(problem))
            seconds[name].append(spent * 1e6 / LANES)
            gap = np.abs(np.stack(plans).reshape(truth.shape) - truth)
            errors[name].append(gap.max(axis=(1, 2)))
    print(f"\n{'':28}{'us':>9}{'ratio':>9}{'error: median':>16}{'worst':>10}{'> 1e-6':>10}")
    for name, values in sorted(seconds.items(), key=lambda item: np.median(item[1])):
        gaps = np.concatenate(errors[name])
        median, worst, off = np.median(gaps), np.max(gaps), np.mean(gaps > 1e-6)
        ratio = np.median(np.array(values) / seconds["riccati"])
        print(
            f"{name:28}{np.median(values):9.2f}{ratio:9.1f}{median:16.1e}{worst:10.1e}{off:10.1%}"
        )
    print(f"\nriccati: mean {np.mean(seconds['riccati']):.2f} us, {LANES} lanes in one call")
    taken = np.concatenate(recursions)
    ones = np.mean(taken == 1)
    print(f"recursions: mean {taken.mean():.2f}, one in {ones:.1%}, worst {taken.max()}")


def agree(count: int) -> None:
    """Check `count` random programmes and print the worst of each measure."""
    solver, clarabel = Riccati(), ClarabelSolver()
    status = np.zeros(len(Status), dtype=np.int64)
    kkt, values, iterations = [], [], []
    errors: dict[str, list[float]] = {"condensed, 80 bits": [], "quadprog": [], "DAQP": []}
    chunk = 1000
    for part in range(count // chunk):
        problem = tracking_problems(box_points(chunk, 1000 + part), 1000 + part)
        solution, theirs = solver.solve(problem), clarabel.solve(problem)
        status += np.bincount(solution.status, minlength=len(Status))
        kkt.append(kkt_error(problem, solution.inputs))
        iterations.append(solution.iterations)
        value = optimal_value(problem, theirs.inputs)
        more = optimal_value(problem, solution.inputs) / value - 1.0
        values.append(more[theirs.status == Status.SOLVED])
        for lane, plan in enumerate(solution.inputs):
            exact = solve_in_extended_precision(problem, lane)
            errors["condensed, 80 bits"].append(np.abs(plan - exact).max())
        for lane in range(0, chunk, 100):
            plan = solution.inputs[lane]
            errors["quadprog"].append(np.abs(plan - solve_condensed(problem, lane)).max())
            w, _, flag, _ = daqp(problem, lane)()
            if flag == 1:
                step = (plan - problem.inputs[lane]).ravel()
                errors["DAQP"].append(np.abs(step - w).max())
    print("status:", {Status(i).name: int(k) for i, k in enumerate(status) if k})
    value = np.concatenate(values)
    print(
        f"value, more than Clarabel's: n {len(value)}, from {value.min():.1e} to {value.max():.1e}"
    )
    measures = {"KKT error": np.concatenate(kkt)}
    measures |= {name: np.array(gaps) for name, gaps in errors.items()}
    for name, measure in measures.items():
        print(f"{name}: n {len(measure)}, 99% {np.quantile(measure, 0.99):.1e}, "
              f"worst {np.max(measure):.1e}")  # fmt: skip
    quantiles = np.quantile(np.concatenate(iterations), [0.5, 0.9, 0.99, 1.0])
    print("factorisations: median, 90%, 99%, worst:", *quantiles.astype(int))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--problems", type=int, default=60, help="programmes, in tens")
    parser.add_argument("--agreement", type=int, default=0, metavar="N")
    arguments = parser.parse_args()
    if arguments.agreement:
        agree(arguments.agreement)
    else:
        compare(arguments.problems)


if __name__ == "__main__":
    main()
