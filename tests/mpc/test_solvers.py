"""Solvers that go through CVXPY's statement: right, alike, and without memory."""

from __future__ import annotations

import pickle
from dataclasses import replace

import numpy as np
import pytest

from tests.mpc.problems import (
    box_points,
    dense_problems,
    duality_gap,
    integrator,
    objective,
    tracking_problems,
)
from zoac.mpc.formulation import Layout, build_problem
from zoac.mpc.problem import Solver, Status
from zoac.mpc.solvers.clarabel_qp import ClarabelSolver
from zoac.mpc.solvers.cvxpy_qp import CvxpySolver
from zoac.mpc.solvers.riccati import Riccati
from zoac.tasks.mpc_tracking.controller import NOMINAL, SPACE

CLARABEL, CVXPY = ClarabelSolver(), CvxpySolver()
both = pytest.mark.parametrize("solver", [CLARABEL, CVXPY], ids=["clarabel", "cvxpy"])
kinds = pytest.mark.parametrize("kind", [ClarabelSolver, CvxpySolver])


def test_the_formulation_is_dpp() -> None:
    layout = Layout.of(tracking_problems(box_points(1, 0), 0))
    assert build_problem(layout).problem.is_dcp(dpp=True)


def test_both_paths_reach_the_same_optimal_value() -> None:
    problem = tracking_problems(box_points(20, 1), 1)
    fast, plain = CLARABEL.solve(problem), CVXPY.solve(problem)
    np.testing.assert_array_equal(fast.status, Status.SOLVED)
    np.testing.assert_array_equal(plain.status, Status.SOLVED)
    np.testing.assert_allclose(
        objective(problem, fast.inputs), objective(problem, plain.inputs), rtol=1e-6
    )


@pytest.mark.parametrize("robust", [False, True])
def test_plans_satisfy_the_optimality_conditions(robust: bool) -> None:
    problem = tracking_problems(box_points(200, 2), 2)
    plans = CLARABEL.solve(problem, robust).inputs
    relative = duality_gap(problem, plans) / objective(problem, plans)
    assert np.median(relative) < 1e-8
    assert relative.max() < 1e-5


@both
def test_a_known_optimum_is_found(solver) -> None:
    """One state that integrates one input: two steps by hand.

    u_0^2 + u_1^2 + (u_0 - 1)^2 + (u_0 + u_1 - 1)^2 is least at u = (3/5, 1/5); the bound 1/2 on
    u_0 leaves u_1 = 1/4.
    """
    problem = integrator(input_weight=1.0)
    bounded = replace(problem, input_high=np.array([0.5]))
    np.testing.assert_allclose(solver.solve(problem).inputs[0, :, 0], [0.6, 0.2], atol=1e-8)
    np.testing.assert_allclose(solver.solve(bounded).inputs[0, :, 0], [0.5, 0.25], atol=1e-8)


@both
@pytest.mark.parametrize(("horizon", "nx", "nu"), [(1, 2, 1), (4, 3, 2), (7, 1, 3)])
def test_any_size_and_full_jacobians(solver, horizon: int, nx: int, nu: int) -> None:
    problem = dense_problems(5, horizon, nx, nu, seed=3)
    plans = solver.solve(problem).inputs
    assert (duality_gap(problem, plans) < 1e-8 * objective(problem, plans)).all()


@both
@pytest.mark.parametrize(
    ("low", "high"),
    [((-np.inf, -np.inf), (np.inf, 0.2)), ((-0.3, 0.1), (np.inf, 0.1)), ((-1.0, 0.0), (1.0, 0.5))],
    ids=["free and bounded above", "bounded below and fixed", "bounded on both sides"],
)
def test_inputs_may_be_free_bounded_or_fixed(solver, low: tuple, high: tuple) -> None:
    problem = dense_problems(20, 6, 6, 2, seed=5)
    low, high = np.array(low), np.array(high)
    inputs = np.clip(problem.inputs, low, high)
    problem = replace(problem, inputs=inputs, input_low=low, input_high=high)
    solution = solver.solve(problem)
    np.testing.assert_array_equal(solution.status, Status.SOLVED)
    np.testing.assert_allclose(solution.inputs, Riccati().solve(problem).inputs, atol=1e-6)


