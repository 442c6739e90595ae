"""ZOAC on pairs of segments, between successive halving for the start and a final selection.

Not the paper's method, which `zoac.algorithm.zoac` keeps as published. `docs/beyond.md` shows what
each part brings.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field

from zoac.algorithm.options import CriticOptions, Exploration, StepSize
from zoac.algorithm.strategies.base import TunerStrategy
from zoac.algorithm.strategies.final_selection import FinalSelection
from zoac.algorithm.strategies.successive_halving import SuccessiveHalving
from zoac.algorithm.zoac import Zoac
from zoac.core.segments import Proposal, Segment
from zoac.core.tuner import Problem, Tuner
from zoac.core.types import Count, UnitInterval

SHRINK, RECOVER = 0.5, 1.05
"""Of perturbation and step, after an iteration with too many terminations and after any other."""

TerminationRate = Annotated[float, Field(ge=0, lt=1)]


class PairedZoac(Zoac):
    """Zeroth-order actor-critic on pairs of segments.

    An environment runs N steps with theta + sigma epsilon, is restored, and runs N steps with
    theta - sigma epsilon. The direction counts by half the difference of the two advantages. Start,
    disturbances and most of the critic's error are common to both segments and cancel. Both count
    as environment steps. Where an environment cannot be restored (`Problem.supports_snapshots`),
    directions run one way.
    """

    display_name = "ZOAC+"
    kept = "_shrinkage"

    def __init__(
        self,
        problem: Problem,
        *,
        paired: bool = True,
        max_termination_rate: TerminationRate | None = None,
        **options: Any,
    ) -> None:
        """
        Args:
            problem: What is tuned.
            paired: Run every direction both ways from the same state.
            max_termination_rate: See `ZoacPlus`.
            options: Of `Zoac`.
        """
        super().__init__(problem, **options)
        self._paired = paired and problem.supports_snapshots
        self._max_termination_rate, self._shrinkage = max_termination_rate, 1.0

    @property
    def sigma(self) -> float:
        """ZOAC's perturbation, smaller after many terminations if `max_termination_rate` is set."""
        return self._shrinkage * super().sigma

    @property
    def step_size(self) -> float:
        """ZOAC's step size, smaller after many terminations if `max_termination_rate` is set."""
        return self._shrinkage * super().step_size

    def tell(self, segments: Sequence[Segment]) -> dict[str, float]:
        """Update critic and parameters, then perturbation and step if they adapt."""
        numbers = {**super().tell(segments), "sigma": self.sigma}
        self._adapt_to_terminations(segments)
        return numbers

    def _adapt_to_terminations(self, segments: Sequence[Segment]) -> None:
        if self._max_termination_rate is None:
            return
        if np.mean([segment.terminated for segment in segments]) > self._max_termination_rate:
            self._shrinkage *= SHRINK
        else:
            self._shrinkage = min(1.0, self._shrinkage * RECOVER)

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

    def describe(self) -> dict[str, Any]:
        choices = super().describe()
        if self._paired:
            choices["noise_model"] = f"paired segments; {choices['noise_model']}"
        return choices


class ZoacPlus(TunerStrategy):
    """Successive halving for the start, `PairedZoac` from there, a final selection.

    All three count as environment steps. The final selection is between the start, averages of the
    iterates and the baseline, if any.
    """

    whole_episodes = False
    display_name = PairedZoac.display_name

    def __init__(
        self,
        problem: Problem,
        *,
        exploration: Exploration = Exploration(segment_length=50, segments=2, sigma=0.07),
        step_size: StepSize = StepSize(first=3e-2, last=None, slope=0.0),
        critic: CriticOptions = CriticOptions((64, 64), epochs=5, normalise_observations=True),
        start: Literal["random", "baseline"] = "random",
        gamma: UnitInterval = 0.99,
        lam: UnitInterval = 0.95,
        standardise_advantages: bool = True,
        project: bool = True,
        recommend: Literal["last", "average"] = "average",
        average_decay: UnitInterval = 0.9,
        paired: bool = True,
        halving_fraction: UnitInterval = 0.4,
        halving_rounds: Count = 6,
        halving_survivors: UnitInterval | None = None,
        selection_fraction: UnitInterval = 0.1,
        selection_candidates: Count = 3,
        selection_baseline: bool = True,
        max_termination_rate: TerminationRate | None = None,
    ) -> None:
        """
        Args:
            problem: What is tuned.
            exploration: See `Zoac`.
            step_size: See `Zoac`.
            critic: See `Zoac`.
            start: Begin anywhere in the box, or at the baseline; it takes part in successive
                halving, if there is any.
            gamma: See `Zoac`.
            lam: See `Zoac`.
            standardise_advantages: See `Zoac`.
            project: See `Zoac`.
            recommend: What the candidates of the final selection are, and the recommendation
                before it: the last iterate, or an exponential average of the iterates.
            average_decay: Decay of that average per iteration.
            paired: Run every direction both ways from the same state.
            halving_fraction: Of the budget, for finding a start; 0 starts as `start` says.
            halving_rounds: Rounds of successive halving, with horizons that grow to an episode.
            halving_survivors: Which fraction of a round are the last round's best; the rest are
                their offspring. Few survivors suit few parameters; None: by their number.
            selection_fraction: Of the budget, for held-out episodes on which the recommendation is
                chosen; 0 recommends as `recommend` says.
            selection_candidates: Recommendations among the candidates, taken at equal distances.
            selection_baseline: The baseline, if there is one, is among them too.
            max_termination_rate: Fraction of an iteration's segments that may terminate. Above it
                perturbation and step shrink, below it they grow back. None: any. For safe
                exploration from known gains, with halving_fraction=0: halving tries the whole box.
        """

        def zoac(left: Problem) -> Tuner:
            return PairedZoac(
                left,
                exploration=exploration,
                step_size=step_size,
                critic=critic,
                start="baseline" if halving_fraction else start,
                gamma=gamma,
                lam=lam,
                standardise_advantages=standardise_advantages,
                project=project,
                recommend=recommend,
                average_decay=average_decay,
                paired=paired,
                max_termination_rate=max_termination_rate,
            )

        def with_selection(left: Problem) -> Tuner:
            if not selection_fraction:
                return zoac(left)
            fraction = min(1.0, selection_fraction * problem.budget / max(1, left.budget))
            return FinalSelection(
                left,
                zoac,
                fraction=fraction,
                candidates=selection_candidates,
                baseline=selection_baseline,
            )

        def with_halving(whole: Problem) -> Tuner:
            if not halving_fraction:
                return with_selection(whole)
            return SuccessiveHalving(
                whole,
                with_selection,
                fraction=halving_fraction,
                rounds=halving_rounds,
                survivors=halving_survivors,
                start=start,
            )

        super().__init__(problem, with_halving)
        self.display_name = PairedZoac.display_name
