"""The answer under hard specs keeps them in episodes that the search did not see."""

import numpy as np

from zoac.algorithm.strategies.held_specs import MIN_EPISODES, NEIGHBOURS, HeldSpecs
from zoac.baselines.random_search import RandomSearch
from zoac.core.parameters import Parameter, ParameterSpace
from zoac.core.segments import Segment
from zoac.core.tuner import Problem

STEPS = 10
ROUNDS = 100 // (1 + len(NEIGHBOURS))
"""Held-out episodes that a quarter of 400 pays for, if all candidates stay."""


def problem(budget, baseline=None):
    space = ParameterSpace([Parameter("a", -1.0, 1.0), Parameter("b", -1.0, 1.0)])
    start = None if baseline is None else np.array(baseline)
    return Problem(space, 1, 4, budget, STEPS, 0, start=start, baseline=start)


def answer(episodes, noise, baseline=None):
    """Tune by random points: the cost falls with a, which must stay below 0.3 plus noise."""
    whole = problem(episodes * STEPS, baseline)
    tuner = HeldSpecs(whole, lambda left: RandomSearch(left, recommendation="best_seen"))
    rng = np.random.default_rng(0)
    while proposals := tuner.ask():
        segments = []
        for p in proposals:
            excess = max(0.0, p.x[0] - 0.3 + noise * rng.normal())
            costs = np.full(STEPS, (2.0 - p.x[0]) / STEPS)
            violation = 1.0 + excess / (1.0 + excess) if excess else 0.0
            rows = np.zeros((STEPS + 1, 1))
            segments.append(Segment(p, rows, rows[1:], rows[1:], costs, False, True, True,
                                    violation=violation))  # fmt: skip
        tuner.tell(segments)
    return tuner, tuner.recommend()


def test_with_noise_the_answer_keeps_away_from_the_limit():
    _, x = answer(400, noise=0.1)
    assert -0.5 < x[0] < 0.1  # three standard deviations at least


def test_without_noise_the_answer_is_near_the_limit():
    _, x = answer(400, noise=0.0)
    assert 0.1 < x[0] <= 0.3


def test_a_baseline_that_alone_keeps_the_specs_is_the_answer():
    _, x = answer(8, noise=0.0, baseline=[-0.9, 0.0])
    tuner, again = answer(8, noise=0.0, baseline=[-0.9, 0.0])
    assert np.array_equal(x, again)
    assert x[0] <= 0.3
    assert tuner.outcome()["held_specs"]["episodes"] >= 1


def test_a_candidate_that_broke_a_spec_drops_out_and_the_others_get_its_episodes():
    tuner, x = answer(400, noise=0.1)
    held = tuner._episodes
    assert (held.violations == 0).all()
    assert 1 < len(held.candidates) <= len(NEIGHBOURS)
    assert len(held.costs) > ROUNDS
    assert any(np.array_equal(x, candidate) for candidate in held.candidates)


def test_none_drops_out_by_the_luck_of_a_few_episodes():
    """With so much noise every candidate breaks the spec in half of its episodes."""
    tuner, _ = answer(400, noise=100.0)
    assert len(tuner._episodes.candidates) == 1 + len(NEIGHBOURS)
    assert len(tuner._episodes.costs) == ROUNDS


def test_the_last_candidate_takes_no_more_episodes():
    tuner, _ = answer(800, noise=0.5)
    held = tuner._episodes
    assert len(held.candidates) == 1
    assert len(held.costs) >= MIN_EPISODES
    assert tuner._left >= STEPS
