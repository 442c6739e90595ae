import dataclasses

import numpy as np
import pytest

from tests.algorithm.support import grouped
from tests.algorithm.test_zoac import OPTIONS
from tests.support import CountingTask, engine
from zoac.algorithm.advantage import estimate
from zoac.algorithm.gradient import zeroth_order_gradient
from zoac.algorithm.zoac_plus import PairedZoac, ZoacPlus
from zoac.core.tuner import Problem

PLUS = {**OPTIONS, "last": None, "slope": 0.0}


def problem(num_envs=4, budget=10_000, **more):
    return Problem(CountingTask.space, 3, num_envs, budget, 7, 0, **more)


def make_paired(num_envs=4, **options):
    return PairedZoac(problem(num_envs), **grouped(**{**PLUS, **options}))


def make_plus(num_envs=4, budget=3000, supports_snapshots=True, baseline=None, **options):
    whole = problem(num_envs, budget, supports_snapshots=supports_snapshots, baseline=baseline)
    return ZoacPlus(whole, **grouped(**{**PLUS, **options}))


def test_a_direction_is_run_both_ways_from_the_same_state():
    tuner, group = make_paired(), engine(CountingTask(max_episode_steps=100), [0, 1, 2, 3])
    proposals = tuner.ask()
    segments = group.rollout(proposals)
    assert len(proposals) == 2 * 4 * 2
    for plus, minus in zip(proposals[0::2], proposals[1::2], strict=True):
        np.testing.assert_allclose((plus.x + minus.x) / 2, tuner._theta)
        assert (plus.env_index, plus.restore, minus.restore) == (minus.env_index, True, False)
    for plus, minus in zip(segments[0::2], segments[1::2], strict=True):
        assert np.array_equal(plus.observations[0], minus.observations[0])


def test_both_segments_count_as_steps():
    tuner, group = make_paired(), engine(CountingTask(max_episode_steps=100), [0, 1, 2, 3])
    assert sum(s.length for s in group.rollout(tuner.ask())) == 4 * 2 * 2 * 3


def test_the_environments_next_segment_follows_the_restored_segment_that_stayed():
    tuner, group = make_paired(), engine(CountingTask(max_episode_steps=100), [0, 1, 2, 3])
    proposals = tuner.ask()
    first = [s for s in group.rollout(proposals) if s.proposal.env_index == 0]
    assert np.array_equal(first[2].observations[0], first[1].observations[-1])


def test_targets_of_a_restored_segment_do_not_run_on_into_its_twin():
    tuner, group = make_paired(), engine(CountingTask(max_episode_steps=100), [0, 1, 2, 3])
    segments = group.rollout(tuner.ask())
    values = [np.zeros(s.length + 1) for s in segments]
    _, targets = estimate(segments, values, 1.0, 1.0)
    # Undiscounted costs to go: a branch ends with itself, the others with the iteration.
    np.testing.assert_allclose(targets[0][0], segments[0].costs.sum())
    stayed = [s for s in segments if s.proposal.env_index == 0 and not s.proposal.restore]
    np.testing.assert_allclose(targets[1][0], sum(s.costs.sum() for s in stayed))


def test_the_paired_estimate_has_the_mean_of_the_unpaired_one_and_less_variance():
    """f(z) = |z - c|^2 plus noise that the two branches share; the gradient is 2 (theta - c)."""
    rng = np.random.default_rng(0)
    theta, centre, sigma, n = np.array([0.3, -0.2]), np.array([0.0, 0.1]), 0.1, 200_000

    def cost(x, noise):
        return ((x - centre) ** 2).sum(axis=1) + noise

    epsilon, noise = rng.standard_normal((n, 2)), rng.normal(0, 1, n)
    plus, minus = cost(theta + sigma * epsilon, noise), cost(theta - sigma * epsilon, noise)
    exact = 2 * (theta - centre)
    paired = zeroth_order_gradient((plus - minus) / 2, epsilon, sigma)
    np.testing.assert_allclose(paired, exact, atol=0.01)
    spread_paired = ((plus - minus)[:, None] / 2 * epsilon / sigma).std(axis=0)
    spread_single = (plus[:, None] * epsilon / sigma).std(axis=0)
    assert (spread_single > 9 * spread_paired).all()


def ended(segments, count):
    """The first `count` of segments terminated, the others not."""
    return [dataclasses.replace(s, terminated=i < count) for i, s in enumerate(segments)]


def test_perturbation_and_step_shrink_with_terminations_and_come_back():
    tuner = make_paired(sigma=0.1, step_size=0.03, max_termination_rate=0.25)
    group = engine(CountingTask(max_episode_steps=100), [0, 1, 2, 3])

    def sigma(terminated):
        segments = group.rollout(tuner.ask())
        assert len(segments) == 16
        tuner.tell(ended(segments, terminated))
        assert tuner.step_size / 0.03 == pytest.approx(tuner._shrinkage)
        return tuner.sigma

    assert sigma(4) == pytest.approx(0.1)
    assert sigma(5) == pytest.approx(0.05)
    assert sigma(16) == pytest.approx(0.025)
    twin = make_paired(sigma=0.1, max_termination_rate=0.25)
    twin.restore(tuner.state())
    assert twin.sigma == pytest.approx(0.025)
    assert sigma(0) == pytest.approx(0.025 * 1.05)
    for _ in range(30):
        last = sigma(0)
    assert last == pytest.approx(0.1)


