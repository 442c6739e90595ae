"""A linear plant in a loop with a PID: the controller for several loops, and the loop's margins."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from zoac.controllers.pid import PID
from zoac.envs.linear_loop import SampledPlant
from zoac.specs.loops import beside

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

    Margins are 0, and the sensitivity infinite, where the closed loop is unstable. The limits of
    the input and anti-windup are no part of a linear loop.
    """

    def __init__(self, plant: SampledPlant, sample_time: float) -> None:
        """
        Args:
            plant: From `sampled`.
            sample_time: T_s [s].
        """
        self.plant, self.sample_time = plant, sample_time
        nyquist = math.pi / sample_time
        omega = np.logspace(math.log10(nyquist) - DECADES, math.log10(nyquist), POINTS)
        poles = np.linalg.eigvals(plant.a).astype(complex)
        self.omega = beside(np.log(poles[np.abs(poles) > 1e-9]) / sample_time, omega)
        self._z = np.exp(1j * self.omega * sample_time)
        self._plant = plant.response(self._z)

    def at(self, pid: PID, parameters: Mapping[str, Any]) -> ClosedLoop:
        """Return the loop with a PID of these parameters."""
        kp, ki, kd, tf = (float(g) for g in pid.gains(parameters))
        z, ts = self._z, self.sample_time
        c = kp + ki * ts / (z - 1) + kd * (z - 1) / ((tf + ts) * z - tf)
        return ClosedLoop(self, (kp, ki, kd, tf), self._plant * c)


@dataclass(frozen=True, eq=False)
class ClosedLoop:
    """A loop with its gains: what its frequency response shows.

    Args:
        loop: The plant.
        gains: Kp, Ki, Kd and Tf.
        response: Of the open loop at `loop.omega`, (K,) complex.
    """

    loop: SampledLoop
    gains: tuple[float, float, float, float]
    response: np.ndarray

    @cached_property
    def is_stable(self) -> bool:
        """Whether all poles of the closed loop lie inside the unit circle."""
        a, b, c = self.loop.plant.state_space()
        kp, ki, kd, tf = self.gains
        ts, q = self.loop.sample_time, len(c)
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

    def gain_margin(self) -> float:
        """Return the factor above 1 by which the loop's gain may grow until it is unstable."""
        if not self.is_stable:
            return 0.0
        response = self.response
        crossing = np.flatnonzero(response.imag[:-1] * response.imag[1:] <= 0)
        before, after = response[crossing], response[crossing + 1]
        part = before.imag / np.where(before.imag == after.imag, 1.0, before.imag - after.imag)
        real = np.append((before + part * (after - before)).real, response[-1].real)
        factors = -1.0 / real[(real < 0) & (real > -1)]
        return float(factors.min(initial=np.inf))

    def phase_margin(self) -> float:
        """Return the phase [deg] that the loop may lose where its gain is 1."""
        if not self.is_stable:
            return 0.0
        with np.errstate(divide="ignore"):  # gains of 0
            log = np.log(np.abs(self.response))
        crossing = np.flatnonzero(log[:-1] * log[1:] <= 0)
        part = log[crossing] / (log[crossing] - log[crossing + 1])
        angle = np.angle(-self.response)
        turn = np.angle(self.response[crossing + 1] / self.response[crossing])
        margins = np.abs(np.angle(np.exp(1j * (angle[crossing] + part * turn))))
        return math.degrees(margins.min(initial=np.inf))

    def max_sensitivity(self) -> float:
        """Return Ms, the largest magnitude of 1 / (1 + L)."""
        return float(1.0 / np.abs(1.0 + self.response).min()) if self.is_stable else np.inf

    def disk_margin(self) -> float:
        """Return the symmetric disk margin; see `zoac.specs.loops.disk_margin`."""
        if not self.is_stable:
            return 0.0
        return float((2.0 * np.abs((1 + self.response) / (1 - self.response))).min())

    def bandwidth(self) -> float:
        """Return the frequency [rad/s] at which the closed loop has lost 3 dB of its gain."""
        if not self.is_stable:
            return 0.0
        closed = np.abs(self.response / (1 + self.response))
        below = np.flatnonzero(closed < closed[0] * math.sqrt(0.5))
        return float(self.loop.omega[below[0]]) if len(below) else np.inf
