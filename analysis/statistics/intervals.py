"""Statistics of a handful of seeds: how large a difference is, and how far to trust it.

All runs of a task have the same evaluation episodes, so costs form a crossed table, seeds by
episodes. Both levels are resampled: seeds separately for each method, episodes once for all methods
that are compared. Differences between methods stay paired.

An interval is a percentile interval, widened for few seeds (Hesterberg, The American Statistician
69 (2015) 371): its tails are those of a normal at t sqrt(n / (n - 1)), with t the Student quantile
for n seeds. For five normal seeds, a plain 95% interval covers the true value in 84% of the cases
and this interval in 92%. For fewer than five seeds there is no interval.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from scipy.special import ndtr, ndtri, stdtrit

Statistic = Callable[[np.ndarray], np.ndarray]
"""Reduces the last axis, seeds, to one number: (..., S) -> (...)."""

LEVEL = 0.95
RESAMPLES = 10_000
MIN_SEEDS = 5
"""The range of n seeds holds their distribution's median with probability 1 - 2^(1 - n)."""


class MeanStd(NamedTuple):
    """Mean and sample standard deviation; the latter is NaN for one value, both if unknown."""

    mean: float = math.nan
    std: float = math.nan


@dataclass(frozen=True, eq=False, slots=True)
class Scores:
    """Costs of one method.

    Args:
        costs: (S, E), seeds by common evaluation episodes; finite.
        tuned: Whether seeds differ by chance. A controller that was not tuned is the same for
            every seed, so only the episodes limit the confidence.
    """

    costs: np.ndarray
    tuned: bool = True

    @property
    def per_seed(self) -> np.ndarray:
        """Mean cost of each seed, (S,)."""
        return self.costs.mean(axis=1)


class Interval(NamedTuple):
    """An estimate and its 95% confidence interval; NaN bounds if the data are too few for one."""

    estimate: float
    low: float
    high: float

    @property
    def exists(self) -> bool:
        """Whether the data are enough for an interval."""
        return not np.isnan(self.low)

    def side(self, of: float = 0.0) -> Literal[-1, 0, 1]:
        """Return -1 or 1 if the whole interval lies below or above `of`, else 0."""
        if self.high < of:
            return -1
        return 1 if self.low > of else 0


UNKNOWN = Interval(math.nan, math.nan, math.nan)


def mean_std(values: Sequence[float] | np.ndarray) -> MeanStd:
    """Return mean and sample standard deviation; unknown if there is no value or one not finite."""
    array = np.asarray(values, dtype=np.float64)
    if not array.size or not np.isfinite(array).all():
        return MeanStd()
    return MeanStd(float(array.mean()), float(array.std(ddof=1)) if array.size > 1 else math.nan)


def mean(values: np.ndarray) -> np.ndarray:
    """Return the mean over the last axis."""
    return np.mean(values, axis=-1)


def interquartile_mean(values: np.ndarray) -> np.ndarray:
    """Return the mean of the middle half of the last axis (Agarwal et al., NeurIPS 2021).

    Where the number of values is no multiple of four, the two at the edges count in part.
    """
    ordered = np.sort(values, axis=-1)
    n = ordered.shape[-1]
    ranks = np.arange(n)
    # Overlap of the rank interval [i, i + 1] of each value with the middle half.
    weights = np.clip(np.minimum(ranks + 1, 0.75 * n) - np.maximum(ranks, 0.25 * n), 0.0, None)
    return ordered @ (weights / weights.sum())


def summarise(
    scores: Scores,
    rng: np.random.Generator,
    *,
    statistic: Statistic = mean,
    resamples: int = RESAMPLES,
) -> Interval:
    """Return `statistic` over seeds of the mean cost, and its two-level interval."""
    estimate = float(statistic(scores.per_seed))
    if (n := _smallest([scores])) < MIN_SEEDS:
        return Interval(estimate, math.nan, math.nan)
    (drawn,) = _bootstrap([scores], rng, statistic, resamples)
    return _interval(estimate, drawn, n)


def paired_difference(
    a: Scores, b: Scores, rng: np.random.Generator, *, resamples: int = RESAMPLES
) -> Interval:
    """Return the mean cost of `a` minus that of `b` on the same episodes, with its interval."""
    estimate = float(mean(a.per_seed) - mean(b.per_seed))
    if (n := _smallest([a, b])) < MIN_SEEDS:
        return Interval(estimate, math.nan, math.nan)
    drawn_a, drawn_b = _bootstrap([a, b], rng, mean, resamples)
    return _interval(estimate, drawn_a - drawn_b, n)


def probability_of_improvement(a: np.ndarray, b: np.ndarray) -> Interval:
    """Return the probability that a seed of `a` (m,) costs less than one of `b` (n,).

    Ties count half. The interval is a score interval, Newcombe, Statistics in Medicine 25 (2006)
    559, method 5: unlike a bootstrap it stays valid where the two samples do not overlap at all.
    """
    m, n = len(a), len(b)
    less = np.less.outer(a, b) + 0.5 * np.equal.outer(a, b)
    estimate = float(less.mean())
    spare = 0.5 * (m + n) - 1.0
    x = ndtri(0.5 + LEVEL / 2)

    def too_far(theta: float) -> bool:
        factor = 1 + spare * (1 - theta) / (2 - theta) + spare * theta / (1 + theta)
        return abs(estimate - theta) > x * np.sqrt(theta * (1 - theta) * factor / (m * n))

    return Interval(estimate, _edge(too_far, 0.0, estimate), _edge(too_far, 1.0, estimate))


def _bootstrap(
    groups: Sequence[Scores], rng: np.random.Generator, statistic: Statistic, resamples: int
) -> list[np.ndarray]:
    """Return `statistic` of each group in each resample, (R,), with common episodes."""
    count = groups[0].costs.shape[1]
    weights = rng.multinomial(count, np.full(count, 1.0 / count), size=resamples) / count
    drawn = []
    for group in groups:
        per_seed = weights @ group.costs.T
        picks = rng.integers(len(group.costs), size=per_seed.shape)
        drawn.append(statistic(np.take_along_axis(per_seed, picks, axis=1)))
    return drawn


def _smallest(groups: Sequence[Scores]) -> int:
    """Return the fewest seeds of a tuned group, or of episodes if no group is tuned."""
    tuned = [len(group.costs) for group in groups if group.tuned]
    return min(tuned) if tuned else groups[0].costs.shape[1]


def _interval(estimate: float, drawn: np.ndarray, n: int) -> Interval:
    """Return the percentile interval of `drawn`, widened as for `n` seeds."""
    tail = ndtr(-stdtrit(n - 1, 0.5 + LEVEL / 2) * np.sqrt(n / (n - 1)))
    low, high = np.quantile(drawn, [tail, 1 - tail])
    return Interval(estimate, float(low), float(high))


def _edge(too_far: Callable[[float], bool], outside: float, inside: float) -> float:
    """Bisect for the value nearest `outside` that is not too far."""
    if not too_far(outside):
        return outside
    for _ in range(60):
        middle = 0.5 * (outside + inside)
        outside, inside = (middle, inside) if too_far(middle) else (outside, middle)
    return inside
