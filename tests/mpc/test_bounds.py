"""Bounds on states: plans satisfy the KKT conditions, found from the plan and the data alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import lsq_linear

from tests.mpc.problems import (
    box_points,
    dense_problems,
    integrator,
    objective,
    tracking_problems,
)
from zoac.mpc.attempt import Attempt
from zoac.mpc.formulation import Layout, build_problem
from zoac.mpc.problem import LinearisedProblem, StateBounds, Status
from zoac.mpc.solvers.certificate import is_optimal
from zoac.mpc.solvers.clarabel_qp import ClarabelSolver
from zoac.mpc.solvers.cvxpy_qp import CvxpySolver

INF = np.inf
SOLVERS = [ClarabelSolver(), CvxpySolver()]
CLARABEL, CVXPY = SOLVERS


def bounded(problem: LinearisedProblem, low, high, penalty) -> LinearisedProblem:
    n = len(problem.a)
    return replace(problem, bounds=StateBounds(*(np.tile(v, (n, 1)) for v in (low, high, penalty))))


def dense(n: int = 20, penalty=(300.0, 300.0, 300.0), seed: int = 1) -> LinearisedProblem:
    problem = dense_problems(n, 8, 3, 2, seed)
    return bounded(problem, (-1.0, -INF, -0.5), (1.0, 0.8, INF), penalty)


def vehicles(n: int = 40, penalty: float = 1e4) -> LinearisedProblem:
    problem = tracking_problems(box_points(n, 1), 1)
    low, high = [-INF] * 3 + [16.5, -1.0, -0.6], [INF] * 3 + [19.5, 1.0, 0.6]
    return bounded(problem, low, high, [penalty] * 6)


def condensed(problem: LinearisedProblem, i: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the map and offset of all states (N nx,) from all inputs (N nu,) of one problem."""
    horizon, nx, nu = problem.b.shape[1:]
    rows, offset = np.zeros((horizon, nx, horizon * nu)), np.zeros((horizon, nx))
    before, moved = np.zeros((nx, horizon * nu)), np.zeros(nx)
    for k in range(horizon):
        before = problem.a[i, k] @ before
        before[:, k * nu : (k + 1) * nu] = problem.b[i, k]
        moved = problem.a[i, k] @ moved - problem.b[i, k] @ problem.inputs[i, k]
        rows[k], offset[k] = before, moved + problem.states[i, k + 1]
    return rows.reshape(-1, horizon * nu), offset.ravel()


def kkt_residual(problem: LinearisedProblem, inputs: np.ndarray, i: int) -> float:
    """Return what of the cost's gradient no allowed multipliers explain, relative to it.

    The multipliers are found by least squares from the plan alone: of inputs at their bounds by
    sign; of states at a bound from 0 to the penalty; of states beyond one the penalty itself.
    """
    rows, offset = condensed(problem, i)
    u, bounds, horizon = inputs[i].ravel(), problem.bounds, inputs.shape[1]
    x = rows @ u + offset
    error = x - problem.reference[i].ravel()
    gradient = 2 * problem.input_weights[i].ravel() * u
    pull = 2 * problem.state_weights[i].ravel() * error
    size = np.abs(gradient).max() + (np.abs(rows).T @ np.abs(pull)).max()  # before it cancels
    gradient = gradient + rows.T @ pull
    low, high, penalty = (np.tile(v[i], horizon) for v in (bounds.low, bounds.high, bounds.penalty))
    columns, most = [], []
    for sign, bound in ((1.0, high), (-1.0, low)):
        over = sign * (x - bound)
        near = 1e-6 * (1.0 + np.abs(x))
        beyond = over > near
        assert not (beyond & np.isinf(penalty)).any(), "a hard bound is not kept"
        gradient = gradient + sign * rows[beyond].T @ penalty[beyond]
        columns += list(sign * rows[np.abs(over) <= near])
        most += penalty[np.abs(over) <= near].tolist()
    for sign, bound in ((1.0, problem.input_high), (-1.0, problem.input_low)):
        at = np.flatnonzero(np.abs(u - np.tile(bound, horizon)) <= 1e-6)
        columns += list(sign * np.eye(len(u))[at])
        most += [INF] * len(at)
    if not columns:
        return float(np.abs(gradient).max() / size)
    matrix = np.array(columns).T
    answer = lsq_linear(matrix, -gradient, (0.0, np.array(most)), "bvls", tol=1e-14)
    left = np.abs(matrix @ answer.x + gradient).max()
    return float(left / max(size, np.abs(gradient).max()))


