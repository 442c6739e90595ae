"""Constraints, for every tuner in the same way: feasibility first.

A step that violates a constraint j by an excess g > 0 is told to the tuner as costlier, by

    M (1 + v / (1 + v)),   v = g / scale_j,

where M is the range of the episode costs that this run has seen so far. So an episode with any
violation is told as worse than every one without that was seen before, and of two that violate,
the one that does so at more steps, or by more, as worse: Deb's rules (2000), taken step by step, so
that tuners that see segments (ZOAC) and tuners that see episodes are told the same. There is no
weight to set by hand. What improves on the best feasible episode improves on all infeasible ones
told before too, so a tuner that remembers costs is not led back to one.

Reported costs are never changed; violations are counted beside them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from zoac.segments import Segment
from zoac.task import Constraint


def excess(segment: Segment, constraints: Sequence[Constraint]) -> np.ndarray:
    """Return by how much each constraint is violated at each step, (T, C); 0 where it holds.

    What is not finite counts as a violation without bound. A step that failed violates nothing:
    it was not measured, and has its own price, the task's `failure_penalty`.

    Raises:
        ConfigError: If a constraint does not return one number per step.
    """
    measured = segment.measured()
    amounts = np.zeros((segment.length, len(constraints)))
    if measured.length:
        values = np.stack([c.values(measured).astype(np.float64) for c in constraints], axis=1)
        amounts[: measured.length] = np.where(np.isfinite(values), np.maximum(values, 0.0), np.inf)
    return amounts


def violations(segments: Sequence[Segment], constraints: Sequence[Constraint]) -> dict[str, Any]:
    """Return what is counted of violations in evaluation episodes; {} without constraints.

    Returns:
        `violations`, the number of episodes that violate any constraint, and
        `violations_by_constraint`: name -> `episodes`, `steps`, `worst` excess.
    """
    if not constraints:
        return {}
    amounts = [excess(segment, constraints) for segment in segments]
    return {
        "violations": sum(bool(amount.any()) for amount in amounts),
        "violations_by_constraint": {
            constraint.name: {
                "episodes": sum(bool(amount[:, j].any()) for amount in amounts),
                "steps": int(sum(np.count_nonzero(amount[:, j]) for amount in amounts)),
                "worst": float(max(amount[:, j].max() for amount in amounts)),
            }
            for j, constraint in enumerate(constraints)
        },
    }


class FeasibilityFirst:
    """What tuners are told of segments under constraints; see the module's text."""

    def __init__(self, constraints: Sequence[Constraint]) -> None:
        self._constraints = tuple(constraints)
        self._scales = np.array([c.scale for c in constraints])
        self._totals: dict[int, float] = {}  # of each lane's episode so far
        self._low = self._high = 0.0

    @property
    def price(self) -> float:
        """M: the range of episode costs so far; 1 while there is none."""
        return (self._high - self._low) or 1.0

    def told(self, segments: Sequence[Segment], seen: Sequence[Segment]) -> list[Segment]:
        """Return `seen` with the price of violations.

        Args:
            segments: What the lanes did, in their order.
            seen: The same with the costs that the tuner would be told.
        """
        if not self._constraints:
            return list(seen)
        for segment in seen:
            self._watch(segment)
        return [self._charged(o, s) for o, s in zip(segments, seen, strict=True)]

    def _charged(self, original: Segment, seen: Segment) -> Segment:
        charge = self._charge(original)
        violation = float(charge.sum()) / self.price
        return replace(seen, costs=seen.costs + charge, violation=violation)

    def _watch(self, segment: Segment) -> None:
        """Let the range of episode costs take in a segment."""
        lane, aside = segment.proposal.lane, segment.proposal.seed is not None
        before = 0.0 if segment.starts_episode or aside else self._totals.get(lane, 0.0)
        total = before + float(segment.costs.sum())
        if np.isfinite(total):
            self._low, self._high = min(self._low, total), max(self._high, total)
        if not (aside or segment.proposal.branch):
            self._totals[lane] = total

    def _charge(self, segment: Segment) -> np.ndarray:
        amounts = excess(segment, self._constraints)
        with np.errstate(invalid="ignore"):
            share = amounts / (amounts + self._scales)  # v / (1 + v)
        share = np.where(np.isinf(amounts), 1.0, share)
        return self.price * np.where(amounts > 0, 1.0 + share, 0.0).sum(axis=1)

    def state(self) -> Any:
        """Return a copy of everything that `told` depends on."""
        return dict(self._totals), self._low, self._high

    def restore(self, state: Any) -> None:
        """Put back what `state` returned."""
        totals, self._low, self._high = state
        self._totals = dict(totals)
