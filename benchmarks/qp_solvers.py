"""Solvers of the MPC's quadratic programme, in ratios: `python -m benchmarks.qp_solvers`.

The programmes are those of random parameters from the whole box in closed loop, three
linearisations a step, ten lanes. Every solver takes the same ten in turn, so that a busy machine
slows all alike; medians over the tens, of CPU time per programme on one thread, are compared.
Only `riccati` and `clarabel (ours)` pay for turning the linearisation into their matrices: the
others find theirs ready made, condensed or sparse, and pay for updating and solving.

With `--agreement N`: N programmes about random rollouts, checked by the KKT conditions and, one
in a hundred, against quadprog, DAQP and 80-bit arithmetic on the active set found. With
`--scaling`: horizon, states and lanes.
"""

from __future__ import annotations

import os

for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(variable, "1")

import argparse
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from importlib import import_module
from itertools import pairwise
from typing import Any

import numpy as np
import scipy.sparse as sp

from tests.mpc.problems import box_points, dense_problems, tracking_problems
from tests.riccati.oracle import (
    bounds,
    condense,
    kkt_error,
    solve_condensed,
    solve_in_extended_precision,
)
from zoac.mpc.policy import _take
from zoac.mpc.solvers.base import LinearisedProblem, Solution, Solver, Status
from zoac.mpc.solvers.clarabel_qp import ClarabelSolver
from zoac.mpc.solvers.riccati import Riccati
from zoac.rollout import LaneGroup
from zoac.seeding import stream
from zoac.segments import Proposal
from zoac.tasks.mpc_tracking import MpcTracking
from zoac.tasks.mpc_tracking.controller import SPACE

LANES = 10
TOLERANCE = 1e-9  # asked of the iterative peers
DAQP = {
    "eps_prox": 0.0,
    "primal_tol": 1e-9,
    "sing_tol": 1e-14,
    "zero_tol": 1e-14,
    "pivot_tol": 1e-10,
}

Batch = list[Callable[[], np.ndarray]]  # one call a lane, returning its plan less the rollout's


class Recorder(Riccati):
    """Keeps the problems that it solves."""

    def __init__(self) -> None:
        super().__init__()
        self.problems: list[LinearisedProblem] = []

    def solve(self, problem: LinearisedProblem, careful: bool = False) -> Solution:
        if len(problem.a) == LANES:
            self.problems.append(replace(problem, inputs=problem.inputs.copy()))
        return super().solve(problem, careful)


