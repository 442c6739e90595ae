"""Task `lane_change`: tune the rules of a driver; a collision is a constraint, not only a cost."""

from __future__ import annotations

import numpy as np

from zoac.core.measures import Constraint, Metric
from zoac.core.parameters import Parameter, ParameterSpace, choice, integer
from zoac.core.segments import Segment
from zoac.core.types import Count
from zoac.rollout.task import Task
from zoac.specs.signals import action, observation
from zoac.tasks.lane_change.driver import RuleBasedDriver
from zoac.tasks.lane_change.plant import SAMPLE_TIME, LaneChangeVecEnv


def _too_near(segment: Segment) -> np.ndarray:
    """Above zero where the gap ahead is below 0.3 s or 2 m, (T,) [m]."""
    speed, gap = segment.observations[1:, 0], segment.observations[1:, 1]
    return np.maximum(2.0, 0.3 * speed) - gap


class LaneChange(Task):
    """Eight numbers, of which one is whole, and a choice."""

    space = ParameterSpace(
        [
            Parameter("headway", 0.3, 3.0, unit="s"),
            Parameter("k_gap", 0.01, 1.0, "log", unit="1/s^2"),
            Parameter("k_speed", 0.05, 2.0, "log", unit="1/s"),
            Parameter("ahead", 0.0, 60.0, unit="m"),
            Parameter("behind", 0.0, 60.0, unit="m"),
            Parameter("closing", 0.0, 10.0, unit="m/s"),
            Parameter("gain", 0.0, 5.0),
            integer("patience", 0, 10, unit="s"),
            choice("better", ("speed", "gap")),
        ]
    )
    metrics = (
        Metric("speed", lambda s: s.observations[1:, 0], unit="m/s"),
        Metric("changes", lambda s: s.actions[:, 1], reduce="sum"),
    )
    constraints = (Constraint("distance", _too_near, scale=5.0),)
    baseline = {
        "headway": 1.5, "k_gap": 0.1, "k_speed": 0.5, "ahead": 30.0, "behind": 30.0,
        "closing": 3.0, "gain": 2.0, "patience": 5, "better": "speed",
    }  # fmt: skip
    """A careful driver's rules of thumb."""
    sample_time = SAMPLE_TIME
    signals = {
        "speed": observation(0, unit="m/s"),
        "gap": observation(1, unit="m"),
        "acceleration": action(0, unit="m/s²"),
    }

    def __init__(self, *, max_episode_steps: Count = 300) -> None:
        """
        Args:
            max_episode_steps: Time limit, in steps of 0.2 s.
        """
        self._steps = max_episode_steps

    def make_env(self, n: int) -> LaneChangeVecEnv:
        """Return `n` drives."""
        return LaneChangeVecEnv(n, self._steps)

    def make_controller(self) -> RuleBasedDriver:
        """Return the driver."""
        return RuleBasedDriver()
