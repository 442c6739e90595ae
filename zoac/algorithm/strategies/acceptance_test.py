"""The acceptance test: the answer must beat the baseline on held-out episodes."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from zoac.algorithm.strategies.base import Begin, ReservedSteps
from zoac.algorithm.strategies.held_out import HeldOut
from zoac.algorithm.strategies.paired_comparison import MIN_PAIRS, Comparison, compare
from zoac.core.errors import ConfigError
from zoac.core.segments import Proposal, Segment
from zoac.core.tuner import Problem
from zoac.core.types import Fraction


class AcceptanceTest(ReservedSteps):
    """A tuner whose answer must beat the baseline on held-out episodes; else the baseline is kept.

    The last fraction of the budget pays for pairs of episodes from seeds that the search never
    saw: one with the baseline, one with what the tuner recommends. The number of pairs is fixed
    before the first; `Comparison` decides after the last. If it cannot, the baseline is kept.
    """

    kept = "_pairs _episodes"

    def __init__(self, problem: Problem, begin: Begin, *, fraction: Fraction) -> None:
        """
        Args:
            fraction: Of the budget, for held-out episodes.

        Raises:
            ConfigError: If there are no baseline values.
        """
        if problem.baseline is None:
            raise ConfigError(
                "acceptance_test: there are no baseline values to compare with; give the task some"
            )
        super().__init__(problem, begin, fraction)
        self._baseline = problem.baseline
        self._pairs = 0  # how many will be run
        self._episodes = HeldOut(problem, "acceptance_test")

    def _prepare(self) -> None:
        self._episodes.enter(self._baseline)
        self._episodes.enter(self._tuner.recommend())
        if not self._candidate_is_start:
            self._pairs = self._left // (2 * self._longest)

    @property
    def _candidate_is_start(self) -> bool:
        return not self._searching and bool(np.ptp(self._episodes.candidates, axis=0).max() == 0)

    def _ask_after(self) -> list[Proposal]:
        left = self._pairs - len(self._episodes.costs)
        return self._episodes.ask_within(self._episodes.steps(left)) if left else []

    def _tell_after(self, segments: Sequence[Segment]) -> dict[str, float]:
        self._episodes.tell(segments)
        names = "acceptance_baseline_cost", "acceptance_candidate_cost"
        means = zip(names, _finite_means(self._episodes.costs), strict=True)
        return {name: mean for name, mean in means if mean is not None}

    @property
    def comparison(self) -> Comparison | None:
        """The comparison of start and candidate; None until all its pairs have been run."""
        if not self._pairs or len(self._episodes.costs) < self._pairs:
            return None
        return compare(self._episodes)

    @property
    def accepted(self) -> bool:
        """Whether the candidate has proved better than the start."""
        return self.comparison is not None and self.comparison.accepted

    def recommend(self) -> np.ndarray:
        """Return the tuner's recommendation while it searches; then what was accepted."""
        if self._searching:
            return self._tuner.recommend()
        return self._episodes.candidates[1] if self.accepted else self._baseline.copy()

    def outcome(self) -> dict[str, Any]:
        """Return the verdict for `result.json`."""
        episodes, comparison = self._episodes, self.comparison
        start, candidate = _finite_means(episodes.costs)
        failures = [int(count) for count in episodes.failed.sum(axis=0)] or [0, 0]
        verdict = {
            "accepted": self.accepted,
            "pairs": len(episodes.costs),
            "candidate_is_start": self._candidate_is_start,
            "baseline_cost_mean": start,
            "candidate_cost_mean": candidate,
            "start_failures": failures[0],
            "candidate_failures": failures[1],
            "p_value": None if comparison is None else comparison.p_value,
            "text": self._not_run() if comparison is None else comparison.text,
        }
        return {**super().outcome(), "acceptance_test": verdict}

    def _not_run(self) -> str:
        if self._candidate_is_start:
            return "the search recommends the baseline values themselves"
        if self._pairs:
            done = len(self._episodes.costs)
            return f"the test was not finished: {done} of {self._pairs} pairs of episodes were run"
        return (
            f"the test could not be run: a pair of episodes may take {2 * self._longest:,} steps, "
            f"and {max(0, self._left):,} were left for it"
        )

    def describe(self) -> dict[str, Any]:
        """Return the tuner's choices and the test."""
        reserved = self._problem.budget - self._search_steps
        pairs = reserved // (2 * self._problem.max_episode_steps)
        told = f"last {self._fraction:.0%} of the budget, against the baseline values"
        if pairs < MIN_PAIRS:
            told += (
                f"; that is sure to pay for {pairs} pairs of episodes, and fewer than {MIN_PAIRS} "
                "accept nothing"
            )
        return {**super().describe(), "acceptance_test": told}


def _finite_means(costs: np.ndarray) -> tuple[float | None, float | None]:
    """Return the mean costs of start and candidate, None where there is no finite one."""
    if not len(costs):
        return None, None
    start, candidate = (float(m) if np.isfinite(m) else None for m in costs.mean(axis=0))
    return start, candidate
