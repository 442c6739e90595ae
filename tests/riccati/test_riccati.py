"""The structured solver: exact by other people's measure, pure, and honest where it fails."""

from __future__ import annotations

import multiprocessing
import pickle
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from tests.mpc.problems import box_points, tracking_problems
from tests.riccati import oracle
from tests.riccati.oracle import (
    condense,
    kkt_error,
    optimal_value,
    solve_condensed,
    solve_in_extended_precision,
)
from tests.riccati.problems import cart_poles, gappy, quadrotors
from zoac.core.errors import ConfigError
from zoac.mpc.problem import LinearisedProblem, Status
from zoac.mpc.riccati import solve_about
from zoac.mpc.solvers import riccati
from zoac.mpc.solvers.clarabel_qp import ClarabelSolver
from zoac.mpc.solvers.riccati import Riccati
from zoac.tasks.mpc_tracking.vehicle import INPUT_HIGH

SOLVER = Riccati()


def vehicles(n: int, seed: int) -> LinearisedProblem:
    return tracking_problems(box_points(n, seed), seed)


def rows(problem: LinearisedProblem, lanes: list[int]) -> LinearisedProblem:
    return problem.take(np.array(lanes))


@pytest.mark.parametrize("robust", [False, True])
def test_plans_of_the_whole_box_satisfy_the_kkt_conditions(robust: bool) -> None:
    problem = vehicles(500, 0)
    solution = SOLVER.solve(problem, robust)
    np.testing.assert_array_equal(solution.status, Status.SOLVED)
    assert kkt_error(problem, solution.inputs).max() < 1e-6


@pytest.mark.parametrize(
    "problem",
    [
        pytest.param(vehicles(150, 1), id="vehicle"),
        pytest.param(cart_poles(25, 30, 2), id="cart-pole"),
        pytest.param(cart_poles(1, 20, 3), id="horizon 1"),
        pytest.param(cart_poles(200, 3, 4), id="horizon 200"),
        pytest.param(quadrotors(40, 20, 5), id="quadrotor"),
        pytest.param(gappy(25, 20, 6), id="gappy"),
    ],
)
@pytest.mark.parametrize("robust", [False, True])
def test_plans_agree_with_quadprog_on_the_condensed_problem(
    problem: LinearisedProblem, robust: bool
) -> None:
    solution = SOLVER.solve(problem, robust)
    np.testing.assert_array_equal(solution.status, Status.SOLVED)
    for lane, plan in enumerate(solution.inputs):
        np.testing.assert_allclose(plan, solve_condensed(problem, lane), rtol=0, atol=1e-7)


@pytest.mark.parametrize(("seed", "lane"), [(1053, 514), (1071, 606), (1096, 585)])
def test_badly_conditioned_problems_are_solved_to_more_digits_than_condensing_leaves(
    seed: int, lane: int
) -> None:
    problem = rows(tracking_problems(box_points(1000, seed), seed), [lane])
    assert np.linalg.cond(condense(problem, 0)[0]) > 1e10
    solution = SOLVER.solve(problem)
    exact = solve_in_extended_precision(problem, 0)
    assert solution.status[0] == Status.SOLVED
    np.testing.assert_allclose(solution.inputs[0], exact, rtol=0, atol=1e-8)


