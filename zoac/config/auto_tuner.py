"""Which tuner `tuner="auto"` stands for; `docs/tune_pid.md` has the measurements."""

from __future__ import annotations

from typing import Any

from zoac.core.types import is_number
from zoac.rollout.task import Task

MAX_COORDINATES = 20
"""Beyond, a whole episode says too little about each coordinate."""

MIN_EPISODES = 100
"""Fewer end before CMA-ES has learned a covariance."""


def tuner_for(task: Task, budget: float) -> tuple[str, dict[str, Any]]:
    """Return the name of a tuner's config, and settings that go with it.

    Specs are judged over whole episodes, so CMA-ES tunes what has some, for a single parameter
    differential evolution. It also tunes a few gains with a budget for many episodes, compared on
    common random numbers. Everything else is tuned by ZOAC.

    Args:
        task: What is tuned.
        budget: Environment steps.
    """
    dimension = task.space.dimension
    if task.specs:
        return "cmaes_full" if dimension > 1 else "nevergrad", {}
    unfit = not 1 < dimension <= MAX_COORDINATES or not is_number(budget)
    if unfit or budget < MIN_EPISODES * task.horizon.steps:
        return "zoac", {}
    return "cmaes_full", {"common_random_numbers": True}
