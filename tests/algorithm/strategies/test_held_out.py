"""Candidates that meet the same held-out episodes."""

import dataclasses

import numpy as np

from tests.support import CountingTask, engine
from zoac.algorithm.strategies.held_out import HeldOut
from zoac.core.tuner import Problem


def test_the_lowest_mean_cost_is_the_best():
    selection = HeldOut(Problem(CountingTask.space, 3, 6, 1000, 7, 0), "finals")
    bad, good = np.array([0.1, 0.2]), np.array([0.3, 0.4])
    selection.enter(bad)
    selection.enter(good)
    lucky = engine(CountingTask(), range(6)).rollout(selection.ask(3))
    assert [tuple(s.proposal.x) for s in lucky] == [tuple(bad), tuple(good)] * 3
    assert len({s.proposal.seed for s in lucky}) == 3
    # The bad one is the cheapest once, the good one on average.
    costs = [0.0, 3.0, 9.0, 4.0, 9.0, 3.0]
    selection.tell([s.with_costs(np.array([c])) for s, c in zip(lucky, costs, strict=True)])
    assert np.array_equal(selection.best, good)


def test_plain_costs_and_constraints_decide():
    selection = HeldOut(Problem(CountingTask.space, 3, 6, 1000, 7, 0), "finals")
    for x in ([0.1, 0.2], [0.3, 0.4], [0.5, 0.6]):
        selection.enter(np.array(x))
    segments = engine(CountingTask(), range(6)).rollout(selection.ask(1))
    plain, told, violations = (1.0, 2.0, 3.0), (9.0, 9.0, 0.0), (0.5, 0.0, 0.0)
    selection.tell([
        dataclasses.replace(
            s, costs=np.array([told[k]]), reported_costs=np.array([plain[k]]),
            violation=violations[k],
        )
        for k, s in enumerate(segments)
    ])  # fmt: skip
    assert selection.ranking.tolist() == [1, 2, 0]
