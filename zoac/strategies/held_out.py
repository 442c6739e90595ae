"""Candidates for the answer, compared on the same held-out episodes, whose steps are reserved."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from typing import Any

import numpy as np

from zoac.core.seeding import stream_seed
from zoac.core.segments import Proposal, Segment
from zoac.core.tuner import Problem, Tuner
from zoac.rollout.outcomes import bad_is_infinite, cost_sums, ranking
from zoac.strategies.base import TunerStrategy


class HeldOut:
    """Whole episodes from common seeds, the same for every candidate.

    Plain costs are compared, whatever a tuner is told. Where constraints are violated, the least
    violation comes first and the lowest mean cost second.
    """

    def __init__(self, problem: Problem, name: str, *, seeded: bool = True) -> None:
        """
        Args:
            problem: What is tuned.
            name: Of the stream that the episodes' seeds come from; no other part of a run has it.
            seeded: False: the episodes are the environments' own.
        """
        self._problem, self._name, self._seeded = problem, name, seeded
        self._candidates = np.empty((0, problem.space.dimension))
        self.costs = np.empty((0, 0))
        """Plain costs (episodes, candidates); infinite where a cost is not finite."""
        self.violations = np.empty((0, 0))
        """By how much constraints were exceeded, (episodes, candidates)."""
        self.failed = np.empty((0, 0), dtype=bool)
        """Episodes (episodes, candidates) that terminated, violated or cost no finite number."""

    def enter(self, x: np.ndarray) -> None:
        """Add mapped parameters (d,) as one more candidate; before the first episode only."""
        self._candidates = np.concatenate([self._candidates, x[None]])
        shape = (0, len(self._candidates))
        self.costs, self.violations = np.empty(shape), np.empty(shape)
        self.failed = np.empty(shape, dtype=bool)

    def enter_baseline(self) -> None:
        """Add the baseline, if there is one and it is no candidate yet."""
        baseline = self._problem.baseline
        if baseline is not None and not (self._candidates == baseline).all(axis=1).any():
            self.enter(baseline)

    @property
    def candidates(self) -> np.ndarray:
        """Mapped parameters of the candidates (candidates, d)."""
        return self._candidates.copy()

    @property
    def begun(self) -> bool:
        """Whether an episode has been run."""
        return len(self.costs) > 0

    @property
    def ranking(self) -> np.ndarray:
        """Indices of the candidates, best first."""
        return ranking(self.violations.mean(axis=0), self.costs.mean(axis=0))

    @property
    def best(self) -> np.ndarray:
        """The mapped parameters (d,) of the candidate that leads."""
        return self._candidates[self.ranking[0]].copy()

    def keep(self, count: int) -> None:
        """Drop all candidates but the best `count`, which keep their order."""
        kept = np.sort(self.ranking[:count])
        self._candidates = self._candidates[kept]
        self.costs, self.violations, self.failed = (
            array[:, kept] for array in (self.costs, self.violations, self.failed)
        )

    def ask(self, episodes: int) -> list[Proposal]:
        """Return so many of the next episodes of every candidate."""
        num_envs, done = self._problem.num_envs, len(self.costs)
        runs = [(episode, x) for episode in range(done, done + episodes) for x in self._candidates]
        return [
            Proposal(x, i % num_envs, seed=self._seed(episode))
            for i, (episode, x) in enumerate(runs)
        ]

    def ask_within(self, steps: int) -> list[Proposal]:
        """Return as many of the next episodes as keep all busy and fit into `steps`."""
        return self.ask(max(1, min(self.busy, steps // self.steps(1))))

    @property
    def busy(self) -> int:
        """How many episodes of every candidate run side by side, at least one."""
        return max(1, self._problem.num_envs // len(self._candidates))

    def steps(self, episodes: int) -> int:
        """Return the steps that so many episodes of every candidate take at most."""
        return episodes * len(self._candidates) * self._problem.max_episode_steps

    def _seed(self, episode: int) -> int | None:
        return stream_seed(self._problem.seed, self._name, episode) if self._seeded else None

    def tell(self, segments: Sequence[Segment]) -> None:
        """Take the episodes, in the order of the proposals."""
        plain = [segment.with_costs(segment.plain_costs) for segment in segments]
        costs = bad_is_infinite(cost_sums(plain))
        violations = np.array([segment.violation for segment in segments])
        terminated = np.array([segment.terminated for segment in segments])
        failed = terminated | (violations > 0) | np.isinf(costs)
        shape = (-1, len(self._candidates))
        self.costs = np.concatenate([self.costs, costs.reshape(shape)])
        self.violations = np.concatenate([self.violations, violations.reshape(shape)])
        self.failed = np.concatenate([self.failed, failed.reshape(shape)])

    def state(self) -> tuple[np.ndarray, ...]:
        """Return a copy of candidates and episodes."""
        arrays = self._candidates, self.costs, self.violations, self.failed
        return tuple(array.copy() for array in arrays)

    def restore(self, state: Sequence[np.ndarray]) -> None:
        """Restore what `state` returned."""
        arrays = (array.copy() for array in state)
        self._candidates, self.costs, self.violations, self.failed = arrays


class ReservedSteps(TunerStrategy):
    """A tuner that leaves the last fraction of the budget to something else.

    The search ends before the first batch that could touch the reserved steps, were all of its
    episodes to run to their time limit.
    """

    def __init__(self, tuner: Tuner, problem: Problem, fraction: float) -> None:
        """
        Args:
            tuner: Who searches; its own problem has the budget that is left for it.
            problem: What is tuned, with the whole budget.
            fraction: Of the budget, for what comes after the search.
        """
        super().__init__(tuner)
        self._problem, self._fraction = problem, fraction
        self._search_steps = search_budget(problem.budget, fraction)
        self._steps = 0
        # Where there is no time limit, episodes may be longer than those that were measured.
        self._longest = problem.max_episode_steps
        self._searching = True

    def ask(self) -> list[Proposal]:
        """Return what the tuner asks, while that is sure to leave the reserved steps."""
        if self._searching:
            proposals = super().ask() if self._steps < self._search_steps else []
            if proposals and self._steps + self._max_steps(proposals) <= self._search_steps:
                return proposals
            self._searching = False
            self._begin()
        return self._ask_after()

    def _max_steps(self, proposals: Sequence[Proposal]) -> int:
        whole = self._longest
        return sum(whole if p.horizon is None else min(p.horizon, whole) for p in proposals)

    @property
    def _left(self) -> int:
        """Environment steps that are left of the whole budget."""
        return self._problem.budget - self._steps

    @abstractmethod
    def _begin(self) -> None:
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
        self._longest = max(self._longest, *lengths)
        return super().tell(segments) if self._searching else self._tell_after(segments)

    def state(self) -> Any:
        """See `Tuner.state`."""
        counted = self._steps, self._longest, self._searching
        return {**super().state(), "counted": counted}

    def restore(self, state: Any) -> None:
        """See `Tuner.restore`."""
        super().restore(state)
        self._steps, self._longest, self._searching = state["counted"]


def search_budget(budget: int, fraction: float) -> int:
    """Return the environment steps that are left to the search."""
    return int(budget * (1.0 - fraction))