@pytest.mark.parametrize("side", ["input_low", "input_high"])
def test_the_oracle_mends_the_active_set_that_it_begins_with(
    side: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    problem = cart_poles(3, 6, 2)
    plans = [solve_in_extended_precision(problem, lane) for lane in range(3)]
    everything_held = np.broadcast_to(getattr(problem, side), problem.inputs[0].shape)
    monkeypatch.setattr(oracle, "solve_condensed", lambda *_: everything_held)
    for lane, plan in enumerate(plans):
        np.testing.assert_array_equal(solve_in_extended_precision(problem, lane), plan)


def test_plans_cost_what_clarabels_cost() -> None:
    problem = vehicles(200, 11)
    ours, theirs = SOLVER.solve(problem), ClarabelSolver().solve(problem)
    np.testing.assert_array_equal(theirs.status, Status.SOLVED)
    value = optimal_value(problem, ours.inputs)
    np.testing.assert_allclose(value, optimal_value(problem, theirs.inputs), rtol=1e-6)
    assert (value <= optimal_value(problem, theirs.inputs) * (1 + 1e-9)).all()
    elsewhere = np.clip(ours.inputs + 0.01, problem.input_low, problem.input_high)
    assert (optimal_value(problem, elsewhere) > value * (1 + 1e-9)).mean() > 0.9


def test_inputs_at_a_bound_are_that_bound_bit_for_bit() -> None:
    problem = vehicles(500, 6)
    plans = SOLVER.solve(problem).inputs
    assert ((problem.input_low <= plans) & (plans <= problem.input_high)).all()
    for bound in (problem.input_low, problem.input_high):
        near = np.abs(plans - bound) < 1e-12
        assert near.any()
        np.testing.assert_array_equal(plans[near], np.broadcast_to(bound, plans.shape)[near])


def test_a_programme_about_its_own_solution_takes_one_sweep() -> None:
    problem = vehicles(200, 16)
    plans = SOLVER.solve(problem).inputs
    states = problem.states.copy()
    for k in range(25):
        states[:, k + 1] += np.einsum(
            "nij,nj->ni", problem.a[:, k], states[:, k] - problem.states[:, k]
        ) + np.einsum("nij,nj->ni", problem.b[:, k], plans[:, k] - problem.inputs[:, k])
    again = SOLVER.solve(replace(problem, inputs=plans, states=states))
    assert np.mean(again.iterations == 1) > 0.95
    np.testing.assert_allclose(again.inputs, plans, rtol=0, atol=1e-7)


def test_hard_problems_go_through_the_interior_point(monkeypatch) -> None:
    problem = vehicles(200, 7)
    plain = SOLVER.solve(problem)
    monkeypatch.setattr(riccati, "solve_about", partial(solve_about, sweeps=1))
    hard = SOLVER.solve(problem)
    assert (hard.iterations > 5).any()
    np.testing.assert_array_equal(hard.status, Status.SOLVED)
    np.testing.assert_allclose(hard.inputs, plain.inputs, rtol=0, atol=1e-8)


def mild(n: int, seed: int) -> LinearisedProblem:
    """Vehicles with weights so high on their inputs that hardly one reaches a bound."""
    problem = vehicles(n, seed)
    return replace(problem, input_weights=1e4 * problem.input_weights, inputs=0 * problem.inputs)


COMPANIES = {
    "vehicle": vehicles(61, 8),
    "mild vehicle": mild(61, 8),
    "mild vehicle, one input without bounds": replace(
        mild(61, 8), input_low=np.array([-np.inf, -3.0]), input_high=np.array([np.inf, 3.0])
    ),
    "mild vehicle about an input at its bound": replace(
        mild(61, 8), inputs=np.where(np.arange(25)[:, None] == 3, INPUT_HIGH, mild(61, 8).inputs)
    ),
    "cart-pole": cart_poles(25, 30, 2),
    "cart-pole, horizon 1": cart_poles(1, 20, 3),
    "quadrotor": quadrotors(40, 20, 5),
    "gappy": gappy(25, 30, 17),
}
MIXED = ("vehicle", "mild vehicle")


@pytest.mark.parametrize("name", COMPANIES)
@pytest.mark.parametrize("robust", [False, True])
def test_an_environment_has_the_same_bits_alone_in_any_company_and_after_anything(
    robust: bool, name: str
) -> None:
    problem = COMPANIES[name]
    together = SOLVER.solve(problem, robust)
    order = np.random.default_rng(0).permutation(len(problem.a)).tolist()
    shuffled = SOLVER.solve(rows(problem, order), robust)
    np.testing.assert_array_equal(shuffled.inputs, together.inputs[order])
    np.testing.assert_array_equal(shuffled.iterations, together.iterations[order])
    for lane in range(len(problem.a)):
        alone = SOLVER.solve(rows(problem, [lane]), robust)
        np.testing.assert_array_equal(alone.inputs[0], together.inputs[lane])
        assert alone.iterations[0] == together.iterations[lane]


@pytest.mark.parametrize("hair", [-1e-9, -1e-11, -1e-13, -1e-15, 0.0, 1e-15])
def test_an_input_that_passes_its_bound_by_a_hair_does_so_alone_and_in_company(
    hair: float,
) -> None:
    problem = COMPANIES["mild vehicle"]
    problem = replace(problem, inputs=problem.inputs + 0.0017)  # so that deviations round
    free = SOLVER.solve(problem)
    for lane in np.flatnonzero(free.iterations == 1)[:20].tolist():
        top = np.maximum(free.inputs[lane].max(axis=0), 2e-3) * (1.0 + hair)
        bounded = replace(problem, input_high=top)
        alone = SOLVER.solve(rows(bounded, [lane]))
        twice = SOLVER.solve(rows(bounded, [lane, lane]))
        np.testing.assert_array_equal(twice.inputs[1], alone.inputs[0])
        assert twice.iterations[1] == alone.iterations[0]
        assert (twice.inputs <= top).all()


def test_companies_hold_environments_in_which_inputs_reach_a_bound_and_others() -> None:
    few, most = (np.mean(SOLVER.solve(COMPANIES[name]).iterations == 1) for name in MIXED)
    assert 0.2 < few < 0.6
    assert 0.7 < most < 1.0


@pytest.mark.parametrize("name", MIXED)
def test_knowing_the_sparsity_changes_no_bit(name: str) -> None:
    known = SOLVER.solve(COMPANIES[name])
    unknown = SOLVER.solve(replace(COMPANIES[name], sparsity=None))
    np.testing.assert_array_equal(unknown.inputs, known.inputs)
    np.testing.assert_array_equal(unknown.iterations, known.iterations)


FIELDS = ("states", "inputs", "a", "b", "reference", "state_weights", "input_weights")


@pytest.mark.parametrize("field", FIELDS)
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("stage", [0, -1])
def test_data_that_are_not_finite_have_a_status_and_touch_no_other_environment(
    field: str, value: float, stage: int
) -> None:
    problem = vehicles(3, 9)
    array = getattr(problem, field).copy()
    array[1, stage].flat[-1] = value
    broken = SOLVER.solve(replace(problem, **{field: array}))
    assert broken.status.tolist() == [Status.SOLVED, Status.NOT_FINITE, Status.SOLVED]
    sound = SOLVER.solve(problem)
    np.testing.assert_array_equal(broken.inputs[[0, 2]], sound.inputs[[0, 2]])


@pytest.mark.parametrize("field", ["a", "b"])
def test_no_entry_of_a_jacobian_may_be_nan_even_one_that_is_said_to_be_zero(field: str) -> None:
    entries = getattr(vehicles(1, 9), field)[0, 0].size
    problem = vehicles(entries + 1, 9)
    array = getattr(problem, field).copy()
    for lane in range(entries):
        array[lane, 7].flat[lane] = np.nan
    status = SOLVER.solve(replace(problem, **{field: array})).status
    assert status.tolist() == [Status.NOT_FINITE] * entries + [Status.SOLVED]


def test_a_problem_without_a_minimum_has_a_status() -> None:
    problem = vehicles(2, 10)
    weights = problem.input_weights.copy()
    weights[0] = -1e6
    status = SOLVER.solve(replace(problem, input_weights=weights)).status
    assert status.tolist() == [Status.NUMERICAL_FAILURE, Status.SOLVED]


def test_too_few_steps_have_a_status_and_leave_a_plan_inside_the_box(monkeypatch) -> None:
    problem = vehicles(400, 11)
    few = partial(solve_about, sweeps=1, max_active_set_steps=1)
    monkeypatch.setattr(riccati, "solve_about", few)
    solution = SOLVER.solve(problem)
    short = solution.status == Status.ITERATION_LIMIT
    assert short.any()
    assert set(solution.status) == {Status.SOLVED, Status.ITERATION_LIMIT}
    assert kkt_error(problem, solution.inputs)[~short].max() < 1e-6
    assert (np.abs(solution.inputs) <= problem.input_high).all()


def test_inputs_without_bounds_are_free() -> None:
    problem = replace(
        vehicles(300, 12), input_low=np.array([-np.inf, -3.0]), input_high=np.array([np.inf, 3.0])
    )
    for robust in (False, True):
        solution = SOLVER.solve(problem, robust)
        np.testing.assert_array_equal(solution.status, Status.SOLVED)
        assert kkt_error(problem, solution.inputs).max() < 1e-6
        assert solution.iterations.max() < 30  # the active-set method alone takes up to 50


def test_equal_bounds_pin_an_input() -> None:
    problem = vehicles(40, 13)
    inputs = problem.inputs.copy()
    inputs[:, :, 1] = 0.5
    high, low = problem.input_high.copy(), problem.input_low.copy()
    high[1] = low[1] = 0.5
    pinned = replace(problem, inputs=inputs, input_low=low, input_high=high)
    for robust in (False, True):
        solution = SOLVER.solve(pinned, robust)
        np.testing.assert_array_equal(solution.status, Status.SOLVED)
        np.testing.assert_array_equal(solution.inputs[:, :, 1], 0.5)
        narrow = np.array([0.0, 1e-9])
        near = replace(pinned, input_low=low - narrow, input_high=high + narrow)
        for lane in range(5):
            np.testing.assert_allclose(
                solution.inputs[lane], solve_condensed(near, lane), rtol=0, atol=1e-7
            )


def test_bounds_out_of_order_are_the_callers_mistake() -> None:
    problem = vehicles(1, 14)
    with pytest.raises(ConfigError, match="input bounds must be numbers in order"):
        SOLVER.solve(replace(problem, input_low=problem.input_high + 1.0))


def _solve(solver: Riccati, problem: LinearisedProblem) -> np.ndarray:
    return solver.solve(problem).inputs


def test_a_worker_process_finds_the_same_bits() -> None:
    """One that is not forked: the test of the package alone."""
    problem = vehicles(20, 15)
    solver = pickle.loads(pickle.dumps(SOLVER))
    with multiprocessing.get_context("fork").Pool(1) as pool:
        there = pool.apply(_solve, (solver, problem))
    np.testing.assert_array_equal(there, SOLVER.solve(problem).inputs)
