"""Problems in odd units: the same plan, or no claim that it is one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.mpc.problems import box_points, dense_problems, objective, tracking_problems
from tests.riccati.problems import cart_poles, quadrotors
from zoac.mpc.attempt import Attempt
from zoac.mpc.problem import LinearisedProblem, Status
from zoac.mpc.solvers import clarabel_qp
from zoac.mpc.solvers.certificate import is_optimal
from zoac.mpc.solvers.clarabel_qp import ClarabelSolver
from zoac.mpc.solvers.cvxpy_qp import CvxpySolver
from zoac.mpc.solvers.riccati import Riccati
from zoac.mpc.solvers.scaling import units

CLARABEL = ClarabelSolver()
SOLVERS = [CLARABEL, CvxpySolver(), Riccati()]
"""Shared, since a layout takes a third of a second to prepare."""
solvers = pytest.mark.parametrize("solver", SOLVERS, ids=["clarabel", "cvxpy", "riccati"])


def three_masses(s: float, horizon: int = 25) -> LinearisedProblem:
    """Return masses between springs, of which the first two are pushed, positions in 1/s metres.

    Of the cart-poles' size, since a size takes long to compile.
    """
    metres = np.array([s, 1.0] * 3)
    springs = np.array([[-1.0, 1.0, 0.0], [1.0, -2.0, 1.0], [0.0, 1.0, -1.0]])
    moves = np.kron(np.eye(3), [[0, 1], [0, 0]]) + np.kron(springs, [[0, 0], [1, 0]])
    a = np.eye(6) + 0.1 * moves
    b = np.kron(np.eye(3, 2), [[0.005], [0.1]])
    states = np.tile(metres * [0.1, 0.0, 0.0, 0.0, 0.0, 0.0], (1, horizon + 1, 1))
    return LinearisedProblem(
        states=states,
        inputs=np.zeros((1, horizon, 2)),
        a=np.tile(a * metres[:, None] / metres, (1, horizon, 1, 1)),
        b=np.tile(b * metres[:, None], (1, horizon, 1, 1)),
        reference=np.zeros((1, horizon, 6)),
        state_weights=np.tile(metres**-2.0, (1, horizon, 1)),
        input_weights=np.full((1, horizon, 2), 0.1),
        input_low=np.array([-1.0, -1.0]),
        input_high=np.array([1.0, 1.0]),
    )


def in_units(problem: LinearisedProblem, x: np.ndarray, u: np.ndarray, cost: float = 1.0):
    """Return the same problem with states, inputs and cost multiplied by these factors."""
    return replace(
        problem,
        states=problem.states * x,
        inputs=problem.inputs * u,
        a=problem.a * x[:, None] / x,
        b=problem.b * x[:, None] / u,
        reference=problem.reference * x,
        state_weights=problem.state_weights / x**2 * cost,
        input_weights=problem.input_weights / u**2 * cost,
        input_low=problem.input_low * u,
        input_high=problem.input_high * u,
    )


@solvers
@pytest.mark.parametrize("exponent", [-8, -4, 4, 8])
def test_the_unit_of_a_state_does_not_change_the_plan(solver, exponent: int) -> None:
    plain = Riccati().solve(three_masses(1.0)).inputs
    solution = solver.solve(three_masses(10.0**exponent))
    assert solution.status == [Status.SOLVED]
    np.testing.assert_allclose(solution.inputs, plain, atol=1e-6)


@pytest.mark.parametrize("bounds", ["box", "free"])
@pytest.mark.parametrize("exponent", [2, 8])
@pytest.mark.parametrize(
    "problem",
    [
        pytest.param(quadrotors(20, 5, 0), id="quadrotor"),
        pytest.param(cart_poles(20, 5, 2), id="cart-pole"),
        pytest.param(dense_problems(5, 7, 6, 2, 2), id="dense"),
    ],
)
def test_mixed_units_do_not_change_the_cost(problem, exponent: int, bounds: str) -> None:
    """Each state, each input and the cost in a unit of its own, as micrometres beside megawatts."""
    rng = np.random.default_rng(exponent)
    nx, nu = problem.b.shape[2:]
    if bounds == "free":
        no = np.full(nu, np.inf)
        problem = replace(problem, input_low=-no, input_high=no)
    x, u = (10.0 ** rng.uniform(-exponent, exponent, size) for size in (nx, nu))
    answer = Attempt(CLARABEL, in_units(problem, x, u, 10.0**-exponent))
    np.testing.assert_array_equal(answer.status, Status.SOLVED)
    least = objective(problem, Riccati().solve(problem).inputs)
    np.testing.assert_allclose(objective(problem, answer.inputs / u), least, rtol=1e-6)


def test_well_scaled_problems_are_solved_as_they_stand() -> None:
    found = units(tracking_problems(box_points(2000, 0), 0))
    assert (found.states == 1.0).all()
    assert (found.cost == 1.0).all()


@solvers
@pytest.mark.parametrize(
    "problem",
    [
        pytest.param(tracking_problems(box_points(30, 3), 3), id="vehicle"),
        pytest.param(quadrotors(20, 10, 4), id="quadrotor"),
        pytest.param(three_masses(1e8), id="badly scaled"),
    ],
)
def test_what_is_said_to_be_solved_is_proven(solver, problem) -> None:
    solution = solver.solve(problem)
    assert (solution.status == Status.SOLVED).all()
    assert is_optimal(problem, solution.inputs).all()


def test_a_plan_beside_the_optimum_is_not_proven() -> None:
    problem = tracking_problems(box_points(200, 5), 5)
    plans = Riccati().solve(problem).inputs
    middle = 0.5 * (problem.input_low + problem.input_high)
    off = plans + 0.05 * (middle - plans)
    least, cost = objective(problem, plans), objective(problem, off)
    clearly = cost > 1.001 * least
    assert clearly.sum() > 100
    assert not is_optimal(problem, off)[clearly].any()


def test_a_plan_at_rest_is_proven_in_spite_of_rounding() -> None:
    problem = three_masses(1.0)
    at_rest = replace(problem, states=np.zeros_like(problem.states))
    assert is_optimal(at_rest, np.full_like(problem.inputs, 1e-9)).all()
    assert not is_optimal(at_rest, np.full_like(problem.inputs, 1e-3)).any()


def test_a_plan_that_is_not_a_number_is_not_proven() -> None:
    problem = three_masses(1.0)
    for wrong in (np.nan, np.inf):
        assert not is_optimal(problem, np.full_like(problem.inputs, wrong)).any()
    assert not is_optimal(replace(problem, states=problem.states * 1e200), problem.inputs).any()


@pytest.mark.parametrize("solver", [ClarabelSolver, CvxpySolver])
def test_a_plan_without_proof_is_not_said_to_be_solved(solver) -> None:
    """So coarse a tolerance lets the library stop far from the optimum and call it solved."""
    answer = Attempt(solver(tolerance=0.5), tracking_problems(box_points(10, 5), 5))
    assert answer.retried.any()
    assert (answer.status == Status.INACCURATE).any()


def test_a_bad_fast_solve_leads_to_a_robust_one(monkeypatch) -> None:
    """Without units the fast way ends half of the input's range off, and says solved."""
    problem = three_masses(1e7)
    plain = three_masses(1.0)
    monkeypatch.setattr(
        clarabel_qp, "units", lambda p, always: units(p, always) if always else units(plain)
    )
    answer = Attempt(ClarabelSolver(), problem)
    assert answer.retried.tolist() == [True]
    assert answer.status == [Status.SOLVED]
    np.testing.assert_allclose(answer.inputs, Riccati().solve(plain).inputs, atol=1e-6)
