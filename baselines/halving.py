"""Sequential halving: random points, of which the better ones are measured again and again."""

import math
from collections.abc import Sequence
from typing import Any, Literal

import numpy as np

from zoac.core.segments import Proposal, Segment
from zoac.core.state import Kept
from zoac.core.tuner import Problem, Tuner
from zoac.core.types import Count
from zoac.rollout.outcomes import Outcomes


class RepeatedHalving(Kept, Tuner):
    """Random points, of which the better half is measured again until two are left.

    Every round spends the same number of episodes on half as many points: sequential halving
    (Karnin, Koren and Somekh, 2013). A point is judged by the mean of all of its episodes, so that
    a lucky one does not win where costs are noisy.

    What the rounds leave of the budget measures these two in turn. The answer has the least mean
    cost of the points that came furthest.
    """

    display_name = "Halving"
    measures_again = True
    kept = "_alive _rounds _left _count _violations _costs"

    def __init__(
        self,
        problem: Problem,
        *,
        points: Count | None = None,
        start: Literal["random", "baseline"] = "random",
    ) -> None:
        """
        Args:
            problem: What is tuned.
            points: Number of the first round; None: as many as give every round the same number
                of episodes.
            start: Whether the baseline values are one of them, or all are random.

        Raises:
            ConfigError: If baseline values are to take part and there are none.
        """
        self._problem, self._start = problem, start
        rng = problem.rng("halving")
        self._left = max(1, problem.budget // problem.max_episode_steps)  # episodes
        size = min(points or _points(self._left), self._left)
        self._points = rng.uniform(-1.0, 1.0, (size, problem.space.dimension))
        if start == "baseline":
            self._points[0] = problem.baseline_start("tuner.start=baseline")
        self._alive = np.arange(size)  # best first, once they were measured
        self._rounds = _rounds(size)
        self._count = np.zeros(size, dtype=np.int64)
        self._violations, self._costs = np.zeros(size), np.zeros(size)  # sums

    def ask(self) -> list[Proposal]:
        """Return a round; after the last one, one more episode for each of those left."""
        share = self._left // max(1, self._rounds)
        repeats = max(1, share // len(self._alive)) if self._rounds else 1
        num_envs = self._problem.num_envs
        numbers = np.tile(self._alive, repeats)
        return [Proposal(self._points[n].copy(), i % num_envs) for i, n in enumerate(numbers)]

    def tell(self, segments: Sequence[Segment]) -> dict[str, float]:
        """Take a round, and keep its better half."""
        outcomes = Outcomes.of(segments)
        numbers = np.resize(self._alive, len(segments))
        np.add.at(self._count, numbers, 1)
        np.add.at(self._violations, numbers, outcomes.violations)
        np.add.at(self._costs, numbers, outcomes.costs)
        self._left = max(0, self._left - len(segments))
        kept = len(self._alive)
        if self._rounds:
            self._rounds -= 1
            kept = math.ceil(kept / 2) if self._rounds else kept
        self._alive = self._ranked()[:kept]
        best = self._alive[0]
        mean = self._costs[best] / self._count[best]
        return {"halving_points": float(len(self._alive)), "halving_best_cost": float(mean)}

    def _ranked(self) -> np.ndarray:
        """Return the measured points (k,), best first.

        Those of the last round come first, by their means, then those that were left out before,
        and last all that ever failed.
        """
        measured = np.flatnonzero(self._count)
        violations = self._violations[measured] / self._count[measured]
        costs = self._costs[measured] / self._count[measured]
        left_out = ~np.isin(measured, self._alive)
        return measured[np.lexsort((costs, violations, left_out, np.isinf(violations)))]

    def recommend(self) -> np.ndarray:
        """See `Tuner.recommend`; before the first round, its first point."""
        return self._points[self._alive[0]].copy()

    def describe(self) -> dict[str, Any]:
        among = ", the baseline values among them" if self._start == "baseline" else ""
        return {"points": f"{len(self._points)}{among}"}


def _rounds(points: int) -> int:
    """Return how many rounds there are until two points are left, the last one between them."""
    return max(1, math.ceil(math.log2(points)))


def _points(episodes: int) -> int:
    """Return the largest number of points for which every round has as many episodes."""
    return max(n for n in range(1, episodes + 1) if n == 1 or n * _rounds(n) <= episodes)
