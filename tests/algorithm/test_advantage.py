"""GAE against the sums as they stand in the paper, term by term."""

import numpy as np
import pytest

from zoac.algorithm.advantage import estimate
from zoac.core.segments import Proposal, Segment

GAMMA, LAM = 0.9, 0.8


def make_segment(rng, length, env_index=0, terminated=False, truncated=False, starts=False):
    return Segment(
        proposal=Proposal(np.zeros(1), env_index),
        observations=rng.normal(size=(length + 1, 2)),
        actions=np.zeros((length, 1)),
        commands=np.zeros((length, 1)),
        costs=rng.normal(size=length),
        terminated=terminated,
        truncated=truncated,
        starts_episode=starts,
    )


def brute_force(costs, values, bootstrap, gamma, lam, t):
    """sum_k (gamma lam)^k [r_k + gamma V(s_{k+1}) - V(s_k)] from state t, O(T^2) over all t."""
    following = [*values[1:], bootstrap]
    return sum(
        (gamma * lam) ** (k - t) * (costs[k] + gamma * following[k] - values[k])
        for k in range(t, len(costs))
    )


@pytest.fixture
def rng():
    return np.random.default_rng(1)


@pytest.mark.parametrize("lam", [0.0, LAM, 1.0])
@pytest.mark.parametrize("end", ["terminated", "truncated", "cut"])
def test_targets_and_advantages_match_the_sums(rng, lam, end):
    first = make_segment(rng, 4, starts=True)
    last = make_segment(rng, 3, terminated=end == "terminated", truncated=end == "truncated")
    v1, v2 = rng.normal(size=5), rng.normal(size=4)
    v2[0] = v1[-1]  # the same state
    advantages, targets = estimate([first, last], [v1, v2], GAMMA, lam)
    bootstrap = 0.0 if end == "terminated" else v2[-1]
    costs = [*first.costs, *last.costs]
    values = [*v1[:-1], *v2[:-1]]
    expected = [values[t] + brute_force(costs, values, bootstrap, GAMMA, lam, t) for t in range(7)]
    np.testing.assert_allclose(np.concatenate(targets), expected)
    expected = [
        brute_force(first.costs, v1[:-1], v1[-1], GAMMA, lam, 0),
        brute_force(last.costs, v2[:-1], bootstrap, GAMMA, lam, 0),
    ]
    np.testing.assert_allclose(advantages, expected)


def test_episodes_and_environments_do_not_leak_into_each_other(rng):
    plan = [
        make_segment(rng, 3, env_index=0, starts=True),
        make_segment(rng, 3, env_index=1, starts=True),
        make_segment(rng, 2, env_index=0, terminated=True),
        make_segment(rng, 3, env_index=1),
        make_segment(rng, 3, env_index=0, starts=True),
    ]
    values = [rng.normal(size=s.length + 1) for s in plan]
    _, together = estimate(plan, values, GAMMA, LAM)
    for piece in ([0, 2], [1, 3], [4]):
        _, alone = estimate([plan[i] for i in piece], [values[i] for i in piece], GAMMA, LAM)
        for i, targets in zip(piece, alone, strict=True):
            np.testing.assert_array_equal(targets, together[i])
