"""The incremental PID of eq. (13)."""

from __future__ import annotations

import numpy as np

from zoac.core.controller import Diagnostics, Memory, Parameters


class IncrementalPid:
    """du = Kp (e_t - e_{t-1}) + Ki e_t + Kd (e_t - 2 e_{t-1} + e_{t-2}), e = k dd + dv.

    Remembers nothing: the observation carries x_t, x_{t-1} and x_{t-2}.
    """

    def init(self, n: int) -> Memory:
        """Return the empty memory."""
        return {}

    def act(
        self, params: Parameters, obs: np.ndarray, memory: Memory
    ) -> tuple[np.ndarray, Memory, Diagnostics]:
        """Return the increments du (n, 1) [m/s^2] for observations (n, 10)."""
        # (3, n): clearance and speed errors now, one and two steps ago.
        columns = obs.T
        e = params["k"] * columns[0:9:3] + columns[1:9:3]
        change = e[0] - e[1]
        du = params["Kp"] * change
        du += params["Ki"] * e[0]
        du += params["Kd"] * (change - (e[1] - e[2]))
        return du[:, None], memory, {}
