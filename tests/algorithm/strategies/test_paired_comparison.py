"""Exact tests on paired costs: what they promise, whatever the distribution of costs."""

from itertools import product
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import binom, binomtest, permutation_test

from zoac.algorithm.strategies import paired_comparison
from zoac.algorithm.strategies.paired_comparison import (
    LEVEL,
    MIN_PAIRS,
    clearly_higher,
    compare,
    sign_flip_test,
    sign_test,
    unseen_rate,
)

TRIALS = 400
MOST = binom.ppf(0.999, TRIALS, LEVEL) / TRIALS
"""Above this share of false acceptances in `TRIALS`, the level is not kept."""


def compared(differences, failed=None, fails=None, violations=None):
    """Compare a candidate with a start whose episodes all cost nothing."""
    n = len(differences)
    none = np.zeros(n, dtype=bool)
    failing = np.stack([none if failed is None else failed, none if fails is None else fails], 1)
    violating = np.zeros((n, 2)) if violations is None else np.asarray(violations, dtype=float)
    costs = np.stack([np.zeros(n), differences], axis=1)
    return compare(
        SimpleNamespace(costs=costs, failed=failing | (violating > 0), violations=violating)
    )


def accepted(draw, pairs, seed=0):
    """Return the share of trials in which a candidate with such differences is accepted.

    With fewer flips the test is as exact, and quicker.
    """
    rng = np.random.default_rng(seed)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(paired_comparison, "FLIPS", 499)
        return np.mean([compared(draw(rng, pairs)).accepted for _ in range(TRIALS)])


def contaminated(rng, n):
    """One cheaper, but a thousand dearer in one episode of 200: worse by four on average."""
    return np.where(rng.random(n) < 0.005, 1000.0, -1.0) + rng.normal(0, 0.2, n)


NULLS = {
    "normal": lambda rng, n: rng.normal(0, 1, n),
    "skewed to dear": lambda rng, n: rng.exponential(1, n) - np.log(2),
    "skewed to cheap": lambda rng, n: np.log(2) - rng.exponential(1, n),
    "heavy tails": lambda rng, n: rng.standard_cauchy(n),
    "enormous tails": lambda rng, n: np.exp(rng.normal(0, 3, n)) - 1,
    "discrete": lambda rng, n: rng.choice([-1.0, 0.0, 1.0], n),
    "discrete and skewed": lambda rng, n: rng.choice([-1.0, 0.0, 50.0], n, p=[0.2, 0.6, 0.2]),
    "no difference": lambda rng, n: np.zeros(n),
    "dear as often as cheap, and crashes": lambda rng, n: np.where(
        rng.random(n) < 0.1, 1000.0, rng.normal(-0.1, 1, n)
    ),
}
"""Differences that are above zero as often as below, or more often."""


@pytest.mark.parametrize("pairs", [5, 20])
@pytest.mark.parametrize("name", NULLS)
def test_a_candidate_that_wins_no_more_than_it_loses_passes_one_time_in_twenty(name, pairs):
    assert accepted(NULLS[name], pairs) <= MOST


@pytest.mark.parametrize("pairs", [5, 20, 50])
def test_a_failure_too_rare_to_be_seen_passes_and_the_text_says_how_rare(pairs):
    """No rule can do better; what it must do is refuse as soon as one failure is seen."""
    share = accepted(contaminated, pairs)
    assert share == pytest.approx(0.995**pairs, abs=0.13)
    text = compared(np.full(pairs, -1.0)).text
    assert f"a failure rate below {1 - 0.05 ** (1 / pairs):.2g} cannot be excluded" in text


def test_the_text_says_what_was_compared():
    assert compared(np.array([-1.0] * 4 + [1.0] * 2)).text.startswith(
        "in 6 pairs of episodes the tuned values were better in 4 and worse in 2 (p = 0.35 by "
        "exact tests); they failed in 0, the baseline values in 0"
    )


@pytest.mark.parametrize("pairs", [8, 20, 50])
def test_one_large_loss_that_was_seen_outweighs_many_small_gains(pairs):
    differences = np.full(pairs, -1.0)
    differences[0] = 1000.0
    assert not compared(differences).accepted
    assert sign_test(pairs - 1, 1) <= LEVEL  # which a test of signs alone would let pass


