"""Groups of ZOAC's options; the defaults are those of Table III for the MPC."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from zoac.core.types import Count, Natural, NonNegative, Positive


@dataclass(frozen=True)
class Exploration:
    """Which segments an iteration runs.

    Args:
        segment_length: N, steps that a perturbation is held.
        segments: H, segments per environment and iteration ("train frequency").
        sigma: Standard deviation of the perturbation of normalised parameters.
        mirrored: Environments 2i and 2i + 1 use opposite perturbations.
    """

    segment_length: Count = 20
    segments: Count = 5
    sigma: Positive = 0.1
    mirrored: bool = False


@dataclass(frozen=True)
class StepSize:
    """The parameters' step size, over the iterations.

    Args:
        rule: "adam" (the paper), or "sgd": the step size times the gradient, nothing else (the
            authors' later code, with 5e-4 and advantages that are not standardised).
        first: Of the first iteration.
        last: Where annealing stops; None: the first one.
        slope: Decrease per iteration.
        anneal: False keeps the first one (the authors' code).
    """

    rule: Literal["adam", "sgd"] = "adam"
    first: Positive = 5e-2
    last: Positive | None = 1e-2
    slope: NonNegative = 1e-4
    anneal: bool = True

    def at(self, iteration: int) -> float:
        """Return the step size of an iteration, counted from 0."""
        if not self.anneal:
            return self.first
        last = self.first if self.last is None else min(self.first, self.last)
        return max(last, self.first - self.slope * iteration)


@dataclass(frozen=True)
class CriticOptions:
    """The critic's network and how it is fitted.

    Args:
        hidden: Widths of the hidden layers.
        step_size: alpha_critic, Adam's step size.
        epochs: M, passes over an iteration's states.
        epochs_before: How many of them come before the iteration's advantages, which are then
            computed from the new critic (half in the authors' later code); 0: none (the paper).
        minibatch: L, states per gradient step.
        minibatch_remainder: States that minibatches leave over are a smaller one ("separate"), or
            join the last one ("joined", the authors' code).
        normalise_observations: Shift and scale observations by running statistics.
        target_scale: Factor on the targets inside the network, for costs far from 1.
    """

    hidden: Sequence[Count] = (256, 256)
    step_size: Positive = 5e-4
    epochs: Count = 10
    epochs_before: Natural = 0
    minibatch: Count = 128
    minibatch_remainder: Literal["separate", "joined"] = "separate"
    normalise_observations: bool = False
    target_scale: Positive = 1.0
