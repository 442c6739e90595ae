"""How episodes are ranked: one rule for violated constraints and for costs that are not finite.

An episode has a violation, by how much it broke constraints, 0 if it broke none; and a cost. Less
violation is better, and at the same violation less cost (Deb 2000). A cost that is not finite,
minus infinity included, counts as a violation without bound: worse than everything else.

Methods that need one number per episode have two to choose from, `Outcomes.keys` and
`CostRange.prices`. Both rank as above. Where every episode holds all constraints and costs a finite
number, both are the costs themselves.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from zoac.core.segments import Segment
from zoac.core.types import bad_is_infinite

LARGEST = 1e20
"""Costs beyond are told as this. Nevergrad cuts what it is told at 5e20."""


def cost_sums(segments: Sequence[Segment]) -> np.ndarray:
    """Return what each segment costs in total, as tuners are told it, (n,)."""
    with np.errstate(invalid="ignore", over="ignore"):
        return np.array([segment.costs.sum() for segment in segments])


def ranking(violations: np.ndarray, costs: np.ndarray) -> np.ndarray:
    """Return the indices (n,) of outcomes, best first; ties stay in order.

    Args:
        violations: (n,), of one episode or mean over several.
        costs: (n,), likewise; what is not finite comes last.
    """
    costs = bad_is_infinite(costs)
    return np.lexsort((costs, violations, np.isinf(costs)))


def step_costs(costs: np.ndarray, worst: float) -> tuple[np.ndarray, float]:
    """Return finite costs of steps, for methods that learn from steps.

    Args:
        costs: (T,); what is not finite becomes the worst finite cost so far.
        worst: The worst before; 0 before any.

    Returns:
        The costs (T,), and the worst cost after them.
    """
    finite = np.isfinite(costs)
    worst = float(np.max(costs, where=finite, initial=worst))
    return np.where(finite, costs, worst), worst


@dataclass(frozen=True, eq=False, slots=True)
class Outcomes:
    """What n episodes came to.

    Args:
        violations: (n,); infinite where the cost is not finite.
        costs: (n,), within +-`LARGEST`.
    """

    violations: np.ndarray
    costs: np.ndarray

    @classmethod
    def of(cls, segments: Sequence[Segment]) -> Outcomes:
        """Return the outcomes of whole episodes."""
        costs = cost_sums(segments)
        violations = np.array([segment.violation for segment in segments])
        finite = np.isfinite(costs)
        return cls(
            np.where(finite, violations, np.inf),
            np.clip(np.where(finite, costs, LARGEST), -LARGEST, LARGEST),
        )

    @classmethod
    def none(cls) -> Outcomes:
        """Return no outcomes."""
        return cls(np.empty(0), np.empty(0))

    def __len__(self) -> int:
        return len(self.costs)

    def __getitem__(self, which: np.ndarray) -> Outcomes:
        return Outcomes(self.violations[which], self.costs[which])

    def __add__(self, later: Outcomes) -> Outcomes:
        return Outcomes(
            np.concatenate([self.violations, later.violations]),
            np.concatenate([self.costs, later.costs]),
        )

    @property
    def order(self) -> np.ndarray:
        """Indices (n,), best first."""
        return ranking(self.violations, self.costs)

    @property
    def feasible(self) -> np.ndarray:
        """Which (n,) hold all constraints and cost a finite number."""
        return self.violations == 0

    @property
    def severity(self) -> np.ndarray:
        """v / (1 + v), from 0 to 1, of each violation v."""
        with np.errstate(invalid="ignore"):
            severity = self.violations / (1.0 + self.violations)
        return np.where(np.isinf(self.violations), 1.0, severity)

    def keys(self) -> np.ndarray:
        """Return a number for each (n,) that no later outcome can overtake.

        For methods that compare and remember numbers. Of no use where differences matter: what
        breaks a constraint is `LARGEST` times 2 to 3.
        """
        return np.where(self.feasible, self.costs, LARGEST * (2.0 + self.severity))


@dataclass(slots=True)
class CostRange:
    """The range of the costs of feasible episodes so far."""

    low: float = np.inf
    high: float = -np.inf

    def add(self, outcomes: Outcomes) -> None:
        """Take in outcomes."""
        costs = outcomes.costs[outcomes.feasible]
        self.low = float(costs.min(initial=self.low))
        self.high = float(costs.max(initial=self.high))

    def prices(self, outcomes: Outcomes) -> np.ndarray:
        """Return a number for each (n,) of the size of the costs so far.

        For methods that learn from differences. A later costly episode can overtake, so prices of
        a whole history must be computed anew with the range of today. The worst are told as the
        worst feasible cost so far plus the range so far; as 0 before any is known.
        """
        if self.low > self.high:
            infeasible = 0.5 * (outcomes.severity - 1.0)
        else:
            span = (self.high - self.low) or abs(self.high) or 1.0
            infeasible = self.high + span * (0.5 * (1.0 + outcomes.severity))
        return np.where(outcomes.feasible, outcomes.costs, infeasible)
