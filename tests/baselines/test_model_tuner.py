"""Tuners whose library is given the whole history: what it is given, and that nothing else is kept.

The library here is a stand-in. Those that are installed run in `test_contract.py` too.
"""

import sys
from dataclasses import replace

import numpy as np
import pytest

from tests.baselines.support import NUM_ENVS, STEPS, drive, engine, problem, spoiled
from tests.baselines.test_discrete import Mixed
from zoac.baselines.extras.model_tuner import ModelTuner, normal_scores
from zoac.core.errors import ConfigError
from zoac.core.state import decode, encode
from zoac.rollout.engine import RolloutEngine

BATCH = NUM_ENVS * STEPS
LIBRARIES = ["botorch", "optuna", "smac"]


class Recorded(ModelTuner):
    """Asks for random points, one less than it should, and keeps what it was given."""

    display_name = "Recorded"
    library = "none"

    def _suggest(self, points, costs, count, seed):
        self.given = points, costs, count, seed
        return np.random.default_rng(seed).uniform(-1.0, 1.0, (count - 1, points.shape[1]))


def test_the_first_points_are_the_start_and_random_ones():
    tuner = Recorded(problem(), initial_design=6)
    asked = drive(tuner, engine(), 2 * BATCH)
    assert np.array_equal(asked[0], tuner._first)
    assert not hasattr(tuner, "given")
    tuner.ask()
    assert np.array_equal(tuner.given[0], asked)


def test_points_that_the_library_does_not_name_are_random():
    tuner, group = Recorded(problem(), initial_design=1), engine()
    drive(tuner, group, BATCH)
    points = np.stack([p.x for p in tuner.ask()])
    assert len(points) == NUM_ENVS == len(np.unique(points, axis=0))
    assert np.array_equal(points[:-1], tuner._suggest(*tuner.given))


def test_costs_are_told_as_normal_scores_and_a_violation_is_the_worst_of_them():
    tuner, group = Recorded(problem(), initial_design=1), engine()
    costs = [3.0, 1.0, 1e9, 0.0, 2.0]
    segments = [spoiled(s, c) for s, c in zip(group.rollout(tuner.ask()), costs, strict=True)]
    tuner.tell([*segments[:3], replace(segments[3], violation=0.1), segments[4]])
    tuner.ask()
    assert np.allclose(tuner.given[1], normal_scores(np.array([3.0, 1.0, 4.0, 5.0, 2.0])))


def test_the_library_is_given_the_cheapest_and_the_latest_of_many_observations():
    tuner, group = Recorded(problem(episodes=500), initial_design=1, max_observations=10), engine()
    asked = drive(tuner, group, 20 * BATCH)
    tuner.ask()
    points, costs = tuner.given[:2]
    assert len(points) == len(costs) == 10
    assert np.array_equal(points[-5:], asked[-5:])
    best = tuner.recommend()
    assert any(np.array_equal(point, best) for point in points)


def test_whole_numbers_and_choices_are_asked_for_and_told_as_the_points_that_stand_for_them():
    mixed = problem(space=Mixed.space, start=np.zeros(Mixed.space.dimension))
    tuner = Recorded(mixed, initial_design=1)
    asked = drive(tuner, RolloutEngine(Mixed(), range(NUM_ENVS), range(NUM_ENVS)), 3 * BATCH)
    tuner.ask()
    assert np.array_equal(asked[0], tuner._first)
    assert np.array_equal(asked[1:], Mixed.space.rounded(np.array(asked[1:])))
    assert np.array_equal(tuner.given[0], Mixed.space.rounded(np.array(asked)))


def test_each_batch_has_a_seed_of_its_own_and_a_restored_tuner_the_same_ones():
    tuner, group = Recorded(problem(), initial_design=1), engine()
    drive(tuner, group, 2 * BATCH)
    first = tuner.given[-1]
    encoded = encode((tuner.state(), group.state()))
    assert not encoded.objects
    drive(tuner, group, BATCH)
    assert tuner.given[-1] != first
    twin, twin_group = Recorded(problem(), initial_design=1), engine()
    state, env_states = decode(encoded)
    twin.restore(state)
    twin_group.restore(env_states)
    drive(twin, twin_group, BATCH)
    for mine, other in zip(tuner.given, twin.given, strict=True):
        assert np.array_equal(mine, other)


def test_a_state_between_ask_and_tell_holds_the_points_asked_for():
    tuner, group = Recorded(problem(), initial_design=1), engine()
    segments = group.rollout(tuner.ask())
    twin = Recorded(problem(), initial_design=1)
    twin.restore(decode(encode(tuner.state())))
    for one in (tuner, twin):
        one.tell(segments)
        one.ask()
    assert np.array_equal(tuner.given[0], twin.given[0])


@pytest.mark.parametrize("name", LIBRARIES)
def test_a_missing_library_is_named_with_its_extra(name, monkeypatch):
    monkeypatch.setitem(sys.modules, name, None)
    monkeypatch.delitem(sys.modules, f"zoac.baselines.extras.{name}", raising=False)
    with pytest.raises(ConfigError, match=rf"pip install 'zoac\[{name}\]'"):
        __import__(f"zoac.baselines.extras.{name}")
