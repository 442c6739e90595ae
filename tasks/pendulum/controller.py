"""Swing up by energy, hold by PD."""

from __future__ import annotations

import numpy as np

from zoac.core.controller import Diagnostics, Memory, Parameters

PULL = 15.0
"""3 g / (2 l) of the pendulum that the controller believes in [1/s^2]."""


class EnergyPd:
    """PD within `switch` of upright; elsewhere torque along the speed until the energy suffices.

    E = speed^2 / 2 + PULL cos(angle) is the energy over the moment of inertia; upright and at rest
    it is PULL.
    """

    def init(self, n: int) -> Memory:
        """Return the empty memory."""
        return {}

    def act(
        self, params: Parameters, obs: np.ndarray, memory: Memory
    ) -> tuple[np.ndarray, Memory, Diagnostics]:
        """Return the torque (n, 1) [N m] for observations (n, 3)."""
        cosine, sine, speed = obs.T
        angle = np.arctan2(sine, cosine)
        hold = -params["kp"] * angle - params["kd"] * speed
        swing = params["energy"] * (PULL - 0.5 * speed**2 - PULL * cosine) * speed
        torque = np.where(np.abs(angle) < params["switch"], hold, swing)
        return torque[:, None], memory, {}
