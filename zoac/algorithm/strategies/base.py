"""Base classes of everything that wraps a tuner.

A strategy's constructor takes the `Problem`, a function that makes the tuner inside for a problem,
and its options by keyword. The inner tuner's problem has the budget that the strategy leaves it.
"""

from abc import abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from zoac.core.segments import Proposal, Segment
from zoac.core.state import Kept
from zoac.core.tuner import Problem, Tuner

Begin = Callable[[Problem], Tuner]
"""Makes a tuner for a problem."""


class TunerStrategy(Kept, Tuner):
    """A tuner around another: a subclass changes some of what it does and forwards the rest."""

    def __init__(self, problem: Problem, begin: Begin) -> None:
        self._problem = problem
        self._tuner = begin(problem)
        self.display_name = self._tuner.display_name

    def ask(self) -> list[Proposal]:
        return self._tuner.ask()

    def tell(self, segments: Sequence[Segment]) -> dict[str, float]:
        return self._tuner.tell(segments)

    def background_update(self) -> None:
        self._tuner.background_update()

    def recommend(self) -> np.ndarray:
        return self._tuner.recommend()

    def state(self) -> Any:
        return {**super().state(), "tuner": self._tuner.state()}

    def restore(self, state: Any) -> None:
        super().restore(state)
        self._tuner.restore(state["tuner"])

    def end_search(self) -> bool:
        return self._tuner.end_search()

    def outcome(self) -> dict[str, Any]:
        return self._tuner.outcome()

    def describe(self) -> dict[str, Any]:
        return self._tuner.describe()


class StartSearch(TunerStrategy):
    """A tuner that begins at the best point of a search for a start, whose steps count.

    Until that search is over, the tuner inside is one that would begin at the best point so far.
    It must begin at `Problem.start`, and is given the budget that is left.
    """

    kept = "_spent"

    def __init__(self, problem: Problem, begin: Begin) -> None:
        self._begin, self._spent = begin, 0
        super().__init__(problem, self._begin_at_best)

    def _begin_at_best(self, problem: Problem) -> Tuner:
        left = max(0, problem.budget - self._spent)
        return self._begin(replace(problem, start=self._best(), budget=left))

    @property
    @abstractmethod
    def _looking(self) -> bool:
        """Whether the search for a start goes on."""

    @abstractmethod
    def _best(self) -> np.ndarray:
        """Return the best mapped parameters (d,) so far."""

    @abstractmethod
    def _ask_start(self) -> list[Proposal]:
        """Return the next batch of the search for a start."""

    @abstractmethod
    def _tell_start(self, segments: Sequence[Segment]) -> dict[str, float]:
        """Take what came back for it."""

    def ask(self) -> list[Proposal]:
        """Return what the search for a start asks; then what the tuner asks."""
        return self._ask_start() if self._looking else super().ask()

    def tell(self, segments: Sequence[Segment]) -> dict[str, float]:
        """Pass what came back to the one that asked for it."""
        if not self._looking:
            return super().tell(segments)
        self._spent += sum(segment.length for segment in segments)
        numbers = self._tell_start(segments)
        if not self._looking:
            self._tuner = self._begin_at_best(self._problem)
        return numbers

    def end_search(self) -> bool:
        """End the search for a start, whose best point is then recommended; or the tuner's."""
        return not self._looking and super().end_search()

    def recommend(self) -> np.ndarray:
        """Return the best point so far, then the tuner's recommendation."""
        return self._best() if self._looking else super().recommend()

    def restore(self, state: Any) -> None:
        Kept.restore(self, state)
        self._tuner = self._begin_at_best(self._problem)
        self._tuner.restore(state["tuner"])


class ReservedSteps(TunerStrategy):
    """A tuner that leaves the last steps of the budget to something else.

    The search ends before the first batch that could touch the reserved steps, were all of its
    episodes to run to their time limit.
    """

    kept = "_steps _longest _searching _end"

    def __init__(self, problem: Problem, begin: Begin, fraction: float) -> None:
        """
        Args:
            fraction: Of the budget, for what comes after the search.
        """
        self._fraction = fraction
        self._search_steps = search_budget(problem.budget, fraction)
        super().__init__(problem, lambda p: begin(replace(p, budget=self._search_steps)))
        self._steps, self._end = 0, problem.budget
        self._ended_early = False
        # Where there is no time limit, episodes may be longer than those that were measured.
        self._longest = problem.max_episode_steps
        self._searching = True

    def ask(self) -> list[Proposal]:
        """Return what the tuner asks, while that is sure to leave the reserved steps."""
        if self._searching:
            proposals = super().ask() if self._steps < self._search_steps else []
            reserves = self._search_steps < self._problem.budget
            fits = self._steps + self._max_steps(proposals) <= self._search_steps
            if proposals and (fits or not reserves):
                return proposals
            self._leave_search()
        return self._ask_after()

    def end_search(self) -> bool:
        """End the search; the reserved steps are then spent, and no more."""
        self._ended_early = True
        if self._searching and not super().end_search():
            self._leave_search()
        return True

    def _leave_search(self) -> None:
        self._searching = False
        if self._ended_early:
            self._end = self._steps + self._problem.budget - self._search_steps
        self._prepare()

    def _max_steps(self, proposals: Sequence[Proposal]) -> int:
        whole = self._longest
        return sum(whole if p.horizon is None else min(p.horizon, whole) for p in proposals)

    @property
    def _left(self) -> int:
        """Environment steps that are left: of the whole budget, or of what was reserved."""
        return self._end - self._steps

    @abstractmethod
    def _prepare(self) -> None:
        """Prepare what comes after the search."""

    @abstractmethod
    def _ask_after(self) -> list[Proposal]:
        """Return the next batch after the search."""

    @abstractmethod
    def _tell_after(self, segments: Sequence[Segment]) -> dict[str, float]:
        """Take what came back for it."""

    def tell(self, segments: Sequence[Segment]) -> dict[str, float]:
        """Pass on what the tuner asked for, or take what came after."""
        lengths = [segment.length for segment in segments]
        self._steps += sum(lengths)
        self._longest = max([self._longest, *lengths])
        return super().tell(segments) if self._searching else self._tell_after(segments)


def search_budget(budget: int, fraction: float) -> int:
    """Return the environment steps that are left to the search."""
    return int(budget * (1.0 - fraction))
