"""The answer of a run is the best of its recommendations on held-out episodes, not the last one."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from zoac.algorithm.strategies.base import Begin, ReservedSteps, search_budget
from zoac.algorithm.strategies.held_out import HeldOut
from zoac.core.errors import ConfigError
from zoac.core.segments import Proposal, Segment
from zoac.core.tuner import Problem
from zoac.core.types import Count, UnitInterval

FRACTION = 0.2
"""Of the budget, where a run's evaluated recommendations are the candidates."""


class FinalSelection(ReservedSteps):
    """A tuner whose answer is chosen among what it recommended on the way, and the baseline.

    Candidates are the first recommendation, some from the way and the last one, and the baseline
    where there is one. They are compared on common episodes that neither the search nor any
    evaluation sees, by successive halving: each round drops the worse half and costs as many steps
    as any other. A budget that cannot pay for two candidates is left to the search.
    """

    kept = "_next _noted _rounds _until _episodes"

    def __init__(
        self,
        problem: Problem,
        begin: Begin,
        *,
        fraction: UnitInterval = 0.1,
        candidates: Count = 3,
        every: Count | None = None,
        baseline: bool = True,
    ) -> None:
        """
        Args:
            fraction: Of the budget, for held-out episodes; more, if two candidates need more.
            candidates: Recommendations after the first one, taken at equal distances.
            every: Environment steps from one candidate to the next, instead.
            baseline: The baseline, if there is one, is a candidate too. False for comparisons of
                methods, of which others are not given it.
        """
        least = 2 * problem.max_episode_steps / max(1, problem.budget)
        chosen = 0.0 if least > 0.5 else max(fraction, least)
        super().__init__(problem, begin, chosen)
        self._count = None if every is not None else candidates + 1
        self._every = every or max(1, -(-self._search_steps // candidates))
        self._with_baseline = baseline and problem.baseline is not None
        self._next = 0
        self._noted: list[tuple[int, np.ndarray]] = []  # steps so far, recommendation
        self._episodes = HeldOut(problem, "select")
        self._rounds = self._until = 0  # rounds left, this one included; episodes at its end

    def ask(self) -> list[Proposal]:
        """Return what the tuner asks; then the candidates' episodes."""
        if self._searching and self._steps >= self._next:
            self._next = (self._steps // self._every + 1) * self._every
            self._note()
        return super().ask()

    def _note(self) -> None:
        x = self._tuner.recommend()
        if not any(np.array_equal(x, noted) for _, noted in self._noted):
            self._noted.append((self._steps, x.copy()))

    def _prepare(self) -> None:
        self._note()
        count, baselines = len(self._noted), int(self._with_baseline)
        whole = self._problem.max_episode_steps
        while count + baselines > 2 and (count + baselines) * whole > self._left:
            count -= 1
        for k in np.linspace(len(self._noted) - 1, 0, count).round().astype(int):
            self._episodes.enter(self._noted[k][1])
        if self._with_baseline:
            self._episodes.enter_baseline()
        if self._fraction:
            self._begin_round(self._affordable_rounds())

    def _affordable_rounds(self) -> int:
        """Return how often the candidates can be halved, each time after new episodes."""
        halvings = math.ceil(math.log2(len(self._episodes.candidates)))
        return min(halvings, self._left // self._episodes.steps(1))

    def _begin_round(self, rounds: int) -> None:
        self._rounds = rounds
        if rounds:
            self._until += max(1, self._left // (rounds * self._episodes.steps(1)))

    def _ask_after(self) -> list[Proposal]:
        if not self._rounds:
            return []
        return self._episodes.ask_within(
            self._episodes.steps(self._until - len(self._episodes.costs))
        )

    def _tell_after(self, segments: Sequence[Segment]) -> dict[str, float]:
        episodes = self._episodes
        episodes.tell(segments)
        best = float(episodes.costs.mean(axis=0)[episodes.ranking[0]])
        if len(episodes.costs) == self._until:
            if self._rounds > 1:
                episodes.keep(math.ceil(len(episodes.candidates) / 2))
            self._begin_round(self._rounds - 1)
        return {"select_best_cost": best} if math.isfinite(best) else {}

    def recommend(self) -> np.ndarray:
        """Return the tuner's recommendation while it searches; then the candidate that leads."""
        return self._episodes.best if self._episodes.begun else super().recommend()

    def outcome(self) -> dict[str, Any]:
        """Return for `result.json` after how many steps of the search the answer came up."""
        x = self.recommend()
        steps = [steps for steps, noted in self._noted if np.array_equal(noted, x)]
        chosen = {
            "recommended_at": steps[0] if steps else None,
            "episodes": len(self._episodes.costs),
        }
        return {**super().outcome(), "select": chosen}

    def describe(self) -> dict[str, Any]:
        """Return the tuner's choices and the selection."""
        if not self._fraction:
            return super().describe()
        among = "evaluated" if self._count is None else self._count
        baseline = " and the baseline values" if self._with_baseline else ""
        told = (
            f"best of {among} recommendations{baseline} on common held-out episodes, "
            f"{self._problem.budget - self._search_steps:,} steps"
        )
        return {**super().describe(), "recommendation": told}


def best_evaluated(problem: Problem, begin: Begin, *, every: int) -> FinalSelection:
    """Return a tuner whose answer is the best of the recommendations that its run evaluates.

    Args:
        every: Environment steps between the run's evaluations.

    Raises:
        ConfigError: If the budget cannot pay for two candidates.
    """
    reserved = problem.budget - search_budget(problem.budget, FRACTION)
    if (needed := 2 * problem.max_episode_steps) > reserved:
        raise ConfigError(
            f"select=best_evaluated: choosing between two candidates may take {needed:,} "
            f"steps, and its fraction of the budget is {reserved:,}; give a budget of "
            f"{math.ceil(needed / FRACTION):,} steps or more"
        )
    return FinalSelection(problem, begin, fraction=FRACTION, every=every)
