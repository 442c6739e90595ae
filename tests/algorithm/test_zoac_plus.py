import dataclasses
from dataclasses import replace

import numpy as np
import pytest

from tests.algorithm.support import grouped
from tests.algorithm.test_zoac import OPTIONS, iterate
from tests.support import CountingTask, engine
from zoac.algorithm.advantage import estimate
from zoac.algorithm.gradient import zeroth_order_gradient
from zoac.algorithm.zoac_plus import ZoacPlus
from zoac.core.tuner import Problem
from zoac.strategies.held_out import HeldOut

PLUS = {
    **OPTIONS,
    "last": None,
    "slope": 0.0,
    "halving_fraction": 0.0,
    "selection_fraction": 0.0,
}


def make_plus(seed=0, num_envs=4, budget=10_000, supports_snapshots=True, baseline=None, **options):
    problem = Problem(
        CountingTask.space,
        3,
        num_envs,
        budget,
        7,
        seed,
        supports_snapshots=supports_snapshots,
        baseline=baseline,
    )
    return ZoacPlus(problem, **grouped(**{**PLUS, **options}))


def test_a_direction_is_run_both_ways_from_the_same_state():
    tuner, group = make_plus(), engine(CountingTask(max_episode_steps=100), [0, 1, 2, 3])
    proposals = tuner.ask()
    segments = group.rollout(proposals)
    assert len(proposals) == 2 * 4 * 2
    for plus, minus in zip(proposals[0::2], proposals[1::2], strict=True):
        np.testing.assert_allclose((plus.x + minus.x) / 2, tuner._theta)
        assert (plus.env_index, plus.restore, minus.restore) == (minus.env_index, True, False)
    for plus, minus in zip(segments[0::2], segments[1::2], strict=True):
        assert np.array_equal(plus.observations[0], minus.observations[0])


def test_both_segments_count_as_steps():
    tuner, group = make_plus(), engine(CountingTask(max_episode_steps=100), [0, 1, 2, 3])
    assert sum(s.length for s in group.rollout(tuner.ask())) == 4 * 2 * 2 * 3


def test_the_environments_next_segment_follows_the_restored_segment_that_stayed():
    tuner, group = make_plus(), engine(CountingTask(max_episode_steps=100), [0, 1, 2, 3])
    proposals = tuner.ask()
    first = [s for s in group.rollout(proposals) if s.proposal.env_index == 0]
    assert np.array_equal(first[2].observations[0], first[1].observations[-1])


def test_targets_of_a_restored_segment_do_not_run_on_into_its_twin():
    tuner, group = make_plus(), engine(CountingTask(max_episode_steps=100), [0, 1, 2, 3])
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


def test_goes_down_the_cost():
    tuner, group = make_plus(num_envs=10), engine(CountingTask(), list(range(10)))
    iterate(tuner, group, 150)
    assert CountingTask.space.denormalise(tuner.recommend())["a"] < 0.2


def spent_by(tuner, group, until):
    """Run until `until(tuner)`; return the segments of every batch."""
    batches = []
    while not until(tuner):
        segments = group.rollout(tuner.ask())
        tuner.tell(segments)
        batches.append(segments)
    return batches


def halving_over(tuner):
    return tuner._halving.over


def test_the_horizon_of_halving_grows_to_a_whole_episode():
    tuner, group = (
        make_plus(halving_fraction=0.3, halving_rounds=5),
        engine(CountingTask(), range(4)),
    )
    batches = spent_by(tuner, group, halving_over)
    horizons = [batch[0].proposal.horizon for batch in batches]
    assert horizons == sorted(horizons)
    assert (horizons[0], horizons[-2:]) == (1, [7, 7])


def test_halving_takes_its_fraction_of_the_budget():
    tuner, group = (
        make_plus(halving_fraction=0.3, halving_rounds=5),
        engine(CountingTask(), range(4)),
    )
    batches = spent_by(tuner, group, halving_over)
    steps = sum(segment.length for batch in batches for segment in batch)
    assert steps == pytest.approx(3000, rel=0.05)


