"""Feasibility first, for tuners that see episodes and for those that see segments."""

import numpy as np
import pytest

import zoac
from tests.core.test_adapters import Drift
from tests.support import CountingTask, lane_group, proposal
from zoac.constraints import FeasibilityFirst, excess, violations
from zoac.evaluation import evaluation_row
from zoac.task import Constraint

A_LIMIT = Constraint("a below 3", lambda s: s.diagnostics["a"] - 3.0, scale=2.0)


def rolled(*values):
    return lane_group(CountingTask(), [0]).rollout([proposal(0, a) for a in values])


def test_excess_is_what_lies_above_zero():
    low, high, odd = rolled(1.0, 5.0, 4.0)
    assert excess(low, [A_LIMIT]).tolist() == [[0.0]] * 7
    assert excess(high, [A_LIMIT])[:, 0] == pytest.approx(2.0)
    broken = Constraint("broken", lambda s: np.full(s.length, np.nan))
    assert np.isinf(excess(odd, [broken])).all()


def test_an_episode_that_violates_is_told_as_worse_than_every_one_before_that_does_not():
    segments = rolled(2.9, 0.1, 3.1, 9.0)
    told = [s.costs.sum() for s in FeasibilityFirst([A_LIMIT]).told(segments, segments)]
    assert told[:2] == [s.costs.sum() for s in segments[:2]]
    assert max(told[:2]) < told[2] < told[3]


def test_a_single_violating_step_is_enough():
    once = Constraint("once", lambda s: np.eye(1, s.length)[0] * 1e-6)
    segments = rolled(1.0, 8.0, 1.0)
    (told,) = FeasibilityFirst([once]).told(segments[2:], segments[2:])
    first = FeasibilityFirst([once])
    first.told(segments[:2], segments[:2])
    (told,) = first.told(segments[2:], segments[2:])
    assert told.costs.sum() > segments[1].costs.sum()


def test_segments_of_an_episode_are_priced_as_the_episode():
    """Pieces of an episode and the whole one give the same range of costs."""
    whole, pieces = FeasibilityFirst([A_LIMIT]), FeasibilityFirst([A_LIMIT])
    group = lane_group(CountingTask(), [0])
    parts = group.rollout([proposal(0, 5.0, horizon=n) for n in (3, 2, 2)])
    pieces.told(parts, parts)
    (full,) = lane_group(CountingTask(), [0]).rollout([proposal(0, 5.0)])
    whole.told([full], [full])
    assert pieces.price == pytest.approx(whole.price)


def test_restored_prices_go_on():
    one, other = FeasibilityFirst([A_LIMIT]), FeasibilityFirst([A_LIMIT])
    segments = rolled(1.0, 8.0)
    one.told(segments, segments)
    other.restore(one.state())
    assert other.price == one.price > 1.0


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
        ("zoac", 2000, {"hidden": [16], "segment_length": 10, "segments": 2}),
    ],
)
def test_every_kind_of_tuner_keeps_a_constraint_that_costs(tuner, budget, options):
    """Free, a = 0 would be best; with the constraint the optimum is at its edge, a = -0.4."""
    result = zoac.tune(
        env=Drift, controller=act, space={"a": (-1.0, 1.0), "unused": (0.0, 1.0)},
        constraints={"left": leans_left}, tuner=tuner, budget=budget, tuner_options=options,
        lanes=4, max_episode_steps=20, quiet=True, eval_every=budget, episodes=1,
        final_episodes=4, seed=1,
    )  # fmt: skip
    assert result.record["violations"] == 0
    assert -0.8 < result.parameters["a"] <= -0.4
