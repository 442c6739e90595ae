"""A PI loop as an engineer meets it: dead time, saturation, noise, and gains from a rule of thumb.

The plant is 2 / ((0.5 s + 1)(0.2 s + 1)) with a dead time of 0.1 s. Its cost is the integral of the
absolute error, plus the movement of the actuator.
"""

import gymnasium
import numpy as np
from gymnasium.spaces import Box

STEP, STEPS, DELAY = 0.02, 240, 5

SPACE = {
    "kp": {"low": 0.05, "high": 5.0, "scale": "log", "baseline": 1.74},
    "ti": {"low": 0.05, "high": 5.0, "scale": "log", "baseline": 0.56},
}
"""The baseline is Ziegler's and Nichols's: 0.45 of the ultimate gain, 0.83 of the period."""


class Plant(gymnasium.Env):
    observation_space = Box(-np.inf, np.inf, (1,), np.float64)
    action_space = Box(-2.0, 2.0, (1,), np.float64)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.x1 = self.x2 = self.last = 0.0
        self.pipe = [0.0] * DELAY
        self.goal = self.np_random.uniform(0.5, 1.5)
        return self._observed(), {}

    def _observed(self):
        return np.array([self.goal - self.x2 + self.np_random.normal(0.0, 0.02)])

    def step(self, action):
        u = float(action[0])
        self.pipe.append(u)
        self.x1 += STEP * (2.0 * self.pipe.pop(0) - self.x1) / 0.5
        self.x2 += STEP * (self.x1 - self.x2) / 0.2
        cost = STEP * (abs(self.goal - self.x2) + 0.5 * abs(u - self.last))
        self.last = u
        return self._observed(), -cost, False, False, {}


class PI:
    """With the integrator clamped while the actuator saturates."""

    def reset(self):
        self.integral = 0.0

    def act(self, params, obs):
        error = float(obs[0])
        u = params["kp"] * (error + self.integral / params["ti"])
        if abs(u) < 2.0 or u * error < 0:
            self.integral += STEP * error
        return np.clip(u, -2.0, 2.0)