def test_every_vector_of_a_round_meets_the_same_starts():
    tuner, group = make_plus(halving_fraction=0.3), engine(CountingTask(), range(4))
    for batch in spent_by(tuner, group, halving_over):
        field = len({tuple(segment.proposal.x) for segment in batch})
        starts = {tuple(segment.observations[0]) for segment in batch}
        assert len(starts) == len(batch) // field


def test_tuning_starts_at_the_winner_of_the_last_round():
    tuner, group = make_plus(halving_fraction=0.3), engine(CountingTask(), range(4))
    last = spent_by(tuner, group, halving_over)[-1]
    costs = {}
    for segment in last:
        costs.setdefault(tuple(segment.proposal.x), []).append(segment.costs.sum())
    assert len(next(iter(costs.values()))) > 1
    best = min(costs, key=lambda x: np.mean(costs[x]))
    assert tuple(tuner._theta) == tuple(tuner.recommend()) == best


@pytest.mark.parametrize(("cost", "violation"), [(np.nan, 0.0), (-np.inf, 0.0), (-100.0, 1.0)])
def test_a_vector_that_violates_or_costs_no_number_does_not_win(cost, violation):
    tuner, group = make_plus(halving_fraction=0.3), engine(CountingTask(), range(4))
    segments = group.rollout(tuner.ask())
    bad = [replace(s, costs=np.full(s.length, cost), violation=violation) for s in segments[:-1]]
    tuner.tell([*bad, segments[-1]])
    assert np.array_equal(tuner.recommend(), segments[-1].proposal.x)