@pytest.mark.parametrize(
    ("shift", "pairs", "least"), [(1, 5, 0.35), (1, 20, 0.85), (2, 10, 0.95), (0.5, 50, 0.7)]
)
def test_the_power_on_normal_differences(shift, pairs, least):
    """Shift in standard deviations; measured 0.43, 0.92, 0.98, 0.84."""
    assert accepted(lambda rng, n: rng.normal(-shift, 1, n), pairs) >= least


def test_a_failure_decides_its_pair_whatever_it_costs():
    cheap_crash = compared(np.full(10, -5.0), fails=np.arange(10) == 3)
    assert (cheap_crash.wins, cheap_crash.losses) == (9, 1)
    assert not cheap_crash.accepted
    mended = compared(np.full(10, 5.0), failed=np.ones(10, dtype=bool))
    assert (mended.wins, mended.losses, mended.accepted) == (10, 0, True)


def test_new_failures_pass_only_if_it_shows_that_failures_became_fewer():
    episode = np.arange(20)
    few, many, new = episode < 4, episode < 12, episode == 19
    assert not compared(np.full(20, -1.0), failed=few, fails=new).accepted
    assert compared(np.full(20, -1.0), failed=many, fails=new).accepted


def test_of_two_that_violate_the_one_that_violates_less_wins():
    violations = np.column_stack([np.full(10, 2.0), np.full(10, 1.0)])
    assert compared(np.full(10, 5.0), violations=violations).accepted


def test_costs_that_are_not_finite_on_both_sides_decide_nothing():
    both = np.ones(10, dtype=bool)
    with np.errstate(invalid="ignore"):
        comparison = compared(np.full(10, np.inf) - np.inf, failed=both, fails=both)
    assert (comparison.wins, comparison.losses, comparison.accepted) == (0, 0, False)


def test_the_sign_test_is_the_binomial_test():
    for wins, losses in ((5, 0), (7, 3), (0, 4), (30, 20)):
        exact = binomtest(wins, wins + losses, alternative="greater").pvalue
        assert sign_test(wins, losses) == pytest.approx(exact)
    assert sign_test(0, 0) == 1.0


def test_the_sign_flip_test_is_the_fraction_of_all_assignments():
    differences = np.array([-3.0, -1.0, -2.5, 0.5, -0.7, -1.5, 1.2, -0.1])
    flips = np.array(list(product([-1, 1], repeat=8))) @ differences
    exact = np.mean(flips <= differences.sum() + 1e-9)
    assert sign_flip_test(differences) == pytest.approx(exact, abs=0.008)
    by_scipy = permutation_test(
        (differences,), np.sum, permutation_type="samples", alternative="less", n_resamples=np.inf
    )
    assert exact == pytest.approx(by_scipy.pvalue)


def test_with_fewer_pairs_nothing_can_be_shown():
    assert sign_test(MIN_PAIRS - 1, 0) > LEVEL >= sign_test(MIN_PAIRS, 0)
    assert compared(np.full(MIN_PAIRS, -1.0)).accepted


def test_the_unseen_rate_is_what_so_many_episodes_miss_once_in_twenty():
    assert (1 - unseen_rate(50)) ** 50 == pytest.approx(0.05)
    assert unseen_rate(50) == pytest.approx(0.0582, abs=1e-4)


def test_a_warning_needs_a_difference_beyond_noise():
    rng = np.random.default_rng(0)
    reference = rng.normal(10.0, 3.0, 20)
    assert not clearly_higher(reference, reference)
    assert not clearly_higher(reference + 1e-9, reference)
    assert clearly_higher(reference + 0.1, reference)  # paired: the same in every episode
    assert not clearly_higher(rng.normal(10.0, 3.0, 20), reference)
    assert clearly_higher(np.array([2.0]), np.array([1.0]))
    assert clearly_higher(np.full(3, np.nan), np.ones(3))


def test_the_best_of_many_must_be_better_by_more():
    rng = np.random.default_rng(1)
    end = np.zeros(10)
    false = 0
    for _ in range(200):
        rows = rng.normal(0.0, 1.0, (30, 10))
        false += clearly_higher(end, rows[rows.mean(axis=1).argmin()], comparisons=30)
    assert false / 200 <= 0.1
