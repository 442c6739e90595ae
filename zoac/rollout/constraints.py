"""Constraints, for every tuner in the same way: feasibility first.

The excess g of a constraint j at a step is told relative to its scale: v = g / scale_j (see
`Constraint`). An episode's, or segment's, `violation` is the sum of 1 + v / (1 + v) over its steps
and constraints with any excess: more steps or more excess are worse, and no violation is 0.

Tuners that see episodes rank by it first and by cost second: Deb's rules (2000). So every episode
that breaks a constraint is behind every one that does not, whatever costs come earlier or later
(`zoac.rollout.outcomes`).

Tuners that learn from steps (ZOAC) see costs alone. There a step with violation w costs M w more, M
being the range of what whole episodes have cost so far. Costs that come later may widen that range;
steps told before keep their price.

A hard spec that a whole episode breaks (`zoac.specs`) adds 1 + v / (1 + v) once to the episode's
violation, v being the excess relative to the limit. An episode that ends early breaks each by more,
the earlier the more. Only tuners that see episodes can be used then. Where an objective of specs is
infinite, they are told this violation and no cost.

Reported costs are never changed; violations are counted beside them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from zoac.core.measures import Constraint
from zoac.core.segments import Segment
from zoac.specs import judge, verdict
from zoac.specs.spec import Spec


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
        amounts[: measured.length] = np.stack([c.excess(measured) for c in constraints], axis=1)
    return amounts


def violations(
    segments: Sequence[Segment], constraints: Sequence[Constraint], specs: Sequence[Spec] = ()
) -> dict[str, Any]:
    """Return what is counted of violations in evaluation episodes; {} without any requirement.

    Returns:
        `violations`, the number of episodes that violate any constraint or break any hard spec;
        `violations_by_constraint`: name -> `episodes`, `steps`, `worst` excess; and `by_spec`: see
        `zoac.specs.verdict.over_episodes`.
    """
    broken = [segment.violation > 0 for segment in segments]  # hard specs, as rolled out
    told: dict[str, Any] = {}
    if specs:
        told = {"violations": sum(broken), "by_spec": verdict.over_episodes(segments, specs)}
    if not constraints:
        return told
    amounts = [excess(segment, constraints) for segment in segments]
    return {
        **told,
        "violations": sum(bool(a.any()) or b for a, b in zip(amounts, broken, strict=True)),
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

    def __init__(self, constraints: Sequence[Constraint], specs: Sequence[Spec] = ()) -> None:
        self._constraints, self._specs = tuple(constraints), tuple(specs)
        self._objective = not all(spec.hard for spec in specs)
        self._scales = np.array([c.scale or abs(c.limit) for c in constraints])  # 0: the largest
        self._largest = np.zeros(len(constraints))  # finite excess so far
        self._totals: dict[int, float] = {}  # of each environment's episode so far
        self._low, self._high = np.inf, -np.inf  # of whole episodes
        self._size = 0.0  # largest total of a part of an episode

    @property
    def price(self) -> float:
        """M: the range of what whole episodes cost so far.

        Where there is none, their size; before the first has ended, that of parts; else 1.
        """
        if self._low > self._high:
            return self._size or 1.0
        return (self._high - self._low) or abs(self._high) or 1.0

    def told(self, segments: Sequence[Segment], seen: Sequence[Segment]) -> list[Segment]:
        """Return `seen` with violations and their price.

        Args:
            segments: What the environments did, in their order.
            seen: The same with the costs that the tuner would be told.

        Raises:
            ConfigError: If there are specs, and a segment is a part of an episode.
        """
        if self._specs:
            judge.need_episodes(segments)
        told = self._priced(segments, seen) if self._constraints else list(seen)
        return judge.comparable(told) if self._objective else told

    def _priced(self, segments: Sequence[Segment], seen: Sequence[Segment]) -> list[Segment]:
        """Return `seen` with violations of constraints and their price."""
        for segment in seen:
            self._watch(segment)
        amounts = [excess(segment, self._constraints) for segment in segments]
        together = np.concatenate(amounts)
        largest = together.max(axis=0, where=np.isfinite(together), initial=0.0)
        self._largest = np.maximum(self._largest, largest)
        violations = map(self._violations, amounts)
        return [
            replace(s, costs=s.costs + self.price * v, violation=s.violation + float(v.sum()))
            for s, v in zip(seen, violations, strict=True)
        ]

    def _watch(self, segment: Segment) -> None:
        """Let the range of episode costs take in a segment."""
        env_index, aside = segment.proposal.env_index, segment.proposal.seed is not None
        before = 0.0 if segment.starts_episode or aside else self._totals.get(env_index, 0.0)
        total = before + float(segment.costs.sum())
        if np.isfinite(total):
            self._size = max(self._size, abs(total))
            if segment.terminated or segment.truncated:
                self._low, self._high = min(self._low, total), max(self._high, total)
        if not (aside or segment.proposal.restore):
            self._totals[env_index] = total

    def _violations(self, amounts: np.ndarray) -> np.ndarray:
        """Return the violation (T,) of each step from its excesses (T, C)."""
        scales = np.where(self._scales > 0, self._scales, self._largest)
        with np.errstate(invalid="ignore"):
            severity = amounts / (amounts + scales)  # v / (1 + v)
        severity = np.where(np.isinf(amounts), 1.0, severity)
        return np.where(amounts > 0, 1.0 + severity, 0.0).sum(axis=1)

    def state(self) -> dict[str, Any]:
        """Return a copy of everything that `told` depends on."""
        return {
            "totals": dict(self._totals),
            "range": (self._low, self._high, self._size),
            "largest": self._largest.copy(),
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Restore what `state` returned."""
        self._totals = dict(state["totals"])
        self._low, self._high, self._size = state["range"]
        self._largest = state["largest"].copy()
