"""Two controllers on the same episodes: is one better, and is that more than chance?

The costs of episodes are skewed, discrete and now and then enormous, since many tasks price a
termination at hundreds of ordinary episodes. So the tests here are exact: they assume no
distribution, and hold for any number of pairs.

No test can promise more about the mean. Whatever a rule sees in n pairs, a failure too rare to
appear in them may outweigh every gain (Bahadur and Savage, 1956). `unseen_rate` says how rare.
"""

import math
from dataclasses import dataclass

import numpy as np

from zoac.algorithm.strategies.held_out import HeldOut

LEVEL = 0.05
"""Probability, at most, of a false positive."""

MIN_PAIRS = 5
"""With fewer pairs no exact test can reach `LEVEL`: 2^-4 is above it."""

FLIPS = 9_999
"""Random assignments of signs in `sign_flip_test`."""

NOTEWORTHY = 1e-3
"""Part of the mean cost below which a difference is nothing to warn of."""


def sign_test(wins: int, losses: int) -> float:
    """Return the probability of so many wins or more if a win is no likelier than a loss."""
    n = wins + losses
    return sum(math.comb(n, k) for k in range(wins, n + 1)) / 2**n


def sign_flip_test(differences: np.ndarray) -> float:
    """Return the p-value of a sum as low as that of `differences` (n,), if they are symmetric.

    Under the null hypothesis either sign of a difference is as likely. The signs are drawn from a
    fixed seed; the observed ones count among them, which keeps the test exact.
    """
    signs = np.random.default_rng(0).choice([-1.0, 1.0], size=(FLIPS, len(differences)))
    # Sums that differ by rounding only count as equal.
    as_low = signs @ differences <= differences.sum() + 1e-9 * np.abs(differences).sum()
    return float((1 + as_low.sum()) / (1 + FLIPS))


def unseen_rate(episodes: int) -> float:
    """Return the lowest failure rate that `episodes` without a failure exclude with 95%."""
    return 1.0 - LEVEL ** (1.0 / episodes)


def clearly_higher(
    costs: np.ndarray,
    reference: np.ndarray,
    *,
    comparisons: int = 1,
    noteworthy: float = NOTEWORTHY,
) -> bool:
    """Tell whether paired costs (n,) are above the reference's on average, beyond noise.

    A paired t test, for a warning and not for a decision. A single pair has no noise to go by:
    there any noteworthy difference counts.

    Args:
        costs: Of each episode.
        reference: Of the same episodes.
        comparisons: Number of references of which this is the best (Bonferroni's correction).
        noteworthy: Part of the reference's mean that the difference must exceed.
    """
    if not np.isfinite(costs).all():
        return bool(np.isfinite(reference).all())
    if not np.isfinite(reference).all():
        return False
    from scipy.special import stdtrit  # takes a third of the start of a command

    differences = costs - reference
    error = 0.0
    if (n := len(differences)) > 1:
        quantile = float(stdtrit(n - 1, 1.0 - LEVEL / comparisons))
        error = quantile * float(differences.std(ddof=1)) / math.sqrt(n)
    mean = float(differences.mean())
    return mean > max(error, noteworthy * abs(float(reference.mean())))


@dataclass(frozen=True)
class Comparison:
    """Whether a candidate has proved better than the baseline values, and what that rests on.

    Of each pair, the episode that violates constraints less wins; of two equal ones, that which
    did not fail; of two equal ones, the cheaper. The candidate is accepted if

    1. it failed (terminated, violated or cost no finite number) in no pair in which the start
       values did not, or in so few that an exact test of counts shows that it fails less often;
    2. a sign test of wins against losses passes at 5%; and
    3. a sign-flip test of the differences passes at 5%, in which a pair that failures decide
       weighs as much as the largest difference of costs.

    Promised: a candidate that wins no more episodes than it loses is accepted at most one time in
    twenty, whatever the distribution of costs; so is one whose differences are symmetric about
    zero or above, whatever their deviation. The third test weighs how much is won and lost, so that
    many small gains do not hide a few large losses that were seen. Not promised, since no number
    of pairs could: that no failure rarer than `unseen_rate` makes the mean worse.

    Args:
        pairs: Number of pairs.
        wins: Pairs that the candidate won.
        losses: Pairs that it lost.
        failures: Episodes in which start and candidate failed.
        new_failures: Pairs in which the candidate alone failed.
        mended_failures: Pairs in which the start alone failed.
        p_value: The larger one of the sign test's and the sign-flip test's.
    """

    pairs: int
    wins: int
    losses: int
    failures: tuple[int, int]
    new_failures: int
    mended_failures: int
    p_value: float

    @property
    def fails_more(self) -> bool:
        """Whether the candidate failed where the start did not, without failing less elsewhere."""
        new, mended = self.new_failures, self.mended_failures
        return new > 0 and sign_test(mended, new) > LEVEL

    @property
    def accepted(self) -> bool:
        """Whether the candidate takes the place of the baseline values."""
        return not self.fails_more and self.p_value <= LEVEL

    @property
    def text(self) -> str:
        """What was tested and what came out, in one sentence."""
        start, candidate = self.failures
        told = (
            f"in {self.pairs} pairs of episodes the tuned values were better in {self.wins} and "
            f"worse in {self.losses} (p = {self.p_value:.2g} by exact tests); they failed in "
            f"{candidate}, the baseline values in {start}"
        )
        if self.pairs < MIN_PAIRS:
            told += f"; fewer than {MIN_PAIRS} pairs accept nothing"
        elif self.fails_more:
            told += (
                f"; the tuned values failed in {self.new_failures} in which the baseline values "
                "did not"
            )
        if not candidate:
            told += f"; a failure rate below {unseen_rate(self.pairs):.2g} cannot be excluded"
        return told


def compare(episodes: HeldOut) -> Comparison:
    """Return the comparison of two candidates, the baseline values first."""
    baseline, candidate = episodes.failed.T
    differences = _differences(episodes)
    wins, losses = int((differences < 0).sum()), int((differences > 0).sum())
    return Comparison(
        pairs=len(baseline),
        wins=wins,
        losses=losses,
        failures=(int(baseline.sum()), int(candidate.sum())),
        new_failures=int((candidate & ~baseline).sum()),
        mended_failures=int((baseline & ~candidate).sum()),
        p_value=max(sign_test(wins, losses), sign_flip_test(differences)),
    )


def _differences(episodes: HeldOut) -> np.ndarray:
    """Return candidate minus start of each pair (n,), failures before costs."""
    decided = np.sign(episodes.violations[:, 1] - episodes.violations[:, 0])
    failing = episodes.failed.astype(float)
    decided = np.where(decided == 0, np.sign(failing[:, 1] - failing[:, 0]), decided)
    with np.errstate(invalid="ignore"):
        costs = episodes.costs[:, 1] - episodes.costs[:, 0]
    comparable = (decided == 0) & np.isfinite(costs)
    largest = np.abs(costs[comparable]).max(initial=0.0) or 1.0
    return np.where(comparable, costs, decided * largest)