def test_survivors_go_on_and_children_stay_in_the_box():
    tuner = make_plus(halving_fraction=0.3, halving_survivors=0.25)
    group = engine(CountingTask(), range(4))
    first, second = (group.rollout(tuner.ask()), None)
    tuner.tell(first)
    order = np.argsort([s.costs.sum() for s in first], kind="stable")
    second = np.stack([p.x for p in tuner.ask()])
    kept = -(-len(second) // 4)
    assert np.array_equal(second[:kept], np.stack([first[i].proposal.x for i in order[:kept]]))
    known = {tuple(s.proposal.x) for s in first}
    assert not any(tuple(x) in known for x in second[kept:])
    assert np.abs(second).max() <= 1.0


def test_winner_and_averages_meet_in_the_final_selection_on_common_episodes():
    tuner = make_plus(halving_fraction=0.2, selection_fraction=0.3)
    group = engine(CountingTask(), range(4))
    spent_by(tuner, group, lambda t: t._in_selection)
    batch = group.rollout(tuner.ask())
    assert len(batch) == 4  # the best of successive halving and three averages
    assert len({tuple(segment.observations[0]) for segment in batch}) == 1
    assert np.array_equal(batch[-1].proposal.x, tuner._average)
    assert not np.array_equal(tuner._average, tuner._theta)


def test_the_final_selection_recommend_the_lowest_mean_cost():
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


def test_the_baseline_meets_them_there_and_may_win():
    baseline = np.array([-1.0, 0.3])
    tuner = make_plus(halving_fraction=0.2, selection_fraction=0.3, baseline=baseline)
    group = engine(CountingTask(), range(4))
    spent_by(tuner, group, lambda t: t._in_selection)
    batch = group.rollout(tuner.ask())
    assert len(batch) == 5
    assert np.array_equal(batch[-1].proposal.x, baseline)
    tuner.tell([*(s.with_costs(s.costs + 1.0) for s in batch[:-1]), batch[-1]])
    assert np.array_equal(tuner.recommend(), baseline)
    assert "and the baseline values" in tuner.describe()["recommendation"]


@pytest.mark.parametrize("budget", [200, 230, 260])
def test_an_iteration_that_would_leave_no_final_selection_is_not_begun(budget):
    """A tenth of so small a budget is less than an iteration."""
    tuner = make_plus(selection_fraction=0.1, budget=budget)
    group, steps = engine(CountingTask(), range(4)), 0
    while steps < budget:
        segments = group.rollout(tuner.ask())
        tuner.tell(segments)
        steps += sum(s.length for s in segments)
    assert tuner._selection.begun


def test_plain_costs_and_constraints_decide_the_final_selection():
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


def test_held_out_episodes_are_not_those_of_the_search():
    tuner = make_plus(halving_fraction=0.2, selection_fraction=0.3)
    group = engine(CountingTask(), range(4))
    search = {p.proposal.seed for b in spent_by(tuner, group, lambda t: t._in_selection) for p in b}
    assert not search & {p.seed for p in tuner.ask()}


def test_where_environments_cannot_be_restored_nothing_is_restored_or_seeded():
    tuner = make_plus(halving_fraction=0.2, selection_fraction=0.3, supports_snapshots=False)
    group = engine(CountingTask(), range(4))
    batches = spent_by(tuner, group, lambda t: t._in_selection)
    proposals = [s.proposal for batch in batches for s in batch] + tuner.ask()
    assert not any(p.restore or p.seed is not None for p in proposals)
    assert {p.horizon for p in proposals} == {None, 3}


@pytest.mark.parametrize("after", [1, 3, 8, 20])
def test_a_restored_tuner_goes_on_to_the_same_bits(after):
    options = {"halving_fraction": 0.3, "selection_fraction": 0.3, "budget": 1000}
    tuner, twin = make_plus(**options), make_plus(**options)
    group = engine(CountingTask(), [0, 1, 2, 3])
    iterate(tuner, group, after)
    twin.restore(tuner.state())
    twin_group = engine(CountingTask(), [0, 1, 2, 3])
    twin_group.restore(group.state())
    iterate(tuner, group, 3)
    iterate(twin, twin_group, 3)
    assert np.array_equal(tuner.recommend(), twin.recommend())


def ended(segments, count):
    """The first `count` of segments terminated, the others not."""
    return [dataclasses.replace(s, terminated=i < count) for i, s in enumerate(segments)]


def test_perturbation_and_step_shrink_with_terminations_and_come_back():
    tuner = make_plus(sigma=0.1, step_size=0.03, max_termination_rate=0.25)
    group = engine(CountingTask(max_episode_steps=100), [0, 1, 2, 3])

    def sigma(terminated):
        segments = group.rollout(tuner.ask())
        assert len(segments) == 16
        tuner.tell(ended(segments, terminated))
        assert tuner.step_size / 0.03 == pytest.approx(tuner._shrinkage)
        tuner.ask()
        return tuner._sigma

    assert sigma(4) == pytest.approx(0.1)
    assert sigma(5) == pytest.approx(0.05)
    assert sigma(16) == pytest.approx(0.025)
    twin = make_plus(sigma=0.1, max_termination_rate=0.25)
    twin.restore(tuner.state())
    twin.ask()
    assert twin._sigma == pytest.approx(0.025)
    assert sigma(0) == pytest.approx(0.025 * 1.05)
    for _ in range(40):
        last = sigma(0)
    assert last == pytest.approx(0.1)


def test_terminations_are_tolerated_unless_told_otherwise():
    tuner, group = make_plus(), engine(CountingTask(max_episode_steps=100), [0, 1, 2, 3])
    tuner.tell(ended(group.rollout(tuner.ask()), 16))
    tuner.ask()
    assert tuner._sigma == pytest.approx(0.1)


@pytest.mark.parametrize("budget", [866, 944])
def test_a_baseline_that_enters_does_not_undo_the_decision_to_select(budget):
    """Three episodes of three candidates take fewer steps than the five of two just decided on."""
    tuner = make_plus(
        num_envs=10,
        budget=budget,
        baseline=np.array([0.3, -0.2]),
        selection_fraction=1e-3,
        selection_candidates=2,
    )
    group, spent = engine(CountingTask(), list(range(10))), 0
    while spent < budget:
        segments = group.rollout(tuner.ask())
        spent += sum(segment.length for segment in segments)
        tuner.tell(segments)
    assert len(tuner._selection.costs) >= 1
