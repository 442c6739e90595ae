"""Candidates for the answer, compared on the same held-out episodes."""

from collections.abc import Sequence

import numpy as np

from zoac.core.seeding import stream_seed
from zoac.core.segments import Proposal, Segment
from zoac.core.state import Kept
from zoac.core.tuner import Problem
from zoac.core.types import bad_is_infinite
from zoac.rollout.outcomes import cost_sums, ranking


class HeldOut(Kept):
    """Whole episodes from common seeds, the same for every candidate.

    Plain costs are compared, whatever a tuner is told. Where constraints are violated, the least
    violation comes first and the lowest mean cost second.
    """

    kept = "_candidates costs violations failed"

    def __init__(self, problem: Problem, name: str) -> None:
        """
        Args:
            name: Of the stream that the episodes' seeds come from; no other part of a run has it.
        """
        self._problem, self._name = problem, name
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
            Proposal(x, i % num_envs, seed=stream_seed(self._problem.seed, self._name, episode))
            for i, (episode, x) in enumerate(runs)
        ]

    def ask_within(self, steps: int) -> list[Proposal]:
        """Return as many of the next episodes as keep all busy and fit in `steps`, at least one."""
        side_by_side = self._problem.num_envs // len(self._candidates)
        return self.ask(max(1, min(side_by_side, steps // self.steps(1))))

    def steps(self, episodes: int) -> int:
        """Return the steps that so many episodes of every candidate take at most."""
        return episodes * len(self._candidates) * self._problem.max_episode_steps

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
