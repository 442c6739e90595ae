"""Task `lqr`: tune the gains, or the weights, of a linear regulator whose optimum is known."""

from functools import lru_cache
from typing import Literal

import numpy as np

from zoac.core.controller import Controller, Diagnostics, Memory, Parameters
from zoac.core.parameters import Parameter, ParameterSpace
from zoac.core.types import Count, NonNegative
from zoac.rollout.task import Task
from zoac.specs.signals import action, observation
from zoac.tasks.lqr.plant import SAMPLE_TIME, LqrVecEnv, Q, optimal_gain

GAINS = ParameterSpace(
    [Parameter("k_x", 0.0, 10.0, unit="1/s^2"), Parameter("k_v", 0.0, 10.0, unit="1/s")]
)
WEIGHTS = ParameterSpace([Parameter("q_x", 1e-2, 1e2, "log"), Parameter("q_v", 1e-3, 1e1, "log")])


class StateFeedback(Controller):
    """u = -(k_x x + k_v v), with given gains or the best for state weights diag(q_x, q_v)."""

    def act(
        self, params: Parameters, obs: np.ndarray, memory: Memory
    ) -> tuple[np.ndarray, Memory, Diagnostics]:
        """Return u (n, 1) [m/s^2]."""
        if "q_x" in params:
            weights = zip(params["q_x"].tolist(), params["q_v"].tolist(), strict=True)
            k_x, k_v = np.array([_gain(pair) for pair in weights]).T
        else:
            k_x, k_v = params["k_x"], params["k_v"]
        u = -(k_x * obs[:, 0] + k_v * obs[:, 1])
        return u[:, None], memory, {}


@lru_cache(maxsize=10_000)  # weights stay the same for many steps
def _gain(weights: tuple[float, float]) -> np.ndarray:
    return optimal_gain(np.diag(weights))


class Lqr(Task):
    """Two parameters: gains in [0, 10], or state weights over four decades."""

    sample_time = SAMPLE_TIME
    signals = {
        "position": observation(0, unit="m"),
        "speed": observation(1, unit="m/s"),
        "input": action(0, unit="m/s²"),
    }

    def __init__(
        self,
        *,
        tuned: Literal["gains", "weights"] = "gains",
        noise: NonNegative = 0.02,
        max_episode_steps: Count = 200,
    ) -> None:
        """
        Args:
            tuned: The gains themselves, or the weights from which they follow.
            noise: Standard deviation of the disturbance of each state and step.
            max_episode_steps: Time limit, in steps of 0.1 s.
        """
        self._noise, self._steps = noise, max_episode_steps
        self.space = GAINS if tuned == "gains" else WEIGHTS
        best = optimal_gain() if tuned == "gains" else np.diag(Q)
        self.baseline = dict(zip(self.space.names, best.tolist(), strict=True))

    def make_env(self, n: int) -> LqrVecEnv:
        return LqrVecEnv(n, self._noise, self._steps)

    def make_controller(self) -> Controller:
        return StateFeedback()
