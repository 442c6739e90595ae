"""A water tank and a PI controller with anti-windup: what a user would bring."""

import gymnasium
import numpy as np
from gymnasium.spaces import Box

DT = 1.0  # [s]


class Tank(gymnasium.Env):
    """Level [m] under an inflow [m^3/s]; the outlet is opened and closed by others."""

    observation_space = Box(-10.0, 10.0, (2,), np.float64)  # level, level wanted [m]
    action_space = Box(0.0, 0.4, (1,), np.float64)

    def reset(self, *, seed=None, options=None):
        """Begin an episode at another level, with another outlet."""
        super().reset(seed=seed)
        self.level, self.wanted = self.np_random.uniform(0.5, 2.0, 2)
        self.outlet = self.np_random.uniform(0.08, 0.12)  # [m^2.5/s]
        return self._observation(), {}

    def step(self, action):
        """Pump for one step."""
        outflow = self.outlet * np.sqrt(max(self.level, 0.0))
        self.level = max(self.level + DT * (float(action[0]) - outflow), 0.0)
        cost = (self.level - self.wanted) ** 2
        return self._observation(), -cost, False, False, {"cost": cost}

    def _observation(self):
        return np.array([self.level, self.wanted])


class Pi:
    """PI; the integral stops while the pump is at a limit."""

    def reset(self):
        """Forget."""
        self.integral = 0.0

    def act(self, params, obs):
        """Return the inflow [m^3/s]."""
        error = obs[1] - obs[0]
        inflow = params["kp"] * error + self.integral
        if 0.0 < inflow < 0.4:
            self.integral += params["ki"] * error * DT
        return inflow


def overshoot(segment):
    """Above zero where the level is more than 0.2 m above the wanted one [m]."""
    level, wanted = segment.observations[1:].T
    return level - np.maximum(wanted, segment.observations[0, 0]) - 0.2
