"""ZOAC with what measurably helps: a race for the start, paired segments, finals.

Not the paper's method, which `zoac.algorithm.zoac` keeps as published. `docs/beyond.md` tells what
each part brings.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any

import numpy as np
from pydantic import Field

from zoac.algorithm.zoac import UnitInterval, Zoac
from zoac.core.segments import Proposal, Segment
from zoac.core.tuner import Problem
from zoac.core.types import Count
from zoac.strategies.held_out import HeldOut
from zoac.strategies.successive_halving import SuccessiveHalving

SHRINK, RECOVER = 0.5, 1.05
"""Of perturbation and step, after an iteration with too many terminations and after any other."""


class ZoacPlus(Zoac):
    """Zeroth-order actor-critic on pairs of branches, from the winner of a race.

    An environment runs N steps with theta + sigma epsilon, is put back to where it stood, and runs
    N steps with theta - sigma epsilon; the direction counts by half the difference of the two
    advantages. Start, disturbances and most of what the critic does not know are common to both and
    cancel. Both branches count as environment steps, and so do race and finals.

    Perturbation and step stay as they are. The last part of the budget decides on common held-out
    episodes between the winner of the race, averages of the iterates and the baseline, if any.

    Where an environment cannot be put back (`Problem.supports_snapshots`), directions are run one
    way, and race and finals on the environments' own episodes.
    """

    def __init__(
        self,
        problem: Problem,
        *,
        paired: bool = True,
        halving_fraction: UnitInterval = 0.4,
        halving_rounds: Count = 6,
        halving_survivors: UnitInterval | None = None,
        selection_fraction: UnitInterval = 0.1,
        selection_candidates: Count = 3,
        max_termination_rate: Annotated[float, Field(ge=0, lt=1)] | None = None,
        **options: Any,
    ) -> None:
        """
        Args:
            problem: What is tuned.
            paired: Run every direction both ways from the same state.
            halving_fraction: Part of the budget for finding a start; 0 starts as `start` says.
            halving_rounds: Rounds of the race, with horizons that grow to a whole episode.
            halving_survivors: Part of each round's field that the last round's best make up; the
                rest are their children. Few survivors suit few parameters; None: by their number.
            selection_fraction: Part of the budget for held-out episodes on which the recommendation
                is chosen; 0 recommends as `recommend` says.
            selection_candidates: Averages of the iterates that meet the winner of the race there,
                taken at equal distances.
            max_termination_rate: Part of an iteration's segments that may end in termination;
                above it perturbation and step shrink, below it they come back. None: any. For
                careful tuning from known gains: no race, which tries the whole box.
            options: Those of `Zoac`.
        """
        super().__init__(problem, **options)
        self._widest = self._sigma
        self._paired = paired and problem.supports_snapshots
        self._max_termination_rate, self._safety = max_termination_rate, 1.0
        self._halving = SuccessiveHalving(
            problem,
            self._rng,
            self._theta,
            fraction=halving_fraction,
            rounds=halving_rounds,
            survivor_fraction=halving_survivors,
        )
        self._selection = HeldOut(problem, "finals", seeded=problem.supports_snapshots)
        if self._halving.over:
            self._selection.enter(self._theta)
        self._entries, self._entered = selection_candidates, 0
        self._spent, self._search_from = 0, 0
        self._search_to = problem.budget * (1.0 - selection_fraction)
        self._halving_fraction, self._selection_fraction = halving_fraction, selection_fraction

    @property
    def progress(self) -> float:
        """How far between race and finals, from 0 to 1."""
        whole = max(1.0, self._search_to - self._search_from)
        return min(1.0, (self._spent - self._search_from) / whole)

    @property
    def step_size(self) -> float:
        """Shrinks with terminations, if so told."""
        return self._safety * super().step_size

    @property
    def _in_selection(self) -> bool:
        if not self._halving.over or not self._selection_fraction:
            return False
        # A small budget: another iteration would leave too few steps to choose by.
        iteration = self._segments * self._length * self._problem.num_envs * (1 + self._paired)
        left = self._problem.budget - self._spent - iteration
        few = self._spent > 0 and left < self._selection.steps(self._selection.busy)
        return self._selection.begun or self._spent >= self._search_to or few

    def ask(self) -> list[Proposal]:
        """Return the race's next round, then pairs of segments, then the finals' episodes."""
        if not self._halving.over:
            return self._halving.ask()
        if self._in_selection:
            if not self._selection.begun:
                self._selection.enter_baseline()
            return self._selection.ask_within(self._problem.budget - self._spent)
        self._sigma = self._safety * self._widest
        return super().ask()

    def tell(self, segments: Sequence[Segment]) -> dict[str, float]:
        """Hand what came back to the part that asked for it."""
        steps = sum(segment.length for segment in segments)
        if not self._halving.over:
            self._spent += steps
            return self._tell_halving(segments)
        if self._in_selection:
            self._spent += steps
            return self._tell_finals(segments)
        numbers = super().tell(segments)
        self._spent += steps
        self._adapt_to_terminations(segments)
        while self._entered + 1 <= self._entries * self.progress + 1e-9:
            self._entered += 1
            self._selection.enter(self._average)
        return {**numbers, "sigma": self._sigma}

    def _adapt_to_terminations(self, segments: Sequence[Segment]) -> None:
        if self._max_termination_rate is None:
            return
        if np.mean([segment.terminated for segment in segments]) > self._max_termination_rate:
            self._safety *= SHRINK
        else:
            self._safety = min(1.0, self._safety * RECOVER)

    def _tell_halving(self, segments: Sequence[Segment]) -> dict[str, float]:
        numbers = self._halving.tell(segments)
        self._theta = self._halving.best
        self._average = self._theta.copy()
        if self._halving.over:
            self._search_from = self._spent
            self._selection.enter(self._theta)
        return numbers

    def _tell_finals(self, segments: Sequence[Segment]) -> dict[str, float]:
        self._selection.tell(segments)
        best = int(self._selection.ranking[0])
        cost = float(self._selection.costs[:, best].mean())
        return {"selection_best": best, "selection_best_cost": cost}

    def _perturbed(self, offset: np.ndarray, env_index: int) -> list[Proposal]:
        if not self._paired:
            return super()._perturbed(offset, env_index)
        return [
            Proposal(
                x=self._theta + offset, env_index=env_index, horizon=self._length, restore=True
            ),
            Proposal(x=self._theta - offset, env_index=env_index, horizon=self._length),
        ]

    def _weights(self, advantages: np.ndarray) -> np.ndarray:
        if self._paired:
            # Half the difference of the two branches: an estimate along epsilon, as eq. (10).
            advantages = (advantages[0::2] - advantages[1::2]) / 2
        return super()._weights(advantages)

    def recommend(self) -> np.ndarray:
        """Return who leads the finals; before them, the race's leader or the average."""
        return self._selection.best if self._selection.begun else super().recommend()

    def state(self) -> dict[str, Any]:
        """Return everything that lasts between iterations."""
        return {
            **super().state(),
            "race": self._halving.state(),
            "finals": self._selection.state(),
            "progress": (self._spent, self._search_from, self._entered),
            "caution": self._safety,
        }

    def restore(self, state: Any) -> None:
        """Put back what `state` returned."""
        super().restore(state)
        self._halving.restore(state["race"])
        self._selection.restore(state["finals"])
        self._spent, self._search_from, self._entered = state["progress"]
        self._safety = state["caution"]

    def describe(self) -> dict[str, Any]:
        """Return the choices that a comparison must show."""
        choices = super().describe()
        if self._halving_fraction:
            among = ", the baseline values take part" if self._start == "baseline" else ""
            choices["start"] = f"race, {self._halving_fraction:.0%} of the budget{among}"
        if self._paired:
            choices["noise_model"] = f"paired branches; {choices['noise_model']}"
        if self._selection_fraction:
            baseline = "" if self._problem.baseline is None else " and the baseline values"
            choices["recommendation"] = (
                f"best of {self._entries + 1}{baseline} on common held-out episodes, "
                f"{self._selection_fraction:.0%} of the budget"
            )
        return choices
