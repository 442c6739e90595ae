"""ZOAC with what measurably helps: a race for the start, paired segments, finals.

Not the paper's method, which `zoac.algorithm.zoac` keeps as published. `docs/beyond.md` tells what
each part brings.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any

import numpy as np
from pydantic import Field

from zoac.algorithm.race import Race
from zoac.algorithm.zoac import Fraction, Zoac
from zoac.held_out import HeldOut
from zoac.numbers import Count
from zoac.segments import Proposal, Segment
from zoac.tuner import Problem

SHRINK, RECOVER = 0.5, 1.05
"""Of perturbation and step, after an iteration with too many terminations and after any other."""


class ZoacPlus(Zoac):
    """Zeroth-order actor-critic on pairs of branches, from the winner of a race.

    A lane runs N steps with theta + sigma epsilon, is put back to where it stood, and runs N steps
    with theta - sigma epsilon; the direction counts by half the difference of the two advantages.
    Start, disturbances and most of what the critic does not know are common to both and cancel.
    Both branches count as environment steps, and so do race and finals.

    Perturbation and step stay as they are. The last part of the budget decides on common held-out
    episodes between the winner of the race, averages of the iterates and the baseline, if any.

    Where an environment cannot be put back (`Problem.branches`), directions are run one way, and
    race and finals on the lanes' own episodes.
    """

    def __init__(
        self,
        problem: Problem,
        *,
        paired: bool = True,
        race_share: Fraction = 0.4,
        race_rounds: Count = 6,
        race_survivors: Fraction | None = None,
        finals_share: Fraction = 0.1,
        finals_entries: Count = 3,
        tolerated_terminations: Annotated[float, Field(ge=0, lt=1)] | None = None,
        **options: Any,
    ) -> None:
        """
        Args:
            problem: What is tuned.
            paired: Run every direction both ways from the same state.
            race_share: Part of the budget for finding a start; 0 starts as `start` says.
            race_rounds: Rounds of the race, with horizons that grow to a whole episode.
            race_survivors: Part of each round's field that the last round's best make up; the rest
                are their children. Few survivors suit few parameters; None: by their number.
            finals_share: Part of the budget for held-out episodes on which the recommendation is
                chosen; 0 recommends as `recommend` says.
            finals_entries: Averages of the iterates that meet the winner of the race there, taken
                at equal distances.
            tolerated_terminations: Part of an iteration's segments that may end in termination;
                above it perturbation and step shrink, below it they come back. None: any. For
                careful tuning from known gains: no race, which tries the whole box.
            options: Those of `Zoac`.
        """
        super().__init__(problem, **options)
        self._widest = self._sigma
        self._paired = paired and problem.branches
        self._tolerated, self._caution = tolerated_terminations, 1.0
        self._race = Race(
            problem,
            self._rng,
            self._theta,
            share=race_share,
            rounds=race_rounds,
            survivors=race_survivors,
        )
        self._finals = HeldOut(problem, "finals", seeded=problem.branches)
        if self._race.over:
            self._finals.enter(self._theta)
        self._entries, self._entered = finals_entries, 0
        self._spent, self._search_from = 0, 0
        self._search_to = problem.budget * (1.0 - finals_share)
        self._race_share, self._finals_share = race_share, finals_share

    @property
    def progress(self) -> float:
        """How far between race and finals, from 0 to 1."""
        whole = max(1.0, self._search_to - self._search_from)
        return min(1.0, (self._spent - self._search_from) / whole)

    @property
    def step_size(self) -> float:
        """Shrinks with terminations, if so told."""
        return self._caution * super().step_size

    @property
    def _in_finals(self) -> bool:
        if not self._race.over or not self._finals_share:
            return False
        # A small budget: another iteration would leave too few steps to choose by.
        iteration = self._segments * self._length * self._problem.lanes * (1 + self._paired)
        left = self._problem.budget - self._spent - iteration
        few = self._spent > 0 and left < self._finals.steps(self._finals.busy)
        return self._finals.begun or self._spent >= self._search_to or few

    def ask(self) -> list[Proposal]:
        """Return the race's next round, then pairs of segments, then the finals' episodes."""
        if not self._race.over:
            return self._race.ask()
        if self._in_finals:
            if not self._finals.begun:
                self._finals.enter_baseline()
            return self._finals.ask_within(self._problem.budget - self._spent)
        self._sigma = self._caution * self._widest
        return super().ask()

    def tell(self, segments: Sequence[Segment]) -> dict[str, float]:
        """Hand what came back to the part that asked for it."""
        steps = sum(segment.length for segment in segments)
        if not self._race.over:
            self._spent += steps
            return self._tell_race(segments)
        if self._in_finals:
            self._spent += steps
            return self._tell_finals(segments)
        numbers = super().tell(segments)
        self._spent += steps
        self._be_careful(segments)
        while self._entered + 1 <= self._entries * self.progress + 1e-9:
            self._entered += 1
            self._finals.enter(self._average)
        return {**numbers, "sigma": self._sigma}

    def _be_careful(self, segments: Sequence[Segment]) -> None:
        if self._tolerated is None:
            return
        if np.mean([segment.terminated for segment in segments]) > self._tolerated:
            self._caution *= SHRINK
        else:
            self._caution = min(1.0, self._caution * RECOVER)

    def _tell_race(self, segments: Sequence[Segment]) -> dict[str, float]:
        numbers = self._race.tell(segments)
        self._theta = self._race.best
        self._average = self._theta.copy()
        if self._race.over:
            self._search_from = self._spent
            self._finals.enter(self._theta)
        return numbers

    def _tell_finals(self, segments: Sequence[Segment]) -> dict[str, float]:
        self._finals.tell(segments)
        best = int(self._finals.ranking[0])
        cost = float(self._finals.costs[:, best].mean())
        return {"finals_best": best, "finals_best_cost": cost}

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
        return super()._weights(advantages)

    def recommend(self) -> np.ndarray:
        """Return who leads the finals; before them, the race's leader or the average."""
        return self._finals.best if self._finals.begun else super().recommend()

    def state(self) -> dict[str, Any]:
        """Return everything that lasts between iterations."""
        return {
            **super().state(),
            "race": self._race.state(),
            "finals": self._finals.state(),
            "progress": (self._spent, self._search_from, self._entered),
            "caution": self._caution,
        }

    def restore(self, state: Any) -> None:
        """Put back what `state` returned."""
        super().restore(state)
        self._race.restore(state["race"])
        self._finals.restore(state["finals"])
        self._spent, self._search_from, self._entered = state["progress"]
        self._caution = state["caution"]

    def describe(self) -> dict[str, Any]:
        """Return the choices that a comparison must show."""
        choices = super().describe()
        if self._race_share:
            among = ", the start values take part" if self._start == "nominal" else ""
            choices["start"] = f"race, {self._race_share:.0%} of the budget{among}"
        if self._paired:
            choices["noise_model"] = f"paired branches; {choices['noise_model']}"
        if self._finals_share:
            baseline = "" if self._problem.baseline is None else " and the start values"
            choices["recommendation"] = (
                f"best of {self._entries + 1}{baseline} on common held-out episodes, "
                f"{self._finals_share:.0%} of the budget"
            )
        return choices
