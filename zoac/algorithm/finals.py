"""What is recommended: several answers of one run on common held-out episodes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from zoac.seeding import stream_seed
from zoac.segments import Proposal, Segment
from zoac.tuner import Problem


class Finals:
    """Whole episodes from common seeds, the same for every contender; the lowest mean cost wins.

    Where lanes cannot be put back, the episodes are the lanes' own.
    """

    def __init__(self, problem: Problem) -> None:
        self._problem = problem
        self._contenders = np.empty((0, problem.space.dimension))
        self._costs = np.empty((0, 0))  # (episodes, contenders)

    def enter(self, z: np.ndarray) -> None:
        """Take mapped parameters (d,) as one more contender; before the first episode only."""
        self._contenders = np.concatenate([self._contenders, z[None]])
        self._costs = np.empty((0, len(self._contenders)))

    @property
    def begun(self) -> bool:
        """Whether an episode has been run."""
        return len(self._costs) > 0

    @property
    def best(self) -> np.ndarray:
        """The mapped parameters (d,) of the contender that leads."""
        return self._contenders[int(np.argmin(self._costs.mean(axis=0)))].copy()

    def ask(self) -> list[Proposal]:
        """Return the next episodes of every contender."""
        lanes, done = self._problem.lanes, len(self._costs)
        episodes = range(done, done + max(1, lanes // len(self._contenders)))
        runs = [(episode, z) for episode in episodes for z in self._contenders]
        return [
            Proposal(z, i % lanes, seed=self._seed(episode)) for i, (episode, z) in enumerate(runs)
        ]

    def _seed(self, episode: int) -> int | None:
        if not self._problem.branches:
            return None
        return stream_seed(self._problem.seed, "finals", episode)

    def tell(self, segments: Sequence[Segment]) -> dict[str, float]:
        """Take the episodes' costs, in the order of the proposals."""
        costs = np.array([segment.costs.sum() for segment in segments])
        costs[~np.isfinite(costs)] = np.inf
        self._costs = np.concatenate([self._costs, costs.reshape(-1, len(self._contenders))])
        means = self._costs.mean(axis=0)
        return {"finals_best": int(np.argmin(means)), "finals_best_cost": float(means.min())}

    def state(self) -> tuple[np.ndarray, np.ndarray]:
        """Return a copy of contenders and costs."""
        return self._contenders.copy(), self._costs.copy()

    def restore(self, state: tuple[np.ndarray, np.ndarray]) -> None:
        """Put back what `state` returned."""
        self._contenders, self._costs = state[0].copy(), state[1].copy()
