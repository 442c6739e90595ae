"""Claims about pairs of methods that the data support."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

from zoac.analysis.pages.formatting import estimate
from zoac.analysis.statistics.intervals import (
    MIN_SEEDS,
    Interval,
    Scores,
    paired_difference,
    probability_of_improvement,
)
from zoac.core.seeding import stream


@dataclass(frozen=True, slots=True)
class Claim:
    """The comparison of two methods.

    Args:
        first: Label of one method.
        second: Label of the other.
        difference: Mean cost of the first minus that of the second, paired.
        improvement: Probability that a seed of the first costs less; None if one is not tuned.
    """

    first: str
    second: str
    difference: Interval
    improvement: Interval | None

    def __str__(self) -> str:
        d, p = self.difference, self.improvement
        pair = f"{self.first} - {self.second} = {estimate(d, sign=True)}"
        if not d.exists:
            return f"{pair}: no claim, fewer than {MIN_SEEDS} seeds"
        means = f"{pair}: {self._said(d.side(), 'costs less on average')}"
        if p is None:
            return means
        seeds = f"P({self.first} better) = {p.estimate:.2f} [{p.low:.3f}, {p.high:.3f}]"
        return f"{means}; {seeds}: {self._said(-p.side(of=0.5), 'is the better more often')}"

    def _said(self, side: int, what: str) -> str:
        return "no claim" if side == 0 else f"{self.first if side < 0 else self.second} {what}"


def claims(methods: Sequence[tuple[str, Scores]], random_seed: int) -> tuple[Claim, ...]:
    """Return a claim for each pair of labelled methods, in order."""
    made = []
    for (first, a), (second, b) in combinations(methods, 2):
        improvement = None
        if a.tuned and b.tuned:
            improvement = probability_of_improvement(a.per_seed, b.per_seed)
        rng = stream(random_seed, f"analysis {first} - {second}")
        made.append(Claim(first, second, paired_difference(a, b, rng), improvement))
    return tuple(made)
