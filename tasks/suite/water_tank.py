"""The water tank of MathWorks' example.

The level H follows A dH/dt = b V - a sqrt(H). MathWorks' page on linearising the model prints the
derivative -0.0158 and the gain 0.25 at H = 10, so a / A = 0.1 and b / A = 0.25, as with a = 2,
b = 5, A = 20. "Tune PI Controller Using Reinforcement Learning" gives the rest: process noise of
variance 1, T_s = 0.1 s, 10 s an episode, level and reference drawn around 10, the cost
(H_ref - H)^2 + 0.01 u^2, and the answer of Control System Tuner, Kp = 9.8 and Ki = 1e-6. A linear
quadratic regulator for these numbers has the gain 9.80 at H = 1, the level at which that model
starts.
"""

from __future__ import annotations

import math
from typing import Any

import gymnasium as gym
import numpy as np

AREA, OUTFLOW, INFLOW = 20.0, 2.0, 5.0
SAMPLE_TIME, STEPS = 0.1, 100
SPACE = {"Kp": (0.1, 100.0, "log"), "Ki": (1e-7, 10.0, "log")}


class WaterTank(gym.Env):
    """Observation (H, H_ref); action V, the voltage of the pump."""

    observation_space = gym.spaces.Box(-np.inf, np.inf, (2,), np.float64)
    action_space = gym.spaces.Box(-np.inf, np.inf, (1,), np.float64)
    metadata = {"sample_time": SAMPLE_TIME}

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Draw the level and the reference."""
        super().reset(seed=seed)
        self.level, self.reference = self._drawn(), self._drawn()
        return np.array([self.level, self.reference]), {}

    def _drawn(self) -> float:
        level = 10.0 + 3.0 * self.np_random.standard_normal()
        return level if 0.0 < level < 20.0 else self._drawn()

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Advance by one sample, in ten steps of Euler's rule."""
        voltage = float(action[0])
        cost = (self.reference - self.level) ** 2 + 0.01 * voltage**2
        noise = self.np_random.standard_normal()
        for _ in range(10):
            flow = (INFLOW * voltage - OUTFLOW * math.sqrt(self.level)) / AREA
            self.level = max(0.0, self.level + SAMPLE_TIME / 10 * (flow + noise))
        return np.array([self.level, self.reference]), -cost, False, False, {}
