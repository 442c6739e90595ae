"""One ranking of episodes, and numbers that keep it."""

import functools
from dataclasses import replace

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.support import CountingTask, engine, proposal
from zoac.rollout.outcomes import LARGEST, CostRange, Outcomes, ranking, step_costs

EPISODES = st.lists(
    st.tuples(
        st.one_of(st.just(0.0), st.floats(0.0, 1e6)),
        st.floats(allow_nan=True, allow_infinity=True),
    ),
    min_size=1,
    max_size=12,
)


@functools.cache
def segment():
    return engine(CountingTask(1), [0]).rollout([proposal(0)])[0]


def segments(episodes):
    """Return segments with these violations and total costs."""
    made = [segment().with_costs(np.array([cost])) for _, cost in episodes]
    return [replace(s, violation=v) for s, (v, _) in zip(made, episodes, strict=True)]


def expected(one, other):
    """Tell whether an episode is clearly better than another: the rule, word by word."""
    (v, cost), (w, other_cost) = one, other
    if np.isfinite(cost) != np.isfinite(other_cost):
        return bool(np.isfinite(cost))
    if not np.isfinite(cost):
        return False
    if (v == 0) != (w == 0):
        return v == 0
    return v == 0 and cost < other_cost and abs(cost) < LARGEST and abs(other_cost) < LARGEST


@settings(max_examples=50)
@given(EPISODES)
def test_any_episode_that_violates_or_is_not_finite_is_behind_all_others(episodes):
    outcomes = Outcomes.of(segments(episodes))
    costs = CostRange()
    costs.add(outcomes)
    position = np.argsort(outcomes.order)
    for numbers in (position, outcomes.keys(), costs.prices(outcomes)):
        assert np.isfinite(numbers).all()
        for i, one in enumerate(episodes):
            for j, other in enumerate(episodes):
                if expected(one, other):
                    assert numbers[i] < numbers[j]


@settings(max_examples=50)
@given(EPISODES, EPISODES)
def test_a_key_does_not_depend_on_what_else_is_known(early, late):
    """So a number that was told once is never overtaken."""
    together = Outcomes.of(segments(early)) + Outcomes.of(segments(late))
    np.testing.assert_array_equal(
        together.keys()[: len(early)], Outcomes.of(segments(early)).keys()
    )


@given(st.lists(st.floats(-1e19, 1e19), min_size=1))
def test_costs_without_fault_are_told_as_they_are(costs):
    outcomes = Outcomes.of(segments([(0.0, cost) for cost in costs]))
    np.testing.assert_array_equal(outcomes.keys(), costs)
    np.testing.assert_array_equal(CostRange().prices(outcomes), costs)


def test_the_worst_cost_the_worst_so_far_plus_the_range():
    outcomes = Outcomes.of(segments([(0.0, 2.0), (0.0, 5.0), (0.0, np.nan), (1.0, 0.0)]))
    costs = CostRange()
    assert costs.prices(outcomes)[2:].tolist() == [0.0, -0.25]  # before any is known
    costs.add(outcomes)
    assert costs.prices(outcomes).tolist() == [2.0, 5.0, 8.0, 7.25]


def test_ties_stay_in_order_and_minus_infinity_is_last():
    violations, costs = np.array([0.0, 0.0, 0.0, 0.0]), np.array([1.0, -np.inf, 1.0, 0.0])
    assert ranking(violations, costs).tolist() == [3, 0, 2, 1]


def test_a_step_that_costs_no_number_costs_as_the_worst_so_far():
    costs, worst = step_costs(np.array([np.nan, -1.0]), 0.0)
    assert (costs.tolist(), worst) == ([0.0, -1.0], 0.0)
    costs, worst = step_costs(np.array([-np.inf, 3.0, np.inf]), worst)
    assert (costs.tolist(), worst) == ([3.0, 3.0, 3.0], 3.0)
    assert step_costs(np.array([np.nan]), worst)[0].tolist() == [3.0]
