"""Strategies for any tuner: an initial design, and common random numbers."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from zoac.core.seeding import stream_seed
from zoac.core.segments import Proposal, Segment
from zoac.core.tuner import Problem, Tuner
from zoac.rollout.outcomes import Outcomes
from zoac.strategies.base import TunerStrategy


class InitialDesign(TunerStrategy):
    """A tuner that begins at the best of some random points, one episode each.

    The points are uniform in the mapped box, their episodes begin alike, and their steps count.
    Until all of them have been run, the tuner is one that would begin in the middle.
    """

    def __init__(self, problem: Problem, count: int, begin: Callable[[Problem], Tuner]) -> None:
        """
        Args:
            problem: What is tuned.
            count: Number of points.
            begin: Makes the tuner for a problem with `start`, where to begin, and the budget that
                is left.
        """
        self._problem, self._begin = problem, begin
        self._points = problem.rng("initial_samples").uniform(
            -1.0, 1.0, (count, problem.space.dimension)
        )
        self._episodes = Outcomes.none()
        self._spent = 0
        super().__init__(self._make())

    def _make(self) -> Tuner:
        left = max(0, self._problem.budget - self._spent)
        return self._begin(replace(self._problem, start=self._best(), budget=left))

    @property
    def _sampling(self) -> bool:
        return len(self._episodes) < len(self._points)

    def ask(self) -> list[Proposal]:
        """Return the next points' episodes; then what the tuner asks."""
        if not self._sampling:
            return super().ask()
        seed = stream_seed(self._problem.seed, "initial_samples")
        done = len(self._episodes)
        points = self._points[done : done + self._problem.num_envs]
        return [Proposal(x, env_index, seed=seed) for env_index, x in enumerate(points)]

    def tell(self, segments: Sequence[Segment]) -> dict[str, float]:
        """Take the points' costs; then pass on what the tuner asked for."""
        if not self._sampling:
            return super().tell(segments)
        self._episodes += Outcomes.of(segments)
        self._spent += sum(segment.length for segment in segments)
        if not self._sampling:
            self._tuner = self._make()
        best = self._episodes[self._episodes.order[:1]]
        return (
            {"initial_best_cost": float(best.costs[0])} if np.isfinite(best.violations[0]) else {}
        )

    def _best(self) -> np.ndarray:
        if not len(self._episodes):
            return np.zeros(self._problem.space.dimension)
        return self._points[self._episodes.order[0]].copy()

    def recommend(self) -> np.ndarray:
        """Return the best point so far, then the tuner's recommendation."""
        return self._best() if self._sampling else super().recommend()

    def state(self) -> Any:
        """See `Tuner.state`."""
        return {"episodes": self._episodes.state(), "spent": self._spent, **super().state()}

    def restore(self, state: Any) -> None:
        """See `Tuner.restore`."""
        self._episodes, self._spent = Outcomes(*state["episodes"]), state["spent"]
        self._tuner = self._make()
        super().restore(state)

    def describe(self) -> dict[str, Any]:
        """Return the tuner's choices, its start replaced."""
        return {**super().describe(), "start": f"best of {len(self._points)} random points"}


class CommonRandomNumbers(TunerStrategy):
    """A tuner of whole episodes whose points of one batch all meet the same episode.

    Differences within a batch are then the points' own. Every batch has another episode.
    """

    def __init__(self, tuner: Tuner, seed: int) -> None:
        """
        Args:
            tuner: Who tunes. What it asks for otherwise (segments, episodes of its own choice) is
                left as it is.
            seed: The run's seed.
        """
        super().__init__(tuner)
        self._seed, self._batch = seed, 0

    def ask(self) -> list[Proposal]:
        """Return what the tuner asks, whole episodes from a common seed."""
        seed = stream_seed(self._seed, "common", self._batch)
        self._batch += 1
        return [
            replace(p, seed=seed) if p.horizon is None and p.seed is None else p
            for p in super().ask()
        ]

    def state(self) -> Any:
        """See `Tuner.state`."""
        return {"batch": self._batch, **super().state()}

    def restore(self, state: Any) -> None:
        """See `Tuner.restore`."""
        self._batch = state["batch"]
        super().restore(state)

    def describe(self) -> dict[str, Any]:
        """See `Tuner.describe`."""
        return {**super().describe(), "episodes": "common to a batch"}
