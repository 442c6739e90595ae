"""Successive halving around a tuner that only says where it began."""

from dataclasses import replace

import numpy as np
import pytest

from tests.support import CountingTask, engine
from zoac.algorithm.strategies.successive_halving import SuccessiveHalving
from zoac.core.errors import ConfigError
from zoac.core.tuner import Problem, Tuner


class Begun(Tuner):
    """Recommends where it was begun and knows the budget that it was given."""

    def __init__(self, problem):
        self.problem = problem

    def ask(self):
        return []

    def tell(self, segments):
        return {}

    def recommend(self):
        return self.problem.start

    def state(self):
        return {}

    def restore(self, state):
        pass


def make(supports_snapshots=True, values=None, begin=Begun, shortest=0, **options):
    problem = Problem(CountingTask.space, 3, 4, 10_000, 7, 0, start=values,
                      supports_snapshots=supports_snapshots, shortest_horizon=shortest)  # fmt: skip
    return SuccessiveHalving(problem, begin, **{"fraction": 0.3, "rounds": 5, **options})


def run(tuner):
    """Return the segments of every round."""
    environments, rounds = engine(CountingTask(), range(4)), []
    while proposals := tuner.ask():
        rounds.append(environments.rollout(proposals))
        tuner.tell(rounds[-1])
    return rounds


def test_the_horizon_grows_to_a_whole_episode():
    horizons = [segments[0].proposal.horizon for segments in run(make())]
    assert horizons == sorted(horizons)
    assert (horizons[0], horizons[-2:]) == (1, [7, 7])


@pytest.mark.parametrize(("shortest", "first"), [(3, 3), (7, 7), (50, 7)])
def test_no_round_is_shorter_than_what_the_problem_says_is_informative(shortest, first):
    horizons = [segments[0].proposal.horizon for segments in run(make(shortest=shortest))]
    assert horizons == sorted(horizons)
    assert (horizons[0], horizons[-1]) == (first, 7)


def test_it_takes_its_fraction_of_the_budget_and_the_tuner_has_the_rest():
    given = []

    def begin(problem):
        given.append(problem.budget)
        return Begun(problem)

    steps = sum(s.length for segments in run(make(begin=begin)) for s in segments)
    assert steps == pytest.approx(3000, rel=0.05)
    assert given[-1] == 10_000 - steps


def test_every_vector_of_a_round_meets_the_same_starts():
    for segments in run(make()):
        starts, vectors = {}, {}
        for s in segments:
            starts.setdefault(s.proposal.seed, set()).add(tuple(s.observations[0]))
            vectors.setdefault(s.proposal.seed, []).append(tuple(s.proposal.x))
        assert all(len(seen) == 1 for seen in starts.values())
        assert len({tuple(sorted(seen)) for seen in vectors.values()}) == 1


def test_the_tuner_begins_at_the_winner_of_the_last_round():
    tuner = make()
    costs = {}
    for segment in run(tuner)[-1]:
        costs.setdefault(tuple(segment.proposal.x), []).append(segment.costs.sum())
    assert len(next(iter(costs.values()))) > 1
    assert tuple(tuner.recommend()) == min(costs, key=lambda x: np.mean(costs[x]))


@pytest.mark.parametrize(("cost", "violation"), [(np.nan, 0.0), (-np.inf, 0.0), (-100.0, 1.0)])
def test_a_vector_that_violates_or_costs_no_number_does_not_win(cost, violation):
    tuner = make()
    segments = engine(CountingTask(), range(4)).rollout(tuner.ask())
    bad = [replace(s, costs=np.full(s.length, cost), violation=violation) for s in segments[:-1]]
    tuner.tell([*bad, segments[-1]])
    assert np.array_equal(tuner.recommend(), segments[-1].proposal.x)


def test_survivors_go_on_and_offspring_stays_in_the_box():
    tuner = make(survivors=0.25)
    first = engine(CountingTask(), range(4)).rollout(tuner.ask())
    tuner.tell(first)
    order = np.argsort([s.costs.sum() for s in first], kind="stable")
    second = np.stack([p.x for p in tuner.ask()])
    kept = -(-len(second) // 4)
    assert np.array_equal(second[:kept], np.stack([first[i].proposal.x for i in order[:kept]]))
    known = {tuple(s.proposal.x) for s in first}
    assert not any(tuple(x) in known for x in second[kept:])
    assert np.abs(second).max() <= 1.0


def test_the_baseline_takes_part_if_it_is_told_to():
    baseline = np.array([0.25, -0.5])
    for start, there in (("baseline", True), ("random", False)):
        points = [p.x for p in make(values=baseline, start=start).ask()]
        assert any(np.array_equal(x, baseline) for x in points) == there
    with pytest.raises(ConfigError, match="start=baseline needs baseline values"):
        make(start="baseline")


def test_where_environments_cannot_be_restored_every_round_runs_whole_episodes_of_their_own():
    proposals = [s.proposal for segments in run(make(supports_snapshots=False)) for s in segments]
    assert {(p.horizon, p.seed, p.restore) for p in proposals} == {(None, None, False)}


@pytest.mark.parametrize("rounds", [1, 2, 6])
@pytest.mark.parametrize("episodes", [14, 30, 100, 301])
def test_where_environments_cannot_be_restored_whole_rounds_keep_to_the_fraction(episodes, rounds):
    problem = Problem(CountingTask.space, 3, 4, 7 * episodes, 7, 0, supports_snapshots=False)
    spent = sum(map(len, run(SuccessiveHalving(problem, Begun, fraction=0.3, rounds=rounds))))
    assert 0.3 * episodes - 6 <= spent <= 0.3 * episodes
