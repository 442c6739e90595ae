"""Strategies for any tuner: an initial design, and common random numbers."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from zoac.algorithm.strategies.base import Begin, StartSearch, TunerStrategy
from zoac.core.seeding import stream_seed
from zoac.core.segments import Proposal, Segment
from zoac.core.tuner import Problem
from zoac.core.types import Count
from zoac.rollout.outcomes import Outcomes


class InitialDesign(StartSearch):
    """A tuner that begins at the best of some random points, one episode each.

    The points are uniform in the mapped box, and their episodes begin alike.
    """

    kept = "_episodes"

    def __init__(self, problem: Problem, begin: Begin, *, count: Count) -> None:
        """
        Args:
            count: Number of points.
        """
        self._points = problem.rng("initial_samples").uniform(
            -1.0, 1.0, (count, problem.space.dimension)
        )
        self._episodes = Outcomes.none()
        super().__init__(problem, begin)

    @property
    def _looking(self) -> bool:
        return len(self._episodes) < len(self._points)

    def _best(self) -> np.ndarray:
        if not len(self._episodes):
            return np.zeros(self._points.shape[1])
        return self._points[self._episodes.order[0]].copy()

    def _ask_start(self) -> list[Proposal]:
        seed = stream_seed(self._problem.seed, "initial_samples")
        done = len(self._episodes)
        points = self._points[done : done + self._problem.num_envs]
        return [Proposal(x, env_index, seed=seed) for env_index, x in enumerate(points)]

    def _tell_start(self, segments: Sequence[Segment]) -> dict[str, float]:
        self._episodes += Outcomes.of(segments)
        best = self._episodes[self._episodes.order[:1]]
        return (
            {"initial_best_cost": float(best.costs[0])} if np.isfinite(best.violations[0]) else {}
        )

    def describe(self) -> dict[str, Any]:
        """Return the tuner's choices, its start replaced."""
        return {**super().describe(), "start": f"best of {len(self._points)} random points"}


class CommonRandomNumbers(TunerStrategy):
    """A tuner of whole episodes whose points of one batch all meet the same episode.

    Differences within a batch are then the points' own. Every batch has another episode. Segments,
    and episodes of the tuner's own choice, are left as they are.
    """

    kept = "_batch"

    def __init__(self, problem: Problem, begin: Begin) -> None:
        super().__init__(problem, begin)
        self._batch = 0

    def ask(self) -> list[Proposal]:
        """Return what the tuner asks, whole episodes from a common seed."""
        seed = stream_seed(self._problem.seed, "common", self._batch)
        self._batch += 1
        return [
            replace(p, seed=seed) if p.horizon is None and p.seed is None else p
            for p in super().ask()
        ]

    def describe(self) -> dict[str, Any]:
        return {**super().describe(), "episodes": "common to a batch"}
