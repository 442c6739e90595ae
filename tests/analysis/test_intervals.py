from itertools import product

import numpy as np
import pytest
from scipy.stats import norm, trim_mean
from scipy.stats import t as student

from zoac.analysis.statistics.intervals import (
    Interval,
    Scores,
    interquartile_mean,
    paired_difference,
    probability_of_improvement,
    summarise,
)


@pytest.fixture
def rng():
    return np.random.default_rng(0)


def coverage(intervals, truth):
    return float(np.mean([i.low <= truth <= i.high for i in intervals]))


def test_interquartile_mean_is_the_trimmed_mean_where_four_divides_the_count(rng):
    values = rng.normal(size=(3, 12))
    np.testing.assert_allclose(interquartile_mean(values), trim_mean(values, 0.25, axis=1))


def test_interquartile_mean_counts_the_edges_in_part():
    # Of five values the middle half spans ranks 1.25 to 3.75: weights 0, 3/4, 1, 3/4, 0.
    assert interquartile_mean(np.array([1e9, 2.0, 1.0, 4.0, -1e9])) == pytest.approx(
        (0.75 * 1 + 2 + 0.75 * 4) / 2.5
    )


@pytest.mark.parametrize(("seeds", "least"), [(5, 0.90), (20, 0.93)])
def test_interval_of_normal_seeds_holds_the_truth_about_as_often_as_it_says(rng, seeds, least):
    intervals = [
        summarise(Scores(rng.normal(3.0, 2.0, (seeds, 1))), rng, resamples=500) for _ in range(1500)
    ]
    # Binomial standard deviation 0.006. A plain percentile interval of five holds it 0.84 times.
    assert least < coverage(intervals, 3.0) < 0.97


def test_interval_of_five_seeds_is_the_widened_percentile_of_all_resamples(rng):
    scores = np.array([1.0, 2.3, 2.9, 7.1, 11.7])
    every = np.sort(np.array(list(product(scores, repeat=5))).mean(axis=1))
    tail = norm.cdf(-student.ppf(0.975, 4) * np.sqrt(5 / 4))
    interval = summarise(Scores(scores[:, None]), rng, resamples=200_000)
    # One atom either way, of 3125: the standard deviation of the simulated tail is a quarter.
    for bound, at in ((interval.low, tail * 3125), (interval.high, (1 - tail) * 3125)):
        assert every[round(at) - 2] <= bound <= every[round(at) + 1]


def test_interval_of_a_crossed_table_covers_seeds_and_episodes(rng):
    def table():
        seeds, episodes = rng.normal(size=(5, 1)), rng.normal(0.0, 3.0, (1, 10))
        return Scores(seeds + episodes + rng.normal(size=(5, 10)))

    intervals = [summarise(table(), rng, resamples=300) for _ in range(600)]
    assert 0.93 <= coverage(intervals, 0.0) <= 1.0


def test_pairing_removes_what_episodes_have_in_common(rng):
    hard = rng.normal(0.0, 10.0, (1, 40))
    a = Scores(40.0 + hard + rng.normal(0.0, 0.2, (6, 40)))
    b = Scores(41.0 + hard + rng.normal(0.0, 0.2, (6, 40)))
    paired = paired_difference(a, b, rng)
    assert paired.side() == -1
    assert paired.high - paired.low < 0.3
    # Taken by themselves the two overlap widely.
    assert summarise(a, rng).high > summarise(b, rng).low + 2.0


def test_paired_difference_holds_the_truth_as_often_as_it_says(rng):
    def difference():
        hard = rng.normal(0.0, 5.0, (1, 10))
        a, b = (
            Scores(m + hard + rng.normal(0.0, s, (5, 1)) + rng.normal(0.0, 0.3, (5, 10)))
            for m, s in ((2.0, 1.0), (3.0, 1.0))
        )
        return paired_difference(a, b, rng, resamples=300)

    assert 0.93 <= coverage([difference() for _ in range(600)], -1.0) <= 1.0


def test_seeds_of_an_untuned_controller_add_no_confidence(rng):
    costs = rng.normal(size=(1, 50))
    copies = np.repeat(costs, 5, axis=0)
    one = summarise(Scores(costs, tuned=False), np.random.default_rng(1))
    five = summarise(Scores(copies, tuned=False), np.random.default_rng(1))
    assert five.low == pytest.approx(one.low)


def test_four_tuned_seeds_carry_no_interval_and_no_claim(rng):
    four, other = Scores(np.full((4, 3), 1.0)), Scores(np.full((5, 3), 9.0))
    interval = paired_difference(four, other, rng)
    assert interval.estimate == -8.0
    assert not interval.exists
    assert interval.side() == 0


@pytest.mark.parametrize(
    ("low", "high", "sign"), [(-2.0, -1.0, -1), (-1.0, 1.0, 0), (0.5, 1.0, 1), (0.0, 1.0, 0)]
)
def test_a_claim_needs_the_whole_interval_on_one_side(low, high, sign):
    assert Interval((low + high) / 2, low, high).side() == sign
    assert Interval((low + high) / 2 + 7, low + 7, high + 7).side(of=7.0) == sign


def test_probability_of_improvement_of_two_normals(rng):
    # P(A < B) for A ~ N(0, 1), B ~ N(1, 1) is Phi(1 / sqrt(2)).
    estimate = probability_of_improvement(rng.normal(0, 1, 2000), rng.normal(1, 1, 2000)).estimate
    assert estimate == pytest.approx(norm.cdf(1 / np.sqrt(2)), abs=0.02)


def test_probability_of_improvement_counts_ties_half():
    assert probability_of_improvement(np.ones(3), np.ones(4)).estimate == 0.5


def test_probability_of_improvement_holds_the_truth_as_often_as_it_says(rng):
    intervals = [
        probability_of_improvement(rng.normal(0, 1, 8), rng.normal(1, 1, 8)) for _ in range(800)
    ]
    assert 0.93 <= coverage(intervals, norm.cdf(1 / np.sqrt(2))) <= 0.99


def test_complete_separation_is_not_certainty():
    interval = probability_of_improvement(np.arange(5.0), np.arange(5.0) + 10)
    assert interval.estimate == interval.high == 1.0
    assert 0.5 < interval.low < 0.9