def test_terminations_are_tolerated_unless_told_otherwise():
    tuner, group = make_paired(), engine(CountingTask(max_episode_steps=100), [0, 1, 2, 3])
    tuner.tell(ended(group.rollout(tuner.ask()), 16))
    assert tuner.sigma == pytest.approx(0.1)


def run(tuner, budget, environments=None):
    """Return the segments of every batch until the budget is spent."""
    environments, batches = environments or engine(CountingTask(), range(4)), []
    while sum(s.length for batch in batches for s in batch) < budget:
        if not (proposals := tuner.ask()):
            break
        segments = environments.rollout(proposals)
        tuner.tell(segments)
        batches.append(segments)
    return batches


def kind(batch):
    """Which part of the tuner asked for a batch."""
    if batch[0].proposal.seed is None:
        return "pairs" if batch[0].proposal.restore else "one way"
    return "episodes"


def test_it_goes_down_the_cost():
    tuner = make_plus(num_envs=10, step_size=0.1)
    run(tuner, 3000, engine(CountingTask(), range(10)))
    assert CountingTask.space.denormalise(tuner.recommend())["a"] < 0.2


@pytest.fixture(scope="module")
def batches():
    """What a run with five rounds of halving asks for, and what comes back."""
    return run(make_plus(halving_fraction=0.3, halving_rounds=5), 3000)


def test_halving_then_pairs_then_the_final_selection_within_the_budget(batches):
    kinds = [kind(batch) for batch in batches]
    first, last = kinds.index("pairs"), len(kinds) - kinds[::-1].index("pairs")
    assert kinds == ["episodes"] * first + ["pairs"] * (last - first) + ["episodes"] * (
        len(kinds) - last
    )
    steps = [sum(s.length for s in batch) for batch in batches]
    assert first == 5
    assert sum(steps[:first]) == pytest.approx(900, rel=0.05)
    assert sum(steps[last:]) == pytest.approx(300, rel=0.1)
    assert sum(steps) <= 3000


def test_pairs_begin_where_halving_ended(batches):
    costs = {}
    for segment in batches[4]:
        costs.setdefault(tuple(segment.proposal.x), []).append(segment.costs.sum())
    best = min(costs, key=lambda x: np.mean(costs[x]))
    plus, minus = (segment.proposal.x for segment in batches[5][:2])
    np.testing.assert_allclose((plus + minus) / 2, best)


@pytest.mark.parametrize("there", [True, False])
def test_the_start_averages_and_the_baseline_meet_in_the_final_selection(there):
    baseline = np.array([-1.0, 0.3])
    tuner = make_plus(halving_fraction=0.2, baseline=baseline, selection_baseline=there)
    batches = run(tuner, 3000)
    first = next(k for k in range(len(batches) - 1, 0, -1) if kind(batches[k]) == "pairs") + 1
    pairs = next(batch for batch in batches if kind(batch) == "pairs")
    start = (pairs[0].proposal.x + pairs[1].proposal.x) / 2
    candidates = np.unique([s.proposal.x for s in batches[first]], axis=0)
    assert len(candidates) == 4 + there
    assert np.isclose(candidates, start).all(axis=1).any()
    assert np.isclose(candidates, baseline).all(axis=1).any() == there
    assert ("and the baseline values" in tuner.describe()["recommendation"]) == there
    assert "successive halving, 20%" in tuner.describe()["start"]


def test_each_part_can_be_left_out():
    alone = {"halving_fraction": 0.0, "selection_fraction": 0.0}
    assert {kind(batch) for batch in run(make_plus(**alone), 200)} == {"pairs"}
    assert {kind(batch) for batch in run(make_plus(**alone, paired=False), 200)} == {"one way"}


def test_where_environments_cannot_be_restored_segments_and_halving_are_the_environments_own():
    batches = run(make_plus(halving_fraction=0.2, supports_snapshots=False, budget=1500), 1500)
    proposals = [s.proposal for batch in batches for s in batch]
    assert not any(p.restore for p in proposals)
    assert {(p.horizon, p.seed is None) for p in proposals} == {
        (None, True), (3, True), (None, False),
    }  # fmt: skip


@pytest.mark.parametrize("budget", [60, 200, 230, 260])
def test_a_small_budget_is_kept(budget):
    """Whether or not it can pay for a final selection."""
    tuner = make_plus(halving_fraction=0.0, budget=budget)
    spent = sum(s.length for batch in run(tuner, budget) for s in batch)
    iteration = 4 * 2 * 2 * 3
    assert spent <= max(budget, iteration * -(-budget // iteration))
    assert np.isfinite(tuner.recommend()).all()
