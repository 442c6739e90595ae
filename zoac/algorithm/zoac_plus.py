"""ZOAC with what measurably helps: paired segments, chosen starts, robust advantages.

Not the paper's method, which `zoac.algorithm.zoac` keeps as published.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any

import numpy as np
from pydantic import Field

from zoac.algorithm.zoac import Zoac
from zoac.rollout import Proposal, Segment
from zoac.tuner import Problem

MAD_TO_STD = 1.4826
"""Median absolute deviation to standard deviation, for a normal distribution."""


class ZoacPlus(Zoac):
    """Zeroth-order actor-critic on pairs of branches.

    A lane runs N steps with theta + sigma epsilon, is put back to where it stood, and runs N steps
    with theta - sigma epsilon; the direction counts by half the difference of the two advantages.
    Start, disturbances and most of what the critic does not know are common to both and cancel.
    Both branches count as environment steps.
    """

    def __init__(
        self,
        problem: Problem,
        *,
        paired: bool = True,
        candidates: Annotated[int, Field(ge=0)] = 40,
        clip_advantages: Annotated[float, Field(gt=0)] | None = 3.0,
        **options: Any,
    ) -> None:
        """
        Args:
            problem: What is tuned.
            paired: Run every direction both ways from the same state.
            candidates: Random parameter vectors, one episode each, of which the best is where
                tuning starts; 0 starts as `start` says.
            clip_advantages: Scale by the median absolute deviation, as a standard deviation, and
                clip here; None leaves them as `standardise_advantages` says.
            options: Those of `Zoac`.
        """
        super().__init__(problem, **options)
        self._paired, self._clip = paired, clip_advantages
        self._count = candidates
        self._candidates = np.empty((0, problem.space.dimension))
        self._candidate_costs: list[float] = []
        if candidates:
            drawn = self._rng.uniform(-1.0, 1.0, (candidates, problem.space.dimension))
            # The start that `start` names is a candidate too.
            self._candidates = np.concatenate([self._theta[None], drawn])[:candidates]

    def ask(self) -> list[Proposal]:
        """Return episodes of the next candidates, and then pairs of segments."""
        tried = len(self._candidate_costs)
        if tried < self._count:
            batch = self._candidates[tried : tried + self._problem.lanes]
            return [Proposal(z=z, lane=i) for i, z in enumerate(batch)]
        return super().ask()

    def tell(self, segments: Sequence[Segment]) -> dict[str, float]:
        """Take the candidates' costs, and then update critic and parameters."""
        if len(self._candidate_costs) >= self._count:
            return super().tell(segments)
        costs = [float(s.costs.sum()) for s in segments]
        self._candidate_costs += [cost if np.isfinite(cost) else np.inf for cost in costs]
        best = int(np.argmin(self._candidate_costs))
        self._theta = self._candidates[best].copy()
        self._average = self._theta.copy()
        return {"best_candidate_cost": self._candidate_costs[best]}

    def _perturbed(self, offset: np.ndarray, lane: int) -> list[Proposal]:
        if not self._paired:
            return super()._perturbed(offset, lane)
        return [
            Proposal(z=self._theta + offset, lane=lane, horizon=self._length, branch=True),
            Proposal(z=self._theta - offset, lane=lane, horizon=self._length),
        ]

    def _weights(self, advantages: np.ndarray) -> np.ndarray:
        if self._paired:
            # Half the difference of the two branches: an estimate along epsilon, as eq. (10).
            advantages = (advantages[0::2] - advantages[1::2]) / 2
        if self._clip is None:
            return super()._weights(advantages)
        # A pair's difference is symmetric about no effect; single advantages are not.
        centre = 0.0 if self._paired else float(np.median(advantages))
        deviation = MAD_TO_STD * float(np.median(np.abs(advantages - centre))) + 1e-8
        return np.clip((advantages - centre) / deviation, -self._clip, self._clip)

    def state(self) -> dict[str, Any]:
        """Return everything that lasts between iterations."""
        return {**super().state(), "candidate_costs": list(self._candidate_costs)}

    def restore(self, state: Any) -> None:
        """Put back what `state` returned."""
        super().restore(state)
        self._candidate_costs = list(state["candidate_costs"])

    def describe(self) -> dict[str, Any]:
        """Return the choices that a comparison must show."""
        choices = super().describe()
        if self._count:
            choices["start"] = f"best of {self._count} random vectors, one episode each, counted"
        if self._paired:
            choices["noise_model"] = f"paired branches; {choices['noise_model']}"
        return choices
