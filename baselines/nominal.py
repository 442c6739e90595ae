"""The task's own reference parameters, which are only evaluated."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from zoac.baselines.episodes import nominal_point
from zoac.segments import Proposal, Segment
from zoac.tuner import Problem, Tuner


class NominalTuner(Tuner):
    """Asks for nothing and recommends the nominal parameters."""

    def __init__(self, problem: Problem) -> None:
        """
        Raises:
            ConfigError: If the task has no nominal parameters.
        """
        self._nominal = nominal_point(problem, "tuner=nominal")

    def ask(self) -> list[Proposal]:
        """Return nothing: there is nothing to find out."""
        return []

    def tell(self, segments: Sequence[Segment]) -> dict[str, float]:
        """Learn nothing."""
        return {}

    def recommend(self) -> np.ndarray:
        """Return the nominal parameters."""
        return self._nominal.copy()

    def state(self) -> Any:
        """Return nothing: there is no state."""
        return None

    def restore(self, state: Any) -> None:
        """Do nothing."""
