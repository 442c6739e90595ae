"""Feasibility first, for tuners that see episodes and for those that see segments."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import zoac
from tests.envs.test_adapters import Drift
from tests.support import CountingTask, engine, proposal
from zoac.core.errors import ConfigError
from zoac.core.measures import Constraint
from zoac.rollout.constraints import FeasibilityFirst, excess, violations
from zoac.rollout.evaluation import evaluation_row
from zoac.rollout.outcomes import CostRange, Outcomes

A_LIMIT = Constraint("a below 3", lambda s: s.diagnostics["a"] - 3.0, scale=2.0)


def rolled(*values):
    return engine(CountingTask(), [0]).rollout([proposal(0, a) for a in values])


def test_excess_is_what_lies_above_zero():
    low, high, odd = rolled(1.0, 5.0, 4.0)
    assert excess(low, [A_LIMIT]).tolist() == [[0.0]] * 7
    assert excess(high, [A_LIMIT])[:, 0] == pytest.approx(2.0)
    broken = Constraint("broken", lambda s: np.full(s.length, np.nan))
    assert np.isinf(excess(odd, [broken])).all()


def told(constraints, batches):
    """Return what tuners are told of batches of segments, all together."""
    first = FeasibilityFirst(constraints)
    return [s for batch in batches for s in first.told(batch, batch)]


def costing(segment, cost):
    return segment.with_costs(np.full(segment.length, cost / segment.length))


EPISODES = st.lists(
    st.lists(st.tuples(st.floats(0.0, 10.0), st.floats(-1e12, 1e12)), min_size=1, max_size=4),
    min_size=1,
    max_size=4,
)


@given(EPISODES, st.sampled_from([0.5, None]), st.floats(-1.0, 9.0))
def test_any_episode_that_violates_ranks_behind_every_one_that_does_not(batches, scale, limit):
    """Whatever costs come earlier or later, and however small the excess."""
    constraint = Constraint("a", lambda s: s.diagnostics["a"], limit=limit, scale=scale)
    rolls = [
        [costing(s, cost) for s, (_, cost) in zip(rolled(*(a for a, _ in b)), b, strict=True)]
        for b in batches
    ]
    episodes = told([constraint], rolls)
    violates = np.array([bool((s.diagnostics["a"] > limit).any()) for s in episodes])
    outcomes = Outcomes.of(episodes)
    costs = CostRange()
    costs.add(outcomes)
    for numbers in (np.argsort(outcomes.order), outcomes.keys(), costs.prices(outcomes)):
        assert not (violates.any() and not violates.all()) or (
            numbers[violates].min() > numbers[~violates].max()
        )


def test_more_excess_and_more_steps_are_worse():
    ramp = Constraint("ramp", lambda s: np.arange(s.length) - s.diagnostics["a"], scale=2.0)
    outcomes = Outcomes.of(told([ramp], [rolled(9.0, 5.0, 4.0, 1.0)]))
    assert outcomes.violations[0] == 0.0
    assert (np.diff(outcomes.violations) > 0).all()


def test_the_unit_of_a_limit_does_not_matter():
    """5 mm of overshoot over a limit of 50 mm count as much as 0.005 m over 0.05 m."""
    in_m = Constraint("overshoot", lambda s: 0.02 * s.diagnostics["a"], limit=0.05)
    in_mm = Constraint("overshoot", lambda s: 20.0 * s.diagnostics["a"], limit=50.0)
    one, other = (told([c], [rolled(2.0, 2.6, 9.0)]) for c in (in_m, in_mm))
    for a, b in zip(one, other, strict=True):
        assert a.violation == pytest.approx(b.violation)
        np.testing.assert_allclose(a.costs, b.costs)
    assert one[0].violation == 0.0 < one[1].violation < one[2].violation


def test_without_a_limit_the_largest_excess_so_far_is_the_scale():
    small = Constraint("a", lambda s: 1e-6 * (s.diagnostics["a"] - 3.0))
    large = Constraint("a", lambda s: 1e6 * (s.diagnostics["a"] - 3.0))
    one, other = (told([c], [rolled(2.0, 4.0), rolled(9.0, 4.0)]) for c in (small, large))
    np.testing.assert_allclose([s.violation for s in one], [s.violation for s in other])
    # Seven steps each: 1 + 1/2 where the excess is the largest, later 1 + 1/7.
    np.testing.assert_allclose([s.violation for s in one], [0, 10.5, 10.5, 8.0])


def test_the_price_of_a_step_is_the_range_of_whole_episodes():
    """Zero is no episode's cost, and a part of an episode is no episode."""
    first = FeasibilityFirst([A_LIMIT])
    assert first.price == 1.0
    whole = [costing(s, c) for s, c in zip(rolled(1.0, 1.0), (500.0, 510.0), strict=True)]
    first.told(whole[:1], whole[:1])
    assert first.price == pytest.approx(500.0)
    first.told(whole[1:], whole[1:])
    assert first.price == pytest.approx(10.0)
    part = engine(CountingTask(), [0]).rollout([proposal(0, 1.0, horizon=2)])
    first.told(part, [costing(part[0], 3.0)])
    assert first.price == pytest.approx(10.0)


