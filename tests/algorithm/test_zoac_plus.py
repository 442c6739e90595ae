import numpy as np
import pytest

from tests.algorithm.test_zoac import OPTIONS, iterate
from tests.support import CountingTask, lane_group
from zoac.algorithm.advantage import estimate
from zoac.algorithm.gradient import zeroth_order_gradient
from zoac.algorithm.zoac_plus import ZoacPlus
from zoac.tuner import Problem


def make_plus(seed=0, lanes=4, **options):
    problem = Problem(CountingTask.space, 3, lanes, 1000, 7, seed)
    return ZoacPlus(problem, **{**OPTIONS, "candidates": 0, **options})


def test_a_direction_is_run_both_ways_from_the_same_state():
    tuner, group = make_plus(), lane_group(CountingTask(max_episode_steps=100), [0, 1, 2, 3])
    proposals = tuner.ask()
    segments = group.rollout(proposals)
    assert len(proposals) == 2 * 4 * 2
    for plus, minus in zip(proposals[0::2], proposals[1::2], strict=True):
        np.testing.assert_allclose((plus.z + minus.z) / 2, tuner._theta)
        assert (plus.lane, plus.branch, minus.branch) == (minus.lane, True, False)
    for plus, minus in zip(segments[0::2], segments[1::2], strict=True):
        assert np.array_equal(plus.observations[0], minus.observations[0])


def test_both_branches_count_as_steps():
    tuner, group = make_plus(), lane_group(CountingTask(max_episode_steps=100), [0, 1, 2, 3])
    assert sum(s.length for s in group.rollout(tuner.ask())) == 4 * 2 * 2 * 3


def test_the_lanes_next_segment_follows_the_branch_that_stayed():
    tuner, group = make_plus(), lane_group(CountingTask(max_episode_steps=100), [0, 1, 2, 3])
    proposals = tuner.ask()
    lane_0 = [s for s in group.rollout(proposals) if s.proposal.lane == 0]
    assert np.array_equal(lane_0[2].observations[0], lane_0[1].observations[-1])


def test_targets_of_a_branch_do_not_run_on_into_its_twin():
    tuner, group = make_plus(), lane_group(CountingTask(max_episode_steps=100), [0, 1, 2, 3])
    segments = group.rollout(tuner.ask())
    values = [np.zeros(s.length + 1) for s in segments]
    _, targets = estimate(segments, values, 1.0, 1.0)
    # Undiscounted costs to go: a branch ends with itself, the others with the iteration.
    np.testing.assert_allclose(targets[0][0], segments[0].costs.sum())
    stayed = [s for s in segments if s.proposal.lane == 0 and not s.proposal.branch]
    np.testing.assert_allclose(targets[1][0], sum(s.costs.sum() for s in stayed))


def test_the_paired_estimate_has_the_mean_of_the_unpaired_one_and_less_variance():
    """f(z) = |z - c|^2 plus noise that the two branches share; the gradient is 2 (theta - c)."""
    rng = np.random.default_rng(0)
    theta, centre, sigma, n = np.array([0.3, -0.2]), np.array([0.0, 0.1]), 0.1, 200_000

    def cost(z, noise):
        return ((z - centre) ** 2).sum(axis=1) + noise

    epsilon, noise = rng.standard_normal((n, 2)), rng.normal(0, 1, n)
    plus, minus = cost(theta + sigma * epsilon, noise), cost(theta - sigma * epsilon, noise)
    exact = 2 * (theta - centre)
    paired = zeroth_order_gradient((plus - minus) / 2, epsilon, sigma)
    np.testing.assert_allclose(paired, exact, atol=0.01)
    spread_paired = ((plus - minus)[:, None] / 2 * epsilon / sigma).std(axis=0)
    spread_single = (plus[:, None] * epsilon / sigma).std(axis=0)
    assert (spread_single > 9 * spread_paired).all()


def test_goes_down_the_cost():
    tuner, group = make_plus(lanes=10), lane_group(CountingTask(), list(range(10)))
    iterate(tuner, group, 150)
    assert CountingTask.space.physical(tuner.recommend())["a"] < 0.2


def test_starts_at_the_best_candidate():
    tuner, group = make_plus(candidates=11), lane_group(CountingTask(), [0, 1, 2, 3])
    seen = []
    for size in (4, 4, 3):
        proposals = tuner.ask()
        assert len(proposals) == size
        assert all(p.horizon is None for p in proposals)
        segments = group.rollout(proposals)
        seen += [(s.costs.sum(), tuple(s.proposal.z)) for s in segments]
        tuner.tell(segments)
    assert tuple(tuner.recommend()) == min(seen)[1]
    assert tuner.ask()[0].horizon == 3


def test_a_candidate_whose_cost_is_not_finite_is_not_chosen():
    tuner, group = make_plus(candidates=4), lane_group(CountingTask(), [0, 1, 2, 3])
    segments = group.rollout(tuner.ask())
    bad = segments[0].with_costs(np.full(7, np.nan))
    tuner.tell([bad, *segments[1:]])
    assert not np.array_equal(tuner.recommend(), bad.proposal.z)


@pytest.mark.parametrize("after", [1, 2, 4])
def test_a_restored_tuner_goes_on_to_the_same_bits(after):
    tuner, twin = make_plus(candidates=7), make_plus(candidates=7)
    group = lane_group(CountingTask(), [0, 1, 2, 3])
    iterate(tuner, group, after)
    twin.restore(tuner.state())
    twin_group = lane_group(CountingTask(), [0, 1, 2, 3])
    twin_group.restore(group.state())
    iterate(tuner, group, 3)
    iterate(twin, twin_group, 3)
    assert np.array_equal(tuner.recommend(), twin.recommend())


def test_outliers_are_clipped_in_robust_deviations():
    tuner = make_plus(clip_advantages=3.0)
    halves = np.array([-1.0, 1.0, -0.5, 0.5, 1000.0])
    advantages = np.stack([halves, -halves], axis=1).ravel()
    weights = tuner._weights(advantages)
    assert weights[-1] == 3.0
    np.testing.assert_allclose(weights[:4], halves[:4] / 1.4826)
