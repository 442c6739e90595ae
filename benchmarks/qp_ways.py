"""Give every solver of the MPC's quadratic programme one interface, for the benchmarks beside it.

A way takes a problem of n lanes and returns a batch: calls that solve it. Each call returns plans
minus the rollout's inputs. Other solvers have one call per lane; their matrices, condensed or
sparse, are made before, so the call is timed for updating and solving alone. `riccati` and
`clarabel` take all lanes in one call, whose time includes building their matrices.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from functools import partial
from importlib import import_module
from typing import Any

import numpy as np
import scipy.sparse as sp

from tests.riccati.oracle import bounds, condense
from zoac.mpc.problem import LinearisedProblem, Solver
from zoac.mpc.solvers.clarabel_qp import ClarabelSolver
from zoac.mpc.solvers.riccati import Riccati

TOLERANCE = 1e-9  # asked of the iterative peers
DAQP = {
    "eps_prox": 0.0,
    "primal_tol": 1e-9,
    "sing_tol": 1e-14,
    "zero_tol": 1e-14,
    "pivot_tol": 1e-10,
}

Batch = list[Callable[[], np.ndarray]]
Way = Callable[[LinearisedProblem], Batch]


def cpu_seconds(earlier: Batch, batch: Batch) -> tuple[float, list[np.ndarray]]:
    """Return CPU seconds of a batch, and its plans.

    `earlier`, the same for other problems, brings code and work space into the caches, as they
    are inside a tuning run.
    """
    for run in earlier:
        run()
    began = time.thread_time()
    plans = [run() for run in batch]
    return time.thread_time() - began, plans


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
        rows[k][k] = sp.hstack([-sp.eye_array(nx), _full(b[k])])
        if k:
            rows[k][k - 1] = sp.hstack([_full(a[k]), sp.coo_array((nx, nu))])
    dynamics = sp.block_array(rows, format="csc")
    return (
        sp.diags_array(weights.ravel(), format="csc"),
        (weights * errors).ravel(),
        dynamics,
        np.zeros(n * nx),
    )


def _full(block: np.ndarray) -> Any:
    """Return `block` with its zeros stored: the same pattern from problem to problem."""
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


def lane_by_lane(prepare: Callable[[LinearisedProblem, int], Callable[[], np.ndarray]]) -> Way:
    """Return the way that has one call for each lane."""
    return lambda problem: [prepare(problem, lane) for lane in range(len(problem.a))]


def quadprog_way() -> Way:
    solve_qp = import_module("quadprog").solve_qp

    def prepare(problem: LinearisedProblem, lane: int) -> Callable[[], np.ndarray]:
        hessian, linear = condense(problem, lane)
        low, high = bounds(problem, lane)
        sides = np.concatenate([np.eye(len(low)), -np.eye(len(low))], axis=1)
        limits = np.concatenate([low, -high])
        return lambda: solve_qp(hessian, -linear, sides, limits)[0]

    return lane_by_lane(prepare)


def daqp(problem: LinearisedProblem, lane: int) -> Callable[[], Any]:
    """Return the call of DAQP whose answer begins with plan, cost and 1 for solved."""
    solve = import_module("daqp").solve
    hessian, linear = condense(problem, lane)
    low, high = bounds(problem, lane)
    return partial(solve, hessian, linear, np.zeros((0, len(low))), high, low, **DAQP)


def daqp_way() -> Way:
    import_module("daqp")

    def prepare(problem: LinearisedProblem, lane: int) -> Callable[[], np.ndarray]:
        solve = daqp(problem, lane)
        return lambda: solve()[0]

    return lane_by_lane(prepare)


def proxqp_way() -> Way:
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

    return lane_by_lane(prepare)


def piqp_way(sparse: bool) -> Way:
    """PIQP, on the sparse form with its multistage factorisation or on the condensed one."""
    piqp = import_module("piqp")
    solver = piqp.SparseSolver() if sparse else piqp.DenseSolver()
    solver.settings.eps_abs, solver.settings.eps_rel = TOLERANCE, 0.0
    if sparse and hasattr(piqp, "sparse_multistage"):
        solver.settings.kkt_solver = piqp.KKTSolver.sparse_multistage
    ready = False

    def condensed_data(problem: LinearisedProblem, lane: int) -> dict[str, Any]:
        hessian, linear = condense(problem, lane)
        low, high = bounds(problem, lane)
        return {"P": np.asfortranarray(hessian), "c": linear, "x_l": low, "x_u": high}

    def sparse_data(problem: LinearisedProblem, lane: int) -> dict[str, Any]:
        hessian, linear, dynamics, gap = sparse_form(problem, lane)
        low, high = sparse_bounds(problem, lane)
        rows = {"A": sp.csc_matrix(dynamics), "b": gap}
        return {"P": sp.csc_matrix(hessian), "c": linear, "x_l": low, "x_u": high, **rows}

    def prepare(problem: LinearisedProblem, lane: int) -> Callable[[], np.ndarray]:
        nonlocal ready
        data = (sparse_data if sparse else condensed_data)(problem, lane)
        if not ready:
            solver.setup(**data)
            ready = True

        def run() -> np.ndarray:
            solver.update(**data)
            solver.solve()
            found = np.array(solver.result.x)
            return inputs_of(problem, found) if sparse else found

        return run

    return lane_by_lane(prepare)


def osqp_way() -> Way:
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

    return lane_by_lane(prepare)


def hpipm_way() -> Way:
    """HPIPM from CasADi's wheels, without the conversions of CasADi's calls from Python."""
    casadi = import_module("casadi")
    options = dict.fromkeys(("res_g_max", "res_b_max", "res_d_max", "res_m_max"), TOLERANCE)
    functions: dict[tuple[int, ...], Any] = {}

    def make(hessian: Any, dynamics: Any, n: int, nx: int, nu: int) -> Any:
        sparsities = {
            name: casadi.Sparsity(*matrix.shape, matrix.indptr.tolist(), matrix.indices.tolist())
            for name, matrix in (("h", hessian), ("a", dynamics))
        }
        stages = {"N": n, "nx": [nx] * (n + 1), "nu": [nu] * n + [0], "ng": [0] * (n + 1)}
        settings = {**options, "mode": "speed", "iter_max": 100}
        # Its own infinity, 1e8, would drown the residuals in rounding.
        return casadi.conic(
            "qp", "hpipm", sparsities,
            {**stages, "inf": 1e6, "error_on_fail": False, "hpipm": settings},
        )  # fmt: skip

    def prepare(problem: LinearisedProblem, lane: int) -> Callable[[], np.ndarray]:
        hessian, linear, dynamics, gap = sparse_form(problem, lane)
        low, high = sparse_bounds(problem, lane)
        n, nx, nu = problem.b[lane].shape
        # It wants (z_0, w_0, z_1, ...): z_0, here in no constraint, and each w before its z.
        place = np.arange(n * (nx + nu)).reshape(n, -1)
        order = np.concatenate([place[:, nx:], place[:, :nx]], axis=1).ravel()
        nothing, free = np.zeros(nx), np.full(nx, np.inf)
        scale = 1.0 / np.abs(linear).max()
        diagonal = np.concatenate([np.ones(nx), scale * hessian.diagonal()[order]])
        dynamics = sp.hstack([sp.csc_array((n * nx, nx)), dynamics[:, order]], format="csc")
        dynamics.sort_indices()
        size = len(diagonal)
        if (n, nx, nu) not in functions:
            square = sp.diags_array(diagonal, format="csc")
            functions[n, nx, nu] = make(square, dynamics, n, nx, nu)
        buffer, evaluate = functions[n, nx, nu].buffer()
        arguments = [
            diagonal, np.concatenate([nothing, scale * linear[order]]), dynamics.data, gap, gap,
            np.concatenate([-free, low[order]]), np.concatenate([free, high[order]]),
            np.zeros(size), np.zeros(size), np.zeros(n * nx),
        ]  # fmt: skip
        answers = [np.zeros(size), np.zeros(1), np.zeros(n * nx), np.zeros(size)]
        for index, values in enumerate(arguments):
            buffer.set_arg(index, memoryview(values))

        def run() -> np.ndarray:
            # All of them, or it ends in a segmentation fault; anew, for a call writes them once.
            for index, values in enumerate(answers):
                buffer.set_res(index, memoryview(values))
            evaluate()
            return answers[0][: n * (nx + nu)].reshape(n, -1)[:, nx:].ravel()

        run.keep = buffer, arguments  # type: ignore[attr-defined]  # it holds only their addresses
        return run

    return lane_by_lane(prepare)


def our_way(make: Callable[[], Solver], robust: bool = False) -> Way:
    """Return a solver of the project as one call for all lanes."""
    solver = make()

    def prepare(problem: LinearisedProblem) -> Batch:
        return [lambda: solver.solve(problem, robust).inputs - problem.inputs]

    return prepare


RICCATI = {
    "riccati": partial(our_way, Riccati),
    "riccati, robust": partial(our_way, Riccati, robust=True),
    "clarabel": partial(our_way, ClarabelSolver),
}
PEERS = {
    "DAQP, condensed": daqp_way,
    "quadprog, condensed": quadprog_way,
    "ProxQP, condensed, box": proxqp_way,
    "PIQP, condensed": partial(piqp_way, sparse=False),
    "PIQP, sparse, multistage": partial(piqp_way, sparse=True),
    "HPIPM, by CasADi": hpipm_way,
    "OSQP, sparse, polished": osqp_way,
}


def installed(makers: Mapping[str, Callable[[], Way]]) -> dict[str, Way]:
    """Return the ways whose packages are installed; print the others."""
    ways = {}
    for name, make in makers.items():
        try:
            ways[name] = make()
        except ImportError as error:
            print(f"{name}: skipped, {error}")
    return ways
