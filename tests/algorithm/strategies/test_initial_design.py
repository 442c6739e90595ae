"""Terms on which any tuner can be run."""

from dataclasses import replace

import numpy as np
import pytest

from tests.baselines.support import tuner_config
from tests.support import CountingTask, engine
from zoac.algorithm.strategies.initial_design import CommonRandomNumbers, InitialDesign
from zoac.config import factory
from zoac.config.settings import Settings
from zoac.core.errors import ConfigError
from zoac.core.tuner import Problem

OPTIONS = {"_target_": "zoac.baselines.es.EvolutionStrategy", "population": 4, "sigma": 0.1,
           "step_size": 0.05, "start": "random",
           "recommendation": "mean", "reevaluate_top": 1, "reevaluate_fraction": 0.1}  # fmt: skip


def make(node=OPTIONS, **settings):
    settings = Settings(budget=500, num_envs=4, **settings)
    return factory.build_tuner(node, CountingTask(), settings)


def drive(tuner, group, rounds):
    for _ in range(rounds):
        tuner.tell(group.rollout(tuner.ask()))
    return tuner


def test_the_best_of_the_random_points_is_where_the_tuner_starts():
    tuner, group = make(initial_samples=6), engine(CountingTask(), [0, 1, 2, 3])
    first = group.rollout(tuner.ask())
    assert np.array_equal(tuner.recommend(), np.zeros(2))
    tuner.tell(first)
    second = group.rollout(tuner.ask())
    tuner.tell(second)
    assert (len(first), len(second)) == (4, 2)
    points = [*first, *second]
    assert len({segment.observations[0, 2] for segment in points}) == 1  # one and the same episode
    best = min(points, key=lambda s: s.costs.sum()).proposal.x
    np.testing.assert_array_equal(tuner.recommend(), best)
    assert tuner.describe()["start"] == "best of 6 random points"


def test_what_sampling_cost_is_taken_from_the_tuners_budget():
    given = []
    problem = Problem(CountingTask.space, 3, 4, 500, 7, 0)

    def begin(left):
        given.append(left)
        return factory.build_tuner(OPTIONS, CountingTask(), Settings(budget=1, num_envs=4))

    drive(InitialDesign(problem, begin, count=6), engine(CountingTask(), [0, 1, 2, 3]), 2)
    assert given[-1].budget == 500 - 6 * 7


def test_common_episodes_are_common_to_a_batch_and_to_no_other():
    tuner, group = make(common_random_numbers=True), engine(CountingTask(), [0, 1, 2, 3])
    numbers = []
    for _ in range(3):
        segments = group.rollout(tuner.ask())
        tuner.tell(segments)
        numbers.append({segment.observations[0, 2] for segment in segments})
    assert [len(batch) for batch in numbers] == [1, 1, 1]
    assert len(set.union(*numbers)) == 3


def test_segments_and_seeded_episodes_are_left_alone():
    inner = make(tuner_config("zoac"))
    problem = Problem(CountingTask.space, 3, 4, 500, 7, 0)
    assert all(p.seed is None for p in CommonRandomNumbers(problem, lambda _: inner).ask())


@pytest.mark.parametrize("tuner", ["zoac", "zoac_plus", "bo", "cmaes", "cmaes_full", "nevergrad"])
def test_every_tuner_with_a_start_can_be_sampled_for(tuner):
    made = make(tuner_config(tuner), initial_samples=4, common_random_numbers=True)
    drive(made, engine(CountingTask(), [0, 1, 2, 3]), 3)
    assert made.describe()["start"] == "best of 4 random points"


def test_a_tuner_without_a_start_and_a_start_from_initial_sigma_are_refused():
    for tuner, settings in (("random", {}), ("zoac", {"initial_sigma": 0.1})):
        with pytest.raises(ConfigError, match="initial_samples=4: it looks for a start"):
            make(tuner_config(tuner), initial_samples=4, **settings)


@pytest.mark.parametrize("bad", ["violates", np.nan, -np.inf])
def test_a_point_that_violates_or_costs_no_number_is_where_nothing_starts(bad):
    tuner, group = make(initial_samples=4), engine(CountingTask(), [0, 1, 2, 3])
    segments = group.rollout(tuner.ask())
    cost, violation = (-100.0, 1.0) if bad == "violates" else (bad, 0.0)
    spoiled = [
        replace(s, costs=np.full(s.length, cost), violation=violation) for s in segments[:-1]
    ]
    tuner.tell([*spoiled, segments[-1]])
    np.testing.assert_array_equal(tuner.recommend(), segments[-1].proposal.x)


def test_points_that_all_fail_log_nothing_that_is_not_finite():
    tuner, group = make(initial_samples=4), engine(CountingTask(), [0, 1, 2, 3])
    segments = group.rollout(tuner.ask())
    assert tuner.tell([s.with_costs(np.full(s.length, np.nan)) for s in segments]) == {}
    assert tuner.ask()
