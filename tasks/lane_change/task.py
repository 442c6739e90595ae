"""Task `lane_change`: tune the rules of a driver; a collision is a constraint, not only a cost."""

import numpy as np

from zoac.core.controller import Controller, Diagnostics, Memory, Parameters
from zoac.core.measures import Constraint, Metric
from zoac.core.parameters import Parameter, ParameterSpace, choice, integer
from zoac.core.segments import Segment
from zoac.core.types import Count
from zoac.rollout.task import Task
from zoac.specs.signals import action, observation
from zoac.tasks.lane_change.plant import SAMPLE_TIME, WANTED, LaneChangeVecEnv


class RuleBasedDriver(Controller):
    """Follows by gap and speed; changes lanes if all rules say so.

    A change needs: `patience` seconds since the last one; gaps of `ahead` and `behind` in the other
    lane, and a car behind that is not more than `closing` faster; and a lane that is better by
    `gain`, in what `better` compares: the speeds of the cars ahead [m/s], or the gaps [10 m].
    """

    def act(
        self, params: Parameters, obs: np.ndarray, memory: Memory
    ) -> tuple[np.ndarray, Memory, Diagnostics]:
        """Return acceleration and wish to change, (n, 2), for observations (n, 8)."""
        v, gap, away, next_gap, next_away, behind, receding, waited = obs.T
        follow = params["k_gap"] * (gap - 2.0 - params["headway"] * v) + params["k_speed"] * away
        acceleration = np.minimum(follow, params["k_speed"] * (WANTED - v))
        by_gap = params["better"] == 1  # the second option
        gain = np.where(by_gap, (next_gap - gap) / 10.0, next_away - away)
        change = (
            (waited >= params["patience"])
            & (next_gap > params["ahead"])
            & (behind > params["behind"])
            & (receding > -params["closing"])
            & (gain > params["gain"])
        )
        return np.stack([acceleration, change.astype(np.float64)], axis=1), memory, {}


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
        Metric("speed", lambda s: s.observations[1:, 0]),
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
        return LaneChangeVecEnv(n, self._steps)

    def make_controller(self) -> RuleBasedDriver:
        return RuleBasedDriver()
