"""The task's own reference parameters, which are only evaluated."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from zoac.core.segments import Proposal, Segment
from zoac.core.tuner import Problem, Tuner


class NominalTuner(Tuner):
    """Asks for nothing and recommends the baseline parameters."""

    display_name = "Nominal"

    def __init__(self, problem: Problem) -> None:
        """
        Raises:
            ConfigError: If the task has no baseline parameters.
        """
        self._nominal = problem.baseline_start("tuner=nominal")

    def ask(self) -> list[Proposal]:
        """Return nothing: there is nothing to find out."""
        return []

    def tell(self, segments: Sequence[Segment]) -> dict[str, float]:
        """Learn nothing."""
        return {}

    def recommend(self) -> np.ndarray:
        """Return the baseline parameters."""
        return self._nominal.copy()

    def state(self) -> Any:
        """Return nothing: there is no state."""
        return None

    def restore(self, state: Any) -> None:
        """Do nothing."""
