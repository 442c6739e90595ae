"""The search for a plan, on small models and with solvers that do what the test says."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy.optimize import least_squares

from zoac.core.errors import ConfigError
from zoac.mpc.problem import LinearisedProblem, Solution, Sparsity, Status
from zoac.mpc.solvers.clarabel_qp import ClarabelSolver
from zoac.mpc.solvers.riccati import Riccati
from zoac.mpc.sqp import MAX_LINEARISATIONS, MpcOptions, Objective, Plan, SequentialQp
from zoac.tasks.mpc_tracking.vehicle import TRUE_PARAMETERS, BicycleModel

HORIZON = 3


class Pendulum:
    """x = (angle, rate), u = torque; theta[0] is the strength of gravity, 0 makes it linear."""

    input_low = np.array([-1.0])
    input_high = np.array([1.0])
    sparsity = Sparsity(a=np.array([[1, 1], [1, 1]], bool), b=np.array([[0], [1]], bool))

    def linearise(self, theta, start, inputs):
        n, horizon, _ = inputs.shape
        states = np.empty((n, horizon + 1, 2))
        states[:, 0] = start
        a, b = np.zeros((n, horizon, 2, 2)), np.zeros((n, horizon, 2, 1))
        for k in range(horizon):
            angle, rate = states[:, k, 0], states[:, k, 1]
            states[:, k + 1, 0] = angle + 0.3 * rate
            states[:, k + 1, 1] = rate - theta[:, 0] * np.sin(angle) + inputs[:, k, 0]
            a[:, k, 0, 0] = a[:, k, 1, 1] = b[:, k, 1, 0] = 1.0
            a[:, k, 0, 1] = 0.3
            a[:, k, 1, 0] = -theta[:, 0] * np.cos(angle)
        return states, a, b


class Scripted:
    """Answers the plan (environment's mark + call number / 10) with a status that a function gives.

    An environment's mark is its start angle, so that environments are told apart in any batch.
    """

    screens = False

    def __init__(self, status: Callable[[int, float, bool], Status]) -> None:
        self._status = status
        self.calls: list[tuple[LinearisedProblem, bool]] = []

    def solve(self, problem: LinearisedProblem, robust: bool = False) -> Solution:
        self.calls.append((problem, robust))
        number = sum(not c for _, c in self.calls)
        marks = problem.states[:, 0, 0]
        plans = np.zeros_like(problem.inputs) + (marks + number / 10)[:, None, None]
        status = [self._status(number, mark, robust) for mark in marks]
        return Solution(plans, np.array(status, np.int8), np.ones(len(marks), np.int64))


def search(solver, linearisations=3, start=(0.3, -0.2, 0.5), gravity=0.4) -> Plan:
    angle = np.array(start)
    n = len(angle)
    objective = Objective(
        np.zeros((n, HORIZON, 2)), np.ones((n, HORIZON, 2)), np.full((n, HORIZON, 1), 0.1),
        np.full((n, 1), 0.25),
    )  # fmt: skip
    return SequentialQp(Pendulum(), solver, linearisations).plan(
        np.full((n, 1), gravity),
        np.stack([angle, np.zeros(n)], axis=1),
        objective,
        np.zeros((n, HORIZON, 1)),
    )


def always(status: Status) -> Callable[[int, float, bool], Status]:
    return lambda number, mark, robust: status


def test_the_last_solution_is_the_plan() -> None:
    plan = search(Scripted(always(Status.SOLVED)))
    np.testing.assert_allclose(plan.inputs[:, 0, 0], [0.6, 0.1, 0.8])
    np.testing.assert_array_equal(plan.linearisations, 3)


def test_each_problem_is_linearised_about_the_plan_before() -> None:
    solver = Scripted(always(Status.SOLVED))
    search(solver)
    first, second = (problem.states for problem, _ in solver.calls[:2])
    expected = Pendulum().linearise(np.full((1, 1), 0.4), [[0.3, 0]], np.full((1, HORIZON, 1), 0.4))
    np.testing.assert_array_equal(second[0], expected[0][0])
    assert not np.array_equal(first[0], second[0])


def test_a_linear_model_needs_one_programme() -> None:
    """A second one finds the same plan, which is how the search knows that it has converged."""
    plan = search(ClarabelSolver(), "converged", gravity=0.0)
    np.testing.assert_array_equal(plan.linearisations, 2)


def test_until_converged_each_environment_stops_by_itself() -> None:
    together = search(ClarabelSolver(), "converged", start=(0.0, 0.3, 2.5))
    assert len(set(together.linearisations)) > 1
    for env_index, angle in enumerate((0.0, 0.3, 2.5)):
        alone = search(ClarabelSolver(), "converged", start=(angle,))
        np.testing.assert_array_equal(alone.inputs[0], together.inputs[env_index])
        assert alone.linearisations[0] == together.linearisations[env_index]


def test_a_plan_that_never_stands_still_is_cut() -> None:
    plan = search(Scripted(always(Status.SOLVED)), "converged")
    np.testing.assert_array_equal(plan.linearisations, MAX_LINEARISATIONS)


def test_what_failed_is_solved_once_more_carefully() -> None:
    fails_once = Scripted(
        lambda number, mark, robust: (
            Status.INACCURATE if mark < 0 and number == 2 and not robust else Status.SOLVED
        )
    )
    plan = search(fails_once)
    robust = [problem for problem, robust in fails_once.calls if robust]
    assert len(robust) == 1
    np.testing.assert_array_equal(robust[0].states[:, 0, 0], [-0.2])
    np.testing.assert_array_equal(plan.retried, [False, True, False])
    np.testing.assert_array_equal(plan.status, Status.SOLVED)
    np.testing.assert_array_equal(plan.linearisations, 3)


def test_after_two_failures_the_last_plan_that_solved_is_kept() -> None:
    solver = Scripted(
        lambda number, mark, robust: (
            Status.NUMERICAL_FAILURE if mark < 0 and number == 2 else Status.SOLVED
        )
    )
    plan = search(solver)
    np.testing.assert_allclose(plan.inputs[:, 0, 0], [0.6, -0.1, 0.8])
    np.testing.assert_array_equal(plan.status, [0, Status.NUMERICAL_FAILURE, 0])
    told = plan.diagnostics(plan.inputs[:, 0])
    np.testing.assert_array_equal(told["solver_failed"], [False, True, False])
    np.testing.assert_array_equal(plan.linearisations, [3, 2, 3])


def test_without_a_plan_that_solved_the_input_is_at_rest() -> None:
    plan = search(Scripted(always(Status.ITERATION_LIMIT)))
    np.testing.assert_array_equal(plan.inputs, 0.25)
    np.testing.assert_array_equal(plan.status, Status.ITERATION_LIMIT)


def test_problems_that_are_not_finite_never_reach_the_solver() -> None:
    solver = Scripted(always(Status.SOLVED))
    plan = search(solver, start=(0.3, np.nan, 0.5))
    assert all(np.isfinite(problem.states).all() for problem, _ in solver.calls)
    assert not any(robust for _, robust in solver.calls)
    np.testing.assert_array_equal(plan.inputs[1], 0.25)
    np.testing.assert_array_equal(plan.status, [0, Status.NOT_FINITE, 0])
    np.testing.assert_allclose(plan.inputs[[0, 2], 0, 0], [0.6, 0.8])


def test_with_no_finite_environment_the_solver_is_not_called() -> None:
    solver = Scripted(always(Status.SOLVED))
    plan = search(solver, start=(np.nan,))
    assert solver.calls == []
    np.testing.assert_array_equal(plan.status, [Status.NOT_FINITE])


@pytest.mark.parametrize(
    ("option", "value", "message"),
    [
        ("horizon", 0, "must be at least 1, got 0"),
        ("linearisations", 0, "expected a number from 1 or 'converged', got 0"),
        ("linearisations", "all", "expected a number from 1 or 'converged', got 'all'"),
        ("initial_guess", "zerro", "unknown 'zerro'; did you mean 'zero'? known: shifted, zero"),
    ],
)
def test_wrong_options_are_named(option: str, value: object, message: str) -> None:
    with pytest.raises(ConfigError) as caught:
        MpcOptions(**{option: value})
    assert str(caught.value) == f"mpc.{option}: {message}"


@pytest.mark.parametrize(
    ("a", "b", "named"),
    [
        ([[1, 1], [0, 1]], [[0], [1]], "dF/dX[1, 0] is always zero, but it is 0.4 here"),
        ([[1, 1], [1, 1]], [[0], [0]], "dF/dU[1, 0] is always zero, but it is 1 here"),
    ],
)
def test_a_model_that_is_less_sparse_than_it_says_is_told_so(a, b, named, monkeypatch) -> None:
    monkeypatch.setattr(Pendulum, "sparsity", Sparsity(np.array(a, bool), np.array(b, bool)))
    with pytest.raises(ConfigError) as caught:
        search(Scripted(always(Status.SOLVED)), start=(0.0, 0.0))
    assert named in str(caught.value)


class Bounded(BicycleModel):
    """The paper's vehicle, inputs in a unit of their own, with the bounds that a test gives.

    A small model of two inputs would be one more size for Riccati, which takes long to compile.
    """

    def __init__(self, low, high, unit: float = 1.0) -> None:
        self.input_low, self.input_high = np.array(low) * unit, np.array(high) * unit
        self._unit = unit

    def linearise(self, theta, start, inputs):
        states, a, b = super().linearise(theta, start, inputs / self._unit)
        return states, a, b / self._unit


@pytest.mark.parametrize("solver", [ClarabelSolver, Riccati])
@pytest.mark.parametrize("unit", [1.0, 1e-6, 1e6])
@pytest.mark.parametrize(
    ("low", "high"),
    [
        pytest.param((-np.inf, -np.inf), (np.inf, np.inf), id="free"),
        pytest.param((-0.2, -np.inf), (np.inf, 0.1), id="one-sided"),
        pytest.param((0.1, -np.inf), (0.1, np.inf), id="fixed and free"),
        pytest.param((0.0, -1.0), (0.0, 1.0), id="fixed and boxed"),
    ],
)
def test_until_converged_is_the_nonlinear_optimum_whatever_the_bounds(
    solver, low, high, unit
) -> None:
    """Against SciPy on the nonlinear problem itself; inputs in units, milli- and megaunits."""
    model, horizon = Bounded(low, high, unit), 8
    goal = np.array([0.0, 0.0, 0.0, 18.0, 0.0, 0.0])
    weights = np.array([0.0, 1.0, 1.0, 1.0, 0.1, 0.1])
    objective = Objective(
        np.tile(goal, (1, horizon, 1)),
        np.tile(weights, (1, horizon, 1)),
        np.full((1, horizon, 2), 0.1) / unit**2,
        np.zeros((1, 2)),
    )
    start, theta = np.array([[0.0, 2.0, 1.0, 15.0, 1.0, 1.0]]), np.array([TRUE_PARAMETERS])
    guess = np.tile(np.clip(0.0, model.input_low, model.input_high), (1, horizon, 1))
    plan = SequentialQp(model, solver(), "converged").plan(theta, start, objective, guess)
    assert plan.status == [Status.SOLVED]
    assert plan.linearisations < MAX_LINEARISATIONS

    def residuals(inputs):
        inputs = inputs.reshape(1, horizon, 2) * unit
        states, _, _ = model.linearise(theta, start, inputs)
        errors = np.sqrt(weights) * (states[0, 1:] - goal)
        return np.concatenate([errors.ravel(), np.sqrt(0.1) / unit * inputs[0].ravel()])

    wide = np.tile(np.array(low), horizon), np.tile(np.array(high) + 1e-9, horizon)
    at = np.clip(plan.inputs[0].ravel() / unit, *wide)
    best = least_squares(residuals, at, "3-point", wide, xtol=1e-15, ftol=1e-15, gtol=1e-12)
    np.testing.assert_allclose(plan.inputs[0].ravel() / unit, best.x, atol=1e-5)
