"""The exothermic stirred tank of Seborg, Edgar, Mellichamp and Doyle, Process Dynamics and Control.

Concentration C and temperature T follow

    dC/dt = q / V (C_f - C) - k C
    dT/dt = q / V (T_f - T) + H k C / (rho c) + U A / (V rho c) (T_c - T),  k = k_0 exp(-E / (R T))

and the input is the coolant's temperature T_c. The numbers are the textbook's.
"""

from __future__ import annotations

import math
from typing import Any

import gymnasium as gym
import numpy as np

FLOW, VOLUME = 100.0, 100.0  # [L/min], [L]
FEED, FEED_TEMPERATURE = 1.0, 350.0  # [mol/L], [K]
HEAT_CAPACITY = 1000.0 * 0.239  # rho c [J/(L K)]
REACTION_HEAT, ACTIVATION, FREQUENCY = 5e4, 8750.0, 7.2e10  # [J/mol], E / R [K], [1/min]
TRANSFER = 5e4  # U A [J/(min K)]
SAMPLE_TIME, STEPS, SUBSTEPS = 0.25, 80, 25  # [min]
COOLANT = (290.0, 305.0)  # [K]


class StirredTank(gym.Env):
    """Observation (C, its reference) in mol/L; action T_c - 300 K.

    Every episode draws the concentration at its start and the reference.
    """

    observation_space = gym.spaces.Box(-np.inf, np.inf, (2,), np.float64)
    action_space = gym.spaces.Box(COOLANT[0] - 300.0, COOLANT[1] - 300.0, (1,), np.float64)
    metadata = {"sample_time": SAMPLE_TIME}

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Begin near the stable operating point C = 0.88 mol/L, T = 324.5 K."""
        super().reset(seed=seed)
        self.c, self.t = self.np_random.uniform(0.84, 0.91), 324.5
        self.reference = self.np_random.uniform(0.82, 0.92)
        return np.array([self.c, self.reference]), {}

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Advance by one sample, implicitly in C, so that a runaway reaction stays finite."""
        low, high = COOLANT
        coolant = min(max(300.0 + float(action[0]), low), high)
        cost = (100.0 * (self.reference - self.c)) ** 2
        dt, flow = SAMPLE_TIME / SUBSTEPS, FLOW / VOLUME
        for _ in range(SUBSTEPS):
            k = FREQUENCY * math.exp(-ACTIVATION / self.t)
            self.c = (self.c + dt * flow * FEED) / (1.0 + dt * (flow + k))
            heating = REACTION_HEAT * k * self.c + TRANSFER / VOLUME * (coolant - self.t)
            self.t += dt * (flow * (FEED_TEMPERATURE - self.t) + heating / HEAT_CAPACITY)
        return np.array([self.c, self.reference]), -cost, False, False, {}
