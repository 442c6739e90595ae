from dataclasses import replace

import numpy as np
import pytest

from tests.baselines.support import STEPS, TARGET, drive, engine, problem, spoiled, true_cost
from zoac.baselines.es import EvolutionStrategy, standardised_costs
from zoac.baselines.nominal import NominalTuner
from zoac.baselines.random_search import RandomSearch
from zoac.core.errors import ConfigError
from zoac.core.seeding import stream_seed


def tell(tuner, group, costs):
    """Tell one batch of episodes that cost this much."""
    segments = group.rollout(tuner.ask())
    return tuner.tell([spoiled(s, c / STEPS) for s, c in zip(segments, costs, strict=True)])


def test_whole_episodes_are_spread_over_the_environments():
    proposals = EvolutionStrategy(problem(), population=7).ask()
    assert [p.env_index for p in proposals] == [0, 1, 2, 3, 4, 0, 1]
    assert all(p.horizon is None and p.seed is None for p in proposals)


def test_the_cheapest_single_episode_is_recommended():
    tuner, group = RandomSearch(problem()), engine()
    asked = group.rollout(tuner.ask())
    metrics = tuner.tell([spoiled(s, c) for s, c in zip(asked, (3, 2, 1, 4, 5), strict=True)])
    assert np.array_equal(tuner.recommend(), asked[2].proposal.x)
    assert metrics["best_seen"] == pytest.approx(1 * STEPS)
    assert metrics["cost_mean"] == pytest.approx(3 * STEPS)


def test_a_bad_episode_is_never_best():
    tuner, group = RandomSearch(problem()), engine()
    metrics = tell(tuner, group, [np.nan, 5.0, 2.0, -np.inf, np.inf])
    assert metrics["cost_not_finite"] == 3
    assert metrics["best_seen"] == pytest.approx(2.0)
    assert metrics["cost_mean"] == pytest.approx(3.5)


def test_where_all_violate_the_least_violation_is_recommended():
    tuner, group = RandomSearch(problem()), engine()
    segments = group.rollout(tuner.ask())
    tuner.tell([replace(s, violation=v) for s, v in zip(segments, (3, 2, 1, 4, 5), strict=True)])
    assert np.array_equal(tuner.recommend(), segments[2].proposal.x)


def test_costs_of_which_none_is_finite_move_nothing():
    tuner = EvolutionStrategy(problem(), population=5)
    before = tuner.recommend()
    assert tell(tuner, engine(), [np.nan] * 5)["gradient_norm"] == 0.0
    assert np.array_equal(tuner.recommend(), before)


def reevaluated(seed=0):
    """A random search whose last tenth of 500 episodes re-evaluates the best five."""
    return RandomSearch(problem(seed, 500), recommendation="reevaluated", reevaluate_top=5)


def test_reevaluation_spends_the_last_fraction_of_the_budget():
    tuner, group = reevaluated(), engine()
    drive(tuner, group, 450 * STEPS - 1)
    for round_ in range(10):
        proposals = tuner.ask()
        assert {p.seed for p in proposals} == {stream_seed(0, "reevaluation", round_)}
        assert len({p.x.tobytes() for p in proposals}) == 5
        metrics = tuner.tell(group.rollout(proposals))
    assert metrics["reevaluation_rounds"] == 10


def test_the_baseline_is_evaluated_with_the_best_and_may_win():
    given = problem(0, 500, baseline=TARGET)
    tuner, group = RandomSearch(given, recommendation="reevaluated", reevaluate_top=5), engine()
    drive(tuner, group, 450 * STEPS)
    assert any(np.array_equal(p.x, TARGET) for p in tuner.ask())
    drive(tuner, group, 50 * STEPS)
    assert np.array_equal(tuner.recommend(), TARGET)


@pytest.mark.parametrize("episodes", [20, 25, 33])
def test_a_batch_that_would_leave_no_round_of_reevaluation_is_not_begun(episodes):
    """A tenth of so small a budget is less than a batch of five episodes."""
    given = problem(0, episodes)
    tuner, group = RandomSearch(given, recommendation="reevaluated", reevaluate_top=3), engine()
    steps = 0
    while steps < given.budget:
        segments = group.rollout(tuner.ask())
        steps += sum(s.length for s in segments)
        metrics = tuner.tell(segments)
    assert metrics["reevaluation_rounds"] >= 1


def test_reevaluation_reports_how_lucky_the_best_had_been():
    """Random points cost alike here, so that noise alone makes the best seem good."""
    tuner, group = reevaluated(), engine()
    rng = np.random.default_rng(0)
    drive(tuner, group, 450 * STEPS, lambda i, s: spoiled(s, rng.normal() / STEPS))
    for _ in range(80):
        segments = group.rollout(tuner.ask())
        metrics = tuner.tell([spoiled(s, rng.normal() / STEPS) for s in segments])
    luck = -np.sort(np.random.default_rng(0).normal(size=450))[:5].mean()
    assert metrics["selection_bias"] == pytest.approx(luck, abs=4 / np.sqrt(80 * 5))


def test_reevaluation_recommends_the_best_mean_of_the_held_out_episodes():
    tuner, group = reevaluated(), engine()
    drive(tuner, group, 450 * STEPS)
    points = [p.x for p in tuner.ask()]
    drive(tuner, group, 50 * STEPS)
    assert np.array_equal(tuner.recommend(), min(points, key=true_cost))


def test_a_run_restored_during_reevaluation_continues_with_the_same_numbers():
    tuner, group = reevaluated(), engine()
    drive(tuner, group, 460 * STEPS)
    twin = reevaluated()
    twin.restore(tuner.state())
    proposals = tuner.ask()
    assert [p.seed for p in twin.ask()] == [p.seed for p in proposals]
    segments = group.rollout(proposals)
    assert twin.tell(segments) == tuner.tell(segments)


def test_standardised_costs_ignore_scale_and_offset():
    costs = np.arange(8.0) ** 2
    assert np.allclose(standardised_costs(costs), standardised_costs(50 * costs + 9))


def test_equal_costs_move_nothing():
    assert not standardised_costs(np.full(8, 3.0)).any()


def test_the_search_distribution_has_the_std_asked_for():
    tuner = EvolutionStrategy(problem(), population=4000, sigma=0.2, start="baseline")
    points = np.stack([p.x for p in tuner.ask()])
    assert points.std() == pytest.approx(0.2, rel=0.03)
    assert points.mean() == pytest.approx(0.0, abs=0.01)


def test_nominal_start_needs_nominal_parameters():
    with pytest.raises(ConfigError, match="tuner.start=baseline needs baseline values"):
        EvolutionStrategy(problem(start=None), start="baseline")


def test_nominal_tuner_asks_nothing_and_recommends_the_nominal_parameters():
    tuner = NominalTuner(problem(start=TARGET))
    assert tuner.ask() == []
    assert np.array_equal(tuner.recommend(), TARGET)
    with pytest.raises(ConfigError, match="tuner=nominal needs baseline values"):
        NominalTuner(problem(start=None))