@pytest.mark.parametrize("solver", SOLVERS, ids=["clarabel", "cvxpy"])
@pytest.mark.parametrize(
    "problem",
    [
        pytest.param(dense(), id="soft"),
        pytest.param(dense(penalty=(INF, 300.0, 300.0)), id="one hard"),
        pytest.param(vehicles(), id="vehicle"),
    ],
)
def test_plans_satisfy_the_optimality_conditions(solver, problem) -> None:
    problem = problem if solver is CLARABEL else problem.take(slice(0, 8))
    answer = solver.solve(problem)
    solved = answer.status == Status.SOLVED
    assert (solved | (answer.status == Status.INFEASIBLE)).all()
    assert solved.mean() > 0.4
    residuals = [kkt_residual(problem, answer.inputs, i) for i in np.flatnonzero(solved)]
    assert max(residuals) < 1e-4
    assert np.median(residuals) < 1e-6


def test_the_conditions_notice_a_plan_beside_the_optimum() -> None:
    problem = dense()
    answer = CLARABEL.solve(problem)
    off = answer.inputs + 0.02 * (0.0 - answer.inputs)
    assert min(kkt_residual(problem, off, i) for i in range(len(off))) > 1e-3


def test_the_formulation_is_dpp() -> None:
    layout = Layout.of(dense(penalty=(INF, 300.0, 300.0)))
    assert (layout.state_low, layout.state_high, layout.soft) == ((0, 2), (0, 1), (1, 2))
    assert build_problem(layout).problem.is_dcp(dpp=True)


def test_both_paths_find_the_same_plans() -> None:
    problem = vehicles(12, 1e3)
    fast, plain = CLARABEL.solve(problem), CVXPY.solve(problem)
    np.testing.assert_array_equal(fast.status, plain.status)
    np.testing.assert_allclose(fast.inputs, plain.inputs, atol=1e-5)


def test_bounds_that_are_far_change_nothing() -> None:
    problem = vehicles()
    low = np.where(np.isfinite(problem.bounds.low), -1e3, -INF)
    far = replace(problem, bounds=StateBounds(low, -low, problem.bounds.penalty))
    free = CLARABEL.solve(replace(problem, bounds=None))
    plans = CLARABEL.solve(far)
    np.testing.assert_allclose(
        objective(problem, plans.inputs), objective(problem, free.inputs), rtol=1e-7
    )


def test_a_soft_bound_always_has_a_plan_and_a_hard_one_says_that_it_has_none() -> None:
    """The first state starts far beyond; nothing brings it back within one step."""
    problem = dense()
    problem = replace(problem, states=problem.states + 5.0)
    assert (Attempt(CLARABEL, problem).status == Status.SOLVED).all()
    hard = bounded(problem, (-1.0, -INF, -0.5), (1.0, 0.8, INF), (INF, INF, INF))
    for solver in SOLVERS:
        status = Attempt(solver, hard.take(slice(0, 5))).status
        np.testing.assert_array_equal(status, Status.INFEASIBLE)


def test_a_penalty_above_the_multiplier_keeps_the_bound_exactly() -> None:
    """One state that integrates one input towards 1, with the bound 1/2.

    At x = (1/2, 1/2) the multipliers are 2 and 1: a smaller penalty buys a violation.
    """
    problem = integrator(input_weight=1e-6)
    for penalty, reached in ((2.0, 0.5), (INF, 0.5), (0.5, 0.75)):
        plans = CLARABEL.solve(bounded(problem, [-INF], [0.5], [penalty])).inputs
        np.testing.assert_allclose(plans[0, :, 0], [reached, 0.0], atol=1e-5)


def test_what_is_said_to_be_solved_is_proven_and_nothing_beside_it() -> None:
    problem = vehicles()
    plans = CLARABEL.solve(problem)
    assert (plans.status == Status.SOLVED).all()
    assert not is_optimal(problem, plans.inputs).all()  # the multipliers belong to the proof
    middle = 0.5 * (problem.input_low + problem.input_high)
    off = plans.inputs + 0.05 * (middle - plans.inputs)
    for multipliers in (None, np.random.default_rng(0).normal(size=problem.reference.shape)):
        assert is_optimal(problem, off, multipliers).sum() <= 1
    outside = np.full_like(plans.inputs, 0.4)
    hard = replace(problem, bounds=replace(problem.bounds, penalty=problem.bounds.penalty * INF))
    assert not is_optimal(hard, outside).any()


def test_nothing_leaks_from_one_problem_into_the_next() -> None:
    problem, solver = vehicles(), ClarabelSolver()
    first = solver.solve(problem)
    solver.solve(replace(problem, bounds=None))
    for i in np.random.default_rng(0).permutation(len(problem.a)):
        again = solver.solve(problem.take(slice(i, i + 1)))
        np.testing.assert_array_equal(again.inputs[0], first.inputs[i])