def test_what_is_not_finite_violates_but_minus_infinity_is_below_any_limit():
    for bad, scaled in ((np.nan, 2.0), (np.inf, 2.0), (-np.inf, 0.0)):
        broken = Constraint("broken", lambda s, bad=bad: np.full(s.length, bad))
        (segment,) = told([broken], [rolled(1.0)])
        assert segment.violation == scaled * segment.length


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"limit": np.nan}, "limit=nan, expected a finite number"),
        ({"limit": "1"}, "limit='1', expected a finite number"),
        ({"scale": 0.0}, "scale=0.0, expected a number above zero"),
        ({"scale": np.inf}, "scale=inf, expected a number above zero"),
    ],
)
def test_limits_and_scales_that_cannot_be_used_are_named(options, message):
    with pytest.raises(ConfigError, match=f"constraint 'c': {message}"):
        Constraint("c", lambda s: s.costs, **options)


def test_segments_of_an_episode_are_priced_as_the_episode():
    """Pieces of an episode and the whole one give the same range of costs."""
    whole, pieces = FeasibilityFirst([A_LIMIT]), FeasibilityFirst([A_LIMIT])
    group = engine(CountingTask(), [0])
    parts = group.rollout([proposal(0, 5.0, horizon=n) for n in (3, 2, 2)])
    pieces.told(parts, parts)
    (full,) = engine(CountingTask(), [0]).rollout([proposal(0, 5.0)])
    whole.told([full], [full])
    assert pieces.price == pytest.approx(whole.price)


def test_a_restored_one_continues_with_the_same_numbers():
    free = Constraint("a", lambda s: s.diagnostics["a"] - 3.0)
    one, other = FeasibilityFirst([A_LIMIT, free]), FeasibilityFirst([A_LIMIT, free])
    segments, later = rolled(1.0, 8.0), rolled(4.0)
    one.told(segments, segments)
    other.restore(one.state())
    assert one.told(later, later)[0].costs.tolist() == other.told(later, later)[0].costs.tolist()


def test_without_constraints_nothing_is_changed_or_reported():
    segments = rolled(1.0)
    assert FeasibilityFirst([]).told(segments, segments) == segments
    assert violations(segments, []) == {}


def test_violations_are_counted_by_episode_and_step():
    row = evaluation_row(rolled(1.0, 5.0, 4.0), [], [A_LIMIT])
    assert row["violations"] == 2
    counted = row["violations_by_constraint"]["a below 3"]
    assert counted == {"episodes": 2, "steps": 14, "worst": pytest.approx(2.0)}


def act(params, obs):
    return params["a"] - 0.5 * obs[0]


def leans_left(segment):
    """Above zero where parameter a is above -0.4."""
    return segment.actions[:, 0] + 0.5 * segment.observations[:-1, 0] + 0.4


@pytest.mark.parametrize(
    ("tuner", "budget", "options"),
    [
        ("random", 1000, {}),
        (
            "zoac",
            2000,
            {"critic": {"hidden": [16]}, "exploration": {"segment_length": 10, "segments": 2}},
        ),
    ],
)
def test_every_kind_of_tuner_keeps_a_constraint_that_costs(tuner, budget, options):
    """Free, a = 0 would be best; with the constraint the optimum is at its edge, a = -0.4."""
    result = zoac.tune(
        env=Drift, controller=act, space={"a": (-1.0, 1.0), "unused": (0.0, 1.0)},
        constraints={"left": leans_left}, tuner=tuner, budget=budget, tuner_options=options,
        num_envs=4, max_episode_steps=20, quiet=True, eval_every=budget, episodes=1,
        final_episodes=4, seed=1,
    )  # fmt: skip
    assert result.record["violations"] == 0
    assert -0.8 < result.parameters["a"] <= -0.4
