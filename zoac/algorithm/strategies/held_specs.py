"""An answer that keeps hard specs in episodes that the search did not see."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from zoac.algorithm.strategies.base import Begin, ReservedSteps
from zoac.algorithm.strategies.held_out import HeldOut
from zoac.core.segments import Proposal, Segment
from zoac.core.tuner import Problem
from zoac.rollout.outcomes import Outcomes, ranking

FRACTION = 0.25
"""Of the budget, for held-out episodes on which the answer is chosen."""

NEIGHBOURS = (8, 12, 16, 24, 32, 48, 64)
"""A candidate for each: the more points around it kept all specs, the safer it is."""

DEARER = 0.03
"""A safer candidate may cost so much more, as a part of the cost."""

SETTLED = 0.7
"""Last part of the searched points of which candidates are taken."""

MIN_EPISODES = 10
"""Of every candidate, before one drops out."""

MAX_POINTS = 1000
"""Of these at most: every one is compared with every other."""


class HeldSpecs(ReservedSteps):
    """A tuner whose answer keeps hard specs: among its neighbours first, then on held-out episodes.

    A tuner that sees one episode per point ends where the specs just hold; in other episodes they
    then do not. Points near each other met different episodes. So a candidate is the middle of a
    point and its nearest neighbours, all of which kept the specs; there is one for each of several
    numbers of neighbours. They, the tuner's recommendation and the baseline meet the same held-out
    episodes. After some of them, a candidate that broke a spec drops out if another kept all; the
    last one is the answer. Of several the fewest violations win, and of equals the safest that
    costs little more than the cheapest.
    """

    kept = "_points _outcomes _episodes"

    def __init__(self, problem: Problem, begin: Begin) -> None:
        super().__init__(problem, begin, FRACTION)
        self._points = np.empty((0, problem.space.dimension))
        self._outcomes = Outcomes.none()
        self._episodes = HeldOut(problem, "held_specs")

    def tell(self, segments: Sequence[Segment]) -> dict[str, float]:
        """Pass on what the tuner asked for and remember it; or take the held-out episodes."""
        if self._searching:
            self._points = np.concatenate([self._points, [s.proposal.x for s in segments]])
            self._outcomes += Outcomes.of(segments)
        return super().tell(segments)

    def _prepare(self) -> None:
        self._episodes.enter_baseline()
        self._episodes.enter(self._problem.space.clip(self._tuner.recommend()))
        for count in NEIGHBOURS:
            x = self._middle(count)
            if x is not None:
                self._episodes.enter(x)

    def _middle(self, count: int) -> np.ndarray | None:
        """Return the middle (d,) of the best point and its `count` nearest, itself included."""
        late = len(self._points) - min(MAX_POINTS, int(SETTLED * len(self._points)))
        points, outcomes = self._points[late:], self._outcomes[np.arange(late, len(self._points))]
        if len(points) < count:
            return None
        apart = ((points[:, None] - points[None]) ** 2).sum(axis=2)
        near = np.argsort(apart, axis=1, kind="stable")[:, :count]
        violations, costs = outcomes.violations[near], outcomes.costs[near]
        best = ranking(violations.mean(axis=1), costs.mean(axis=1))[0]
        return points[near[best]].mean(axis=0)

    def _ask_after(self) -> list[Proposal]:
        alone = self._episodes.begun and len(self._episodes.candidates) == 1
        if alone or self._left < self._episodes.steps(1):
            return []
        return self._episodes.ask_within(self._left)

    def _tell_after(self, segments: Sequence[Segment]) -> dict[str, float]:
        self._episodes.tell(segments)
        episodes, candidates = self._episodes.violations.shape
        broken = int((self._episodes.violations.mean(axis=0) > 0).sum())
        if broken < candidates and episodes >= MIN_EPISODES:
            self._episodes.keep(candidates - broken)
        return {"held_specs_broken": float(broken)}

    def recommend(self) -> np.ndarray:
        """Return the tuner's recommendation while it searches; then the candidate that leads."""
        return self._chosen() if self._episodes.begun else super().recommend()

    def _chosen(self) -> np.ndarray:
        """Return the answer; candidates were entered from the baseline to the safest."""
        held = self._episodes
        violations, costs = held.violations.mean(axis=0), held.costs.mean(axis=0)
        first = held.ranking[0]
        dearest = costs[first] + DEARER * abs(costs[first])
        (equal,) = np.nonzero((violations == violations[first]) & (costs <= dearest))
        return held.candidates[equal[-1]]

    def outcome(self) -> dict[str, Any]:
        """Return for `result.json` how many held-out episodes chose the answer."""
        return {**super().outcome(), "held_specs": {"episodes": len(self._episodes.costs)}}

    def describe(self) -> dict[str, Any]:
        """Return the tuner's choices and this one."""
        told = f"chosen on held-out episodes, {self._fraction:.0%} of the budget"
        return {**super().describe(), "hard specs": told}
