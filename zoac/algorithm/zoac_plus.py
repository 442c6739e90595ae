"""ZOAC with successive halving for the start, paired segments and a final selection.

Not the paper's method, which `zoac.algorithm.zoac` keeps as published. `docs/beyond.md` shows what
each part brings.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field

from zoac.algorithm.options import CriticOptions, Exploration, StepSize
from zoac.algorithm.zoac import UnitInterval, Zoac
from zoac.core.segments import Proposal, Segment
from zoac.core.tuner import Problem
from zoac.core.types import Count
from zoac.strategies.held_out import HeldOut
from zoac.strategies.successive_halving import SuccessiveHalving

SHRINK, RECOVER = 0.5, 1.05
"""Of perturbation and step, after an iteration with too many terminations and after any other."""


class ZoacPlus(Zoac):
    """Zeroth-order actor-critic on pairs of segments, from a start found by successive halving.

    An environment runs N steps with theta + sigma epsilon, is restored, and runs N steps with
    theta - sigma epsilon. The direction counts by half the difference of the two advantages. Start,
    disturbances and most of the critic's error are common to both segments and cancel. Every
    segment counts as environment steps, and so do successive halving and final selection.

    Perturbation and step size are those of ZOAC. The last fraction of the budget decides on common
    held-out episodes between the start, averages of the iterates and the baseline, if any.

    Where an environment cannot be restored (`Problem.supports_snapshots`), directions run one way,
    and successive halving and final selection use the environments' own episodes.
    """

    def __init__(
        self,
        problem: Problem,
        *,
        exploration: Exploration = Exploration(segment_length=50, segments=2, sigma=0.07),
        step_size: StepSize = StepSize(first=3e-2, last=None, slope=0.0),
        critic: CriticOptions = CriticOptions((64, 64), epochs=5, normalise_observations=True),
        recommend: Literal["last", "average"] = "average",
        average_decay: UnitInterval = 0.9,
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
            exploration: See `Zoac`.
            step_size: See `Zoac`.
            critic: See `Zoac`.
            recommend: The last iterate, or an exponential average of the iterates, where no part of
                the budget is for a final selection.
            average_decay: Decay of that average per iteration.
            paired: Run every direction both ways from the same state.
            halving_fraction: Of the budget, for finding a start; 0 starts as `start` says.
            halving_rounds: Rounds of successive halving, with horizons that grow to an episode.
            halving_survivors: Which fraction of a round are the last round's best; the rest are
                their offspring. Few survivors suit few parameters; None: by their number.
            selection_fraction: Of the budget, for held-out episodes on which the recommendation is
                chosen; 0 recommends as `recommend` says.
            selection_candidates: Averages of the iterates among the candidates, taken at equal
                distances.
            max_termination_rate: Fraction of an iteration's segments that may terminate. Above it
                perturbation and step shrink, below it they grow back. None: any. For safe
                exploration from known gains, with halving_fraction=0: halving tries the whole box.
            options: Other options of `Zoac`.
        """
        super().__init__(
            problem,
            exploration=exploration,
            step_size=step_size,
            critic=critic,
            recommend=recommend,
            average_decay=average_decay,
            **options,
        )
        self._paired = paired and problem.supports_snapshots
        self._max_termination_rate, self._shrinkage = max_termination_rate, 1.0
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
        self._selecting = False
        self._averages, self._entered = selection_candidates, 0
        self._spent, self._search_from = 0, 0
        self._search_to = problem.budget * (1.0 - selection_fraction)
        self._halving_fraction, self._selection_fraction = halving_fraction, selection_fraction

    @property
    def progress(self) -> float:
        """How far between successive halving and final selection, from 0 to 1."""
        whole = max(1.0, self._search_to - self._search_from)
        return min(1.0, (self._spent - self._search_from) / whole)

    @property
    def step_size(self) -> float:
        """ZOAC's step size, smaller after many terminations if `max_termination_rate` is set."""
        return self._shrinkage * super().step_size

    @property
    def _in_selection(self) -> bool:
        if not self._halving.over or not self._selection_fraction:
            return False
        # A small budget: another iteration would leave too few steps to choose by.
        segment = self._exploration.segment_length * self._problem.num_envs * (1 + self._paired)
        iteration = self._exploration.segments * segment
        left = self._problem.budget - self._spent - iteration
        few = self._spent > 0 and left < self._selection.steps(self._selection.busy)
        return self._selection.begun or self._spent >= self._search_to or few

    def ask(self) -> list[Proposal]:
        """Return rounds of successive halving, then pairs of segments, then held-out episodes."""
        if not self._halving.over:
            return self._halving.ask()
        # Kept for `tell`: a baseline that enters changes how many steps the selection needs.
        self._selecting = self._in_selection
        if self._selecting:
            if not self._selection.begun:
                self._selection.enter_baseline()
            return self._selection.ask_within(self._problem.budget - self._spent)
        self._sigma = self._shrinkage * self._exploration.sigma
        return super().ask()

    def tell(self, segments: Sequence[Segment]) -> dict[str, float]:
        """Pass what came back to the part that asked for it."""
        steps = sum(segment.length for segment in segments)
        if not self._halving.over:
            self._spent += steps
            return self._tell_halving(segments)
        if self._selecting:
            self._spent += steps
            return self._tell_selection(segments)
        numbers = super().tell(segments)
        self._spent += steps
        self._adapt_to_terminations(segments)
        while self._entered + 1 <= self._averages * self.progress + 1e-9:
            self._entered += 1
            self._selection.enter(self._average)
        return {**numbers, "sigma": self._sigma}

    def _adapt_to_terminations(self, segments: Sequence[Segment]) -> None:
        if self._max_termination_rate is None:
            return
        if np.mean([segment.terminated for segment in segments]) > self._max_termination_rate:
            self._shrinkage *= SHRINK
        else:
            self._shrinkage = min(1.0, self._shrinkage * RECOVER)

    def _tell_halving(self, segments: Sequence[Segment]) -> dict[str, float]:
        numbers = self._halving.tell(segments)
        self._theta = self._halving.best
        self._average = self._theta.copy()
        if self._halving.over:
            self._search_from = self._spent
            self._selection.enter(self._theta)
        return numbers

    def _tell_selection(self, segments: Sequence[Segment]) -> dict[str, float]:
        self._selection.tell(segments)
        best = int(self._selection.ranking[0])
        cost = float(self._selection.costs[:, best].mean())
        return {"selection_best": best, "selection_best_cost": cost}

    def _perturbed(self, offset: np.ndarray, env_index: int) -> list[Proposal]:
        if not self._paired:
            return super()._perturbed(offset, env_index)
        horizon = self._exploration.segment_length
        return [
            Proposal(x=self._theta + offset, env_index=env_index, horizon=horizon, restore=True),
            Proposal(x=self._theta - offset, env_index=env_index, horizon=horizon),
        ]

    def _weights(self, advantages: np.ndarray) -> np.ndarray:
        if self._paired:
            # Half the difference of the two segments: an estimate along epsilon, as eq. (10).
            advantages = (advantages[0::2] - advantages[1::2]) / 2
        return super()._weights(advantages)

    def recommend(self) -> np.ndarray:
        """Return the best candidate; before the final selection, as `Zoac.recommend`."""
        return self._selection.best if self._selection.begun else super().recommend()

    def state(self) -> dict[str, Any]:
        """Return everything that lasts between iterations."""
        return {
            **super().state(),
            "halving": self._halving.state(),
            "selection": self._selection.state(),
            "progress": (self._spent, self._search_from, self._entered),
            "shrinkage": self._shrinkage,
        }

    def restore(self, state: Any) -> None:
        """Restore what `state` returned."""
        super().restore(state)
        self._halving.restore(state["halving"])
        self._selection.restore(state["selection"])
        self._spent, self._search_from, self._entered = state["progress"]
        self._shrinkage = state["shrinkage"]

    def describe(self) -> dict[str, Any]:
        """Return the choices that a comparison must show."""
        choices = super().describe()
        if self._halving_fraction:
            among = ", the baseline values take part" if self._start == "baseline" else ""
            choices["start"] = (
                f"successive halving, {self._halving_fraction:.0%} of the budget{among}"
            )
        if self._paired:
            choices["noise_model"] = f"paired segments; {choices['noise_model']}"
        if self._selection_fraction:
            baseline = "" if self._problem.baseline is None else " and the baseline values"
            choices["recommendation"] = (
                f"best of {self._averages + 1}{baseline} on common held-out episodes, "
                f"{self._selection_fraction:.0%} of the budget"
            )
        return choices