@both
def test_a_rollout_that_costs_nothing_is_already_the_plan(solver) -> None:
    problem = dense_problems(2, 6, 3, 2, seed=0)
    names = ("states", "inputs", "reference")
    at_rest = replace(problem, **{n: np.zeros_like(getattr(problem, n)) for n in names})
    solution = solver.solve(at_rest)
    np.testing.assert_array_equal(solution.status, Status.SOLVED)
    np.testing.assert_allclose(solution.inputs, 0.0, atol=1e-9)


def test_clarabel_needs_few_iterations_near_a_good_controller() -> None:
    z = np.repeat(SPACE.normalise(NOMINAL)[None], 30, axis=0)
    assert CLARABEL.solve(tracking_problems(z, 0)).iterations.mean() < 4


def test_sparsity_changes_the_work_and_not_the_answer() -> None:
    problem = tracking_problems(box_points(4, 4), 4)
    dense = CLARABEL.solve(replace(problem, sparsity=None))
    np.testing.assert_allclose(
        objective(problem, dense.inputs),
        objective(problem, CLARABEL.solve(problem).inputs),
        rtol=1e-8,
    )


@kinds
def test_plans_are_inside_the_box(kind) -> None:
    """At so coarse a tolerance the library's own answers go beyond the bounds."""
    problem = tracking_problems(box_points(10, 5), 5)
    plans = kind(tolerance=0.5).solve(problem).inputs
    assert (plans >= problem.input_low).all()
    assert (plans <= problem.input_high).all()


@both
def test_nothing_leaks_from_one_problem_into_the_next(solver) -> None:
    count = 5 if solver is CVXPY else 40
    problem = tracking_problems(box_points(count, 6), 6)
    first = solver.solve(problem)
    order = np.random.default_rng(0).permutation(count)
    for env_index in order:
        alone = problem.take(slice(env_index, env_index + 1))
        again = solver.solve(alone)
        fresh = type(solver)().solve(alone) if env_index < 1 else again
        for answer in (again, fresh):
            np.testing.assert_array_equal(answer.inputs[0], first.inputs[env_index])
            assert answer.iterations[0] == first.iterations[env_index]


def test_a_failed_solve_leaks_nothing() -> None:
    problem = tracking_problems(box_points(6, 7), 7)
    before = CLARABEL.solve(problem)
    huge = replace(problem, state_weights=problem.state_weights * 1e250)
    assert (CLARABEL.solve(huge).status != Status.SOLVED).any()
    np.testing.assert_array_equal(CLARABEL.solve(problem).inputs, before.inputs)


def test_robust_solves_leave_the_fast_ones_alone() -> None:
    problem = tracking_problems(box_points(6, 8), 8)
    before = CLARABEL.solve(problem).inputs
    robust = CLARABEL.solve(problem, robust=True).inputs
    assert not np.array_equal(robust, before)
    np.testing.assert_array_equal(CLARABEL.solve(problem).inputs, before)


@kinds
def test_a_pickled_solver_gives_the_same_bits(kind) -> None:
    problem = tracking_problems(box_points(3, 9), 9)
    original: Solver = kind(tolerance=1e-7)
    before = original.solve(problem).inputs
    copy = pickle.loads(pickle.dumps(original))
    np.testing.assert_array_equal(copy.solve(problem).inputs, before)


@kinds
def test_running_out_of_iterations_has_a_status(kind) -> None:
    answer = kind(max_iterations=1).solve(tracking_problems(box_points(2, 10), 10))
    np.testing.assert_array_equal(answer.status, Status.ITERATION_LIMIT)


def test_every_status_reads_as_a_sentence() -> None:
    for status in Status:
        assert status.sentence.endswith(".")
