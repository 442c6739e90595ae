"""The search for a plan, on small models and with solvers that do what the test says."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from zoac.errors import ConfigError
from zoac.mpc.policy import MOST_LINEARISATIONS, MpcOptions, Objective, Plan, SequentialQp
from zoac.mpc.solvers.base import LinearisedProblem, Solution, Sparsity, Status
from zoac.mpc.solvers.clarabel_qp import ClarabelSolver

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
    """Answers the plan (lane's mark + call number / 10) with a status that a function gives.

    A lane's mark is its start angle, so that lanes are told apart in any batch.
    """

    screens = False

    def __init__(self, status: Callable[[int, float, bool], Status]) -> None:
        self._status = status
        self.calls: list[tuple[LinearisedProblem, bool]] = []

    def solve(self, problem: LinearisedProblem, careful: bool = False) -> Solution:
        self.calls.append((problem, careful))
        number = sum(not c for _, c in self.calls)
        marks = problem.states[:, 0, 0]
        plans = np.zeros_like(problem.inputs) + (marks + number / 10)[:, None, None]
        status = [self._status(number, mark, careful) for mark in marks]
        return Solution(plans, np.array(status, np.int8), np.ones(len(marks), np.int64))


def search(solver, linearisations=3, start=(0.3, -0.2, 0.5), gravity=0.4) -> Plan:
    angle = np.array(start)
    n = len(angle)
    objective = Objective(
        np.zeros((n, HORIZON, 2)), np.ones((n, HORIZON, 2)), np.full((n, HORIZON, 1), 0.1)
    )
    return SequentialQp(Pendulum(), solver, linearisations).plan(
        np.full((n, 1), gravity),
        np.stack([angle, np.zeros(n)], axis=1),
        objective,
        np.zeros((n, HORIZON, 1)),
    )


def always(status: Status) -> Callable[[int, float, bool], Status]:
    return lambda number, mark, careful: status


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


def test_until_converged_each_lane_stops_by_itself() -> None:
    together = search(ClarabelSolver(), "converged", start=(0.0, 0.3, 2.5))
    assert len(set(together.linearisations)) > 1
    for lane, angle in enumerate((0.0, 0.3, 2.5)):
        alone = search(ClarabelSolver(), "converged", start=(angle,))
        np.testing.assert_array_equal(alone.inputs[0], together.inputs[lane])
        assert alone.linearisations[0] == together.linearisations[lane]


def test_a_plan_that_never_stands_still_is_cut() -> None:
    plan = search(Scripted(always(Status.SOLVED)), "converged")
    np.testing.assert_array_equal(plan.linearisations, MOST_LINEARISATIONS)


def test_what_failed_is_solved_once_more_carefully() -> None:
    fails_once = Scripted(
        lambda number, mark, careful: (
            Status.INACCURATE if mark < 0 and number == 2 and not careful else Status.SOLVED
        )
    )
    plan = search(fails_once)
    careful = [problem for problem, careful in fails_once.calls if careful]
    assert len(careful) == 1
    np.testing.assert_array_equal(careful[0].states[:, 0, 0], [-0.2])
    np.testing.assert_array_equal(plan.retried, [False, True, False])
    np.testing.assert_array_equal(plan.status, Status.SOLVED)
    np.testing.assert_array_equal(plan.linearisations, 3)


def test_after_two_failures_the_last_plan_that_solved_is_kept() -> None:
    solver = Scripted(
        lambda number, mark, careful: (
            Status.NUMERICAL_FAILURE if mark < 0 and number == 2 else Status.SOLVED
        )
    )
    plan = search(solver)
    np.testing.assert_allclose(plan.inputs[:, 0, 0], [0.6, -0.1, 0.8])
    np.testing.assert_array_equal(plan.status, [0, Status.NUMERICAL_FAILURE, 0])
    np.testing.assert_array_equal(plan.failed, [False, True, False])
    np.testing.assert_array_equal(plan.linearisations, [3, 2, 3])


def test_without_a_plan_that_solved_the_input_is_zero() -> None:
    plan = search(Scripted(always(Status.ITERATION_LIMIT)))
    np.testing.assert_array_equal(plan.inputs, 0.0)
    np.testing.assert_array_equal(plan.status, Status.ITERATION_LIMIT)


def test_problems_that_are_not_finite_never_reach_the_solver() -> None:
    solver = Scripted(always(Status.SOLVED))
    plan = search(solver, start=(0.3, np.nan, 0.5))
    assert all(np.isfinite(problem.states).all() for problem, _ in solver.calls)
    assert not any(careful for _, careful in solver.calls)
    np.testing.assert_array_equal(plan.inputs[1], 0.0)
    np.testing.assert_array_equal(plan.status, [0, Status.NOT_FINITE, 0])
    np.testing.assert_allclose(plan.inputs[[0, 2], 0, 0], [0.6, 0.8])


def test_with_no_finite_lane_the_solver_is_not_called() -> None:
    solver = Scripted(always(Status.SOLVED))
    plan = search(solver, start=(np.nan,))
    assert solver.calls == []
    np.testing.assert_array_equal(plan.failed, [True])


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"horizon": 0}, "mpc.horizon: must be at least 1, got 0"),
        (
            {"linearisations": 0},
            "mpc.linearisations: expected a number from 1 or 'converged', got 0",
        ),
        (
            {"linearisations": "all"},
            "mpc.linearisations: expected a number from 1 or 'converged', got 'all'",
        ),
        (
            {"linearise_about": "zero"},
            "mpc.linearise_about: unknown 'zero'; did you mean 'zero_input'? "
            "known: shifted_plan, zero_input",
        ),
    ],
)
def test_wrong_options_are_named(options: dict, message: str) -> None:
    with pytest.raises(ConfigError) as caught:
        MpcOptions(**options)
    assert str(caught.value) == message


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
