"""A linear plant in a loop with a PID: the controller for several loops, and the loop's margins."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from zoac.controllers.pid import PID
from zoac.envs.linear_loop import SampledPlant
from zoac.specs.loops import OpenLoop, beside

POINTS = 2000
"""Frequencies at which a loop is looked at, logarithmic up to the Nyquist frequency; beside weakly
damped poles of the plant there are more."""

DECADES = 6
"""Below the Nyquist frequency."""


class LoopsPID:
    """The same PID in each of the m loops of a `LoopVecEnv`."""

    def __init__(self, pid: PID, loops: int) -> None:
        self._pid, self._loops = pid, loops

    def init(self, n: int) -> dict[str, np.ndarray]:
        """Return the memory of `n` environments, (n, m) each."""
        return {name: np.zeros((n, self._loops)) for name in self._pid.init(1)}

    def act(
        self, params: Mapping[str, np.ndarray], obs: np.ndarray, memory: Mapping[str, np.ndarray]
    ) -> tuple[np.ndarray, dict[str, np.ndarray], dict[str, np.ndarray]]:
        """Return outputs (n, m) and the next memory; see `Controller.act`."""
        y, r = obs[:, : self._loops], obs[:, self._loops : 2 * self._loops]
        gains = tuple(np.reshape(g, (-1, 1)) for g in self._pid.gains(params))
        u, memory = self._pid.step(gains, y, r, memory)  # type: ignore[arg-type]
        return u, memory, {}


class SampledLoop:
    """The open loop L = P C of a plant and a PID at the samples, exact with its dead time.

    The limits of the input and anti-windup are no part of a linear loop.
    """

    def __init__(self, plant: SampledPlant) -> None:
        self._sample_time, self._matrices = plant.sample_time, plant.state_space()
        nyquist = math.pi / plant.sample_time
        omega = np.logspace(math.log10(nyquist) - DECADES, math.log10(nyquist), POINTS)
        poles = np.linalg.eigvals(plant.a).astype(complex)
        self._omega = beside(np.log(poles[np.abs(poles) > 1e-9]) / plant.sample_time, omega)
        self._z = np.exp(1j * self._omega * plant.sample_time)
        self._plant = plant.response(self._z)

    def at(self, pid: PID, parameters: Mapping[str, Any]) -> OpenLoop:
        """Return the loop with a PID of these parameters."""
        gains = tuple(float(g) for g in pid.gains(parameters))
        kp, ki, kd, tf = gains
        z, ts = self._z, self._sample_time
        c = kp + ki * ts / (z - 1) + kd * (z - 1) / ((tf + ts) * z - tf)
        return OpenLoop(self._omega, self._plant * c, self._is_stable(*gains))

    def _is_stable(self, kp: float, ki: float, kd: float, tf: float) -> bool:
        """Return whether all poles of the closed loop lie inside the unit circle."""
        a, b, c = self._matrices
        ts, q = self._sample_time, len(c)
        kept, kick = tf / (tf + ts), kd / (tf + ts)
        # The states are the plant's, the integral, and the derivative without its latest kick.
        closed = np.zeros((q + 2, q + 2))
        closed[:q, :q] = a - (kp + kick) * np.outer(b, c)
        closed[:q, q] = closed[:q, q + 1] = b
        closed[q, :q], closed[q, q] = -ki * ts * c, 1.0
        closed[q + 1, :q], closed[q + 1, q + 1] = (1.0 - kept) * kick * c, kept
        if not ki:
            closed = np.delete(np.delete(closed, q, axis=0), q, axis=1)
        return bool(np.abs(np.linalg.eigvals(closed)).max() < 1.0)
