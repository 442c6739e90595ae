"""What a run is told beside its task and its tuner."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from pydantic import Field

from zoac.core.types import Count, Fraction, Natural, NonNegative

# Keys of the configuration that cannot change a run's numbers.
WITHOUT_EFFECT = (
    "executor", "logger", "runs_dir", "variant", "resume", "checkpoint_seconds", "hydra",
)  # fmt: skip

# Notes for other parts of the configuration, not arguments of the task.
NOTES = ("tuned_for",)

SideBySide = Annotated[int, Field(ge=1, le=100_000)]  # all in memory at once


@dataclass(frozen=True)
class Settings:
    """What a run is told beside its task and its tuner.

    Args:
        seed: Of everything but the evaluation episodes.
        budget: Environment steps for tuning; evaluation is not counted.
        num_envs: Environments side by side.
        eval_every: Environment steps between evaluations.
        episodes: Evaluation episodes during tuning.
        final_episodes: Evaluation episodes of the final figure.
        evaluation_seed: Of the evaluation episodes, the same for all runs that are compared.
        checkpoint_seconds: Wall seconds between checkpoints.
        initial_sigma: Standard deviation of the search around the baseline in the mapped box; see
            `zoac.strategies.around_baseline`.
        acceptance_test: Fraction of the budget for proof that the answer beats the start; see
            `zoac.strategies.acceptance_test.AcceptanceTest`.
        select: "best_evaluated": the answer is the best of the evaluated recommendations, see
            `zoac.strategies.best_evaluated`; "last" or None: what the tuner recommends at the end.
        initial_samples: Random points of which the best is the tuner's start; see
            `zoac.strategies.initial_design.InitialDesign`.
        common_random_numbers: Points of a batch meet the same episode; see
            `zoac.strategies.initial_design.CommonRandomNumbers`.
        failure_penalty: The task's, see `zoac.rollout.task.Task`; here to be checked with the rest.
    """

    seed: Natural = 0
    budget: Natural = 500_000
    num_envs: SideBySide = 10
    eval_every: Count = 10_000
    episodes: SideBySide = 10
    final_episodes: SideBySide = 100
    evaluation_seed: Natural = 0
    checkpoint_seconds: NonNegative = 30.0
    initial_sigma: Annotated[float, Field(gt=0, le=1)] | None = None
    acceptance_test: Fraction | None = None
    select: Literal["last", "best_evaluated"] | None = None
    failure_penalty: float | None = None
    initial_samples: Count | None = None
    common_random_numbers: bool | None = None