def closed_loop_problems(count: int) -> list[LinearisedProblem]:
    """Return `count` problems of ten lanes, as a tuner meets them."""
    recorder = Recorder()
    group = LaneGroup(MpcTracking(solver=recorder), range(LANES), range(LANES))
    rng = stream(0, "qp_solvers")
    while len(recorder.problems) < 4 * count:
        z = rng.uniform(-1.0, 1.0, (LANES, SPACE.dimension))
        group.rollout([Proposal(row, lane=lane, horizon=20) for lane, row in enumerate(z)])
    return recorder.problems[:: len(recorder.problems) // count][:count]


def sparse_form(problem: LinearisedProblem, lane: int) -> tuple[Any, ...]:
    """Return P, q, A, b of 1/2 v'Pv + q'v, Av = b, where v = (z_1, w_0, z_2, w_1, ...)."""
    a, b = problem.a[lane], problem.b[lane]
    n, nx, nu = b.shape
    weights = np.concatenate([problem.state_weights[lane], problem.input_weights[lane]], axis=1)
    errors = np.concatenate(
        [problem.states[lane, 1:] - problem.reference[lane], problem.inputs[lane]], axis=1
    )
    rows: list[list[Any]] = [[None] * n for _ in range(n)]
    for k in range(n):
        rows[k][k] = np.concatenate([-np.eye(nx), b[k]], axis=1)
        if k:
            rows[k][k - 1] = np.concatenate([a[k], np.zeros((nx, nu))], axis=1)
    # Stored zeros keep the pattern the same from problem to problem.
    dynamics = sp.block_array(
        [[None if block is None else _full(block) for block in row] for row in rows], format="csc"
    )
    return (
        sp.diags_array(weights.ravel(), format="csc"),
        (weights * errors).ravel(),
        dynamics,
        np.zeros(n * nx),
    )


def _full(block: np.ndarray) -> Any:
    row, column = np.indices(block.shape)
    return sp.coo_array((block.ravel(), (row.ravel(), column.ravel())), shape=block.shape)


def sparse_bounds(problem: LinearisedProblem, lane: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the bounds of v."""
    n, nx, _ = problem.b[lane].shape
    free = np.full((n, nx), np.inf)
    low, high = (side.reshape(n, -1) for side in bounds(problem, lane))
    return np.concatenate([-free, low], 1).ravel(), np.concatenate([free, high], 1).ravel()


def inputs_of(problem: LinearisedProblem, v: np.ndarray) -> np.ndarray:
    nx = problem.a.shape[2]
    return np.asarray(v).reshape(problem.a.shape[1], -1)[:, nx:].ravel()


def quadprog_way() -> Callable[[LinearisedProblem], Batch]:
    solve_qp = import_module("quadprog").solve_qp

    def prepare(problem: LinearisedProblem, lane: int) -> Callable[[], np.ndarray]:
        hessian, linear = condense(problem, lane)
        low, high = bounds(problem, lane)
        sides = np.concatenate([np.eye(len(low)), -np.eye(len(low))], axis=1)
        limits = np.concatenate([low, -high])
        return lambda: solve_qp(hessian, -linear, sides, limits)[0]

    return lambda problem: [prepare(problem, lane) for lane in range(len(problem.a))]


def daqp_way() -> Callable[[LinearisedProblem], Batch]:
    solve = import_module("daqp").solve

    def prepare(problem: LinearisedProblem, lane: int) -> Callable[[], np.ndarray]:
        hessian, linear = condense(problem, lane)
        low, high = bounds(problem, lane)
        none = np.zeros((0, len(low)))
        return lambda: solve(hessian, linear, none, high, low, **DAQP)[0]

    return lambda problem: [prepare(problem, lane) for lane in range(len(problem.a))]


def proxqp_way() -> Callable[[LinearisedProblem], Batch]:
    dense = import_module("proxsuite").proxqp.dense
    qps: dict[int, Any] = {}

    def prepare(problem: LinearisedProblem, lane: int) -> Callable[[], np.ndarray]:
        hessian, linear = condense(problem, lane)
        low, high = bounds(problem, lane)
        size = len(low)
        if size not in qps:
            qps[size] = dense.QP(size, 0, 0, True)
            qps[size].settings.eps_abs = TOLERANCE
            qps[size].settings.eps_rel = 0.0
            start = import_module("proxsuite").proxqp.InitialGuess.NO_INITIAL_GUESS
            qps[size].settings.initial_guess = start
            qps[size].init(hessian, linear, None, None, None, None, None, low, high)
        qp = qps[size]

        def run() -> np.ndarray:
            qp.update(H=hessian, g=linear, l_box=low, u_box=high)
            qp.solve()
            return np.array(qp.results.x)

        return run

    return lambda problem: [prepare(problem, lane) for lane in range(len(problem.a))]


def piqp_dense_way() -> Callable[[LinearisedProblem], Batch]:
    piqp = import_module("piqp")
    solver = piqp.DenseSolver()
    solver.settings.eps_abs, solver.settings.eps_rel = TOLERANCE, 0.0
    ready = False

    def prepare(problem: LinearisedProblem, lane: int) -> Callable[[], np.ndarray]:
        nonlocal ready
        hessian, linear = condense(problem, lane)
        low, high = bounds(problem, lane)
        data = {"P": np.asfortranarray(hessian), "c": linear, "x_l": low, "x_u": high}
        if not ready:
            solver.setup(**data)
            ready = True

        def run() -> np.ndarray:
            solver.update(**data)
            solver.solve()
            return np.array(solver.result.x)

        return run

    return lambda problem: [prepare(problem, lane) for lane in range(len(problem.a))]


def piqp_sparse_way() -> Callable[[LinearisedProblem], Batch]:
    piqp = import_module("piqp")
    solver = piqp.SparseSolver()
    solver.settings.eps_abs, solver.settings.eps_rel = TOLERANCE, 0.0
    if hasattr(piqp, "sparse_multistage"):
        solver.settings.kkt_solver = piqp.KKTSolver.sparse_multistage
    ready = False

    def prepare(problem: LinearisedProblem, lane: int) -> Callable[[], np.ndarray]:
        nonlocal ready
        hessian, linear, dynamics, gap = sparse_form(problem, lane)
        low, high = sparse_bounds(problem, lane)
        data = {
            "P": sp.csc_matrix(hessian),
            "c": linear,
            "A": sp.csc_matrix(dynamics),
            "b": gap,
            "x_l": low,
            "x_u": high,
        }
        if not ready:
            solver.setup(**data)
            ready = True

        def run() -> np.ndarray:
            solver.update(**data)
            solver.solve()
            return inputs_of(problem, solver.result.x)

        return run

    return lambda problem: [prepare(problem, lane) for lane in range(len(problem.a))]


def osqp_way() -> Callable[[LinearisedProblem], Batch]:
    osqp = import_module("osqp")
    solver = osqp.OSQP()
    ready = False

    def prepare(problem: LinearisedProblem, lane: int) -> Callable[[], np.ndarray]:
        nonlocal ready
        hessian, linear, dynamics, gap = sparse_form(problem, lane)
        low, high = sparse_bounds(problem, lane)
        boxed = np.isfinite(low)
        pick = sp.csc_array(sp.eye_array(len(low), format="csr")[boxed])
        stacked = sp.csc_matrix(sp.vstack([dynamics, pick], format="csc"))
        lower, upper = np.concatenate([gap, low[boxed]]), np.concatenate([gap, high[boxed]])
        hessian = sp.csc_matrix(hessian)
        if not ready:
            solver.setup(
                hessian, linear, stacked, lower, upper, verbose=False, eps_abs=1e-7, eps_rel=0.0,
                polishing=True, max_iter=4000, warm_starting=False,
            )  # fmt: skip
            ready = True

        def run() -> np.ndarray:
            solver.update(q=linear, l=lower, u=upper, Px=hessian.data, Ax=stacked.data)
            return inputs_of(problem, solver.solve().x)

        return run

    return lambda problem: [prepare(problem, lane) for lane in range(len(problem.a))]


PEERS = {
    "DAQP, condensed": daqp_way,
    "quadprog, condensed": quadprog_way,
    "ProxQP, condensed, box": proxqp_way,
    "PIQP, condensed": piqp_dense_way,
    "PIQP, sparse, multistage": piqp_sparse_way,
    "OSQP, sparse, polished": osqp_way,
}


def timed(before: Callable[[], Any], function: Callable[[], Any]) -> tuple[float, Any]:
    """Return CPU microseconds per lane of ten, and what `function` returns.

    `before`, the same for other problems, brings code and work space into the caches, as they
    are inside a tuning run.
    """
    before()
    began = time.thread_time()
    result = function()
    return (time.thread_time() - began) * 1e6 / LANES, result


def _run(batch: Batch) -> list[np.ndarray]:
    return [run() for run in batch]


def our_way(solver: Solver, careful: bool = False) -> Callable[[LinearisedProblem], Batch]:
    """Return a solver of the project as one call for all lanes."""

    def prepare(problem: LinearisedProblem) -> Batch:
        return [lambda: solver.solve(problem, careful).inputs - problem.inputs]

    return prepare


def compare(count: int) -> None:
    """Print CPU time per programme of every solver, against riccati, and its largest error."""
    ways = {
        "riccati": our_way(Riccati()),
        "riccati, careful": our_way(Riccati(), careful=True),
        "clarabel (ours)": our_way(ClarabelSolver()),
    }
    for name, make in PEERS.items():
        try:
            ways[name] = make()
        except ImportError as error:
            print(f"{name}: skipped, {error}")
    seconds: dict[str, list[float]] = {name: [] for name in ways}
    errors: dict[str, list[np.ndarray]] = {name: [] for name in ways}
    problems = closed_loop_problems(count + 1)
    for earlier, problem in pairwise(problems):
        truth = Riccati().solve(problem).inputs - problem.inputs
        for name, prepare in ways.items():
            warm, batch = prepare(earlier), prepare(problem)
            taken, plans = timed(partial(_run, warm), partial(_run, batch))
            seconds[name].append(taken)
            gap = np.abs(np.stack(plans).reshape(truth.shape) - truth)
            errors[name].append(gap.max(axis=(1, 2)))
    print(f"\n{'':28}{'us':>9}{'ratio':>9}{'error: median':>16}{'worst':>10}")
    for name, values in sorted(seconds.items(), key=lambda item: np.median(item[1])):
        median, worst = np.median(errors[name]), np.max(errors[name])
        ratio = np.median(np.array(values) / seconds["riccati"])
        print(f"{name:28}{np.median(values):9.2f}{ratio:9.1f}{median:16.1e}{worst:10.1e}")
    print(f"\nriccati: mean {np.mean(seconds['riccati']):.2f} us, {LANES} lanes in one call")


def agree(count: int) -> None:
    """Check `count` random programmes and print the worst of each measure."""
    solver = Riccati()
    solve = import_module("daqp").solve
    status = np.zeros(len(Status), dtype=np.int64)
    kkt, iterations = [], []
    errors: dict[str, list[float]] = {"extended precision": [], "quadprog": [], "DAQP": []}
    chunk = 1000
    for part in range(count // chunk):
        problem = tracking_problems(box_points(chunk, 1000 + part), 1000 + part)
        solution = solver.solve(problem)
        status += np.bincount(solution.status, minlength=len(Status))
        kkt.append(kkt_error(problem, solution.inputs))
        iterations.append(solution.iterations)
        for lane in range(0, chunk, 100):
            plan = solution.inputs[lane]
            exact, broken = solve_in_extended_precision(problem, lane, plan)
            if broken == 0.0:
                errors["extended precision"].append(np.abs(plan - exact).max())
            errors["quadprog"].append(np.abs(plan - solve_condensed(problem, lane)).max())
            hessian, linear = condense(problem, lane)
            low, high = bounds(problem, lane)
            w, _, flag, _ = solve(hessian, linear, np.zeros((0, len(low))), high, low, **DAQP)
            if flag == 1:
                step = (plan - problem.inputs[lane]).ravel()
                errors["DAQP"].append(np.abs(step - w).max())
    print("status:", {Status(i).name: int(k) for i, k in enumerate(status) if k})
    measures = {"KKT error": np.concatenate(kkt)}
    measures |= {name: np.array(values) for name, values in errors.items()}
    for name, values in measures.items():
        print(f"{name}: n {len(values)}, 99% {np.quantile(values, 0.99):.1e}, "
              f"worst {np.max(values):.1e}")  # fmt: skip
    quantiles = np.quantile(np.concatenate(iterations), [0.5, 0.9, 0.99, 1.0])
    print("factorisations: median, 90%, 99%, worst:", *quantiles.astype(int))


def scale() -> None:
    """Print how the time of a programme grows with horizon, states and lanes."""
    solver = Riccati()

    def median(problem: LinearisedProblem) -> float:
        solver.solve(problem)
        taken = []
        for _ in range(30):
            began = time.thread_time()
            solver.solve(problem)
            taken.append((time.thread_time() - began) * 1e6 / len(problem.a))
        return float(np.median(taken))

    for horizon in (10, 25, 50, 100, 200):
        print(f"horizon {horizon:4}: {median(dense_problems(10, horizon, 6, 2, 0)):8.2f} us")
    for nx in (2, 4, 6, 8, 12, 16, 24):
        print(f"states  {nx:4}: {median(dense_problems(10, 25, nx, 2, 0)):8.2f} us")
    (problem,) = closed_loop_problems(1)
    for lanes in (1, 10, 100, 1000):
        print(f"lanes   {lanes:4}: {median(_take(problem, np.arange(lanes) % LANES)):8.2f} us each")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--problems", type=int, default=60, help="programmes, in tens")
    parser.add_argument("--agreement", type=int, default=0, metavar="N")
    parser.add_argument("--scaling", action="store_true")
    arguments = parser.parse_args()
    if arguments.agreement:
        agree(arguments.agreement)
    elif arguments.scaling:
        scale()
    else:
        compare(arguments.problems)


if __name__ == "__main__":
    main()
