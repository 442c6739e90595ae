"""What a linear loop shows without a simulation: margins, sensitivity, bandwidth.

All figures are of an open loop L that is closed with negative feedback: a system of python-control
with one input and one output, in continuous or discrete time, or an `OpenLoop`. Where the closed
loop is unstable margins are 0 and the sensitivity is infinite.
"""

import math
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np

from zoac.core.errors import ConfigError

POINTS, PER_DECADE = 5000, 1000
"""Frequencies at least at which a response is looked at, logarithmic over the corners of the open
and the closed loop and `DECADES` beside them."""

DECADES = 2

WEAK = 0.1
"""Damping ratio below which a root has a peak that may fall between two points of the grid."""

BESIDE = 150
"""Frequencies on each side of a weakly damped root."""


@dataclass(frozen=True, eq=False)
class OpenLoop:
    """A loop's frequency response, so dense that it is straight from point to point.

    Args:
        omega: Frequencies (K,) [rad/s], increasing, from 0 or nearly 0.
        response: L there (K,), complex; infinite at a pole.
        stable: Whether the closed loop is stable.
    """

    omega: np.ndarray
    response: np.ndarray
    stable: bool


@np.errstate(divide="ignore", invalid="ignore")  # at a pole
def gain_margin(loop: Any) -> float:
    """Return the factor above 1 by which the loop's gain may grow until it is unstable."""
    loop = open_loop(loop)
    if not loop.stable:
        return 0.0
    # A real number at the Nyquist frequency, but for rounding.
    is_real = np.abs(loop.response.imag) < 1e-12 * np.abs(loop.response)
    response = np.where(is_real, loop.response.real, loop.response)
    before, after = response[:-1], response[1:]
    # Across a pole on the axis the response is not straight.
    near = np.abs(after - before) < np.abs(before)
    crossing = near & (before.imag * after.imag <= 0)
    before, after = before[crossing], after[crossing]
    part = before.imag / np.where(before.imag == after.imag, 1.0, before.imag - after.imag)
    real = (before + part * (after - before)).real
    # Rounding may put the response of a loop at its limit on either side of -1.
    return float(np.min(-1.0 / real[(real < 0) & (real > -1.0 - 1e-9)], initial=np.inf))


@np.errstate(divide="ignore", invalid="ignore")  # at a pole
def phase_margin(loop: Any) -> float:
    """Return the phase [deg] that the loop may lose where its gain is 1 until it is unstable."""
    loop = open_loop(loop)
    if not loop.stable:
        return 0.0
    log = np.log(np.abs(loop.response))
    crossing = np.flatnonzero(log[:-1] * log[1:] <= 0)
    part = log[crossing] / (log[crossing] - log[crossing + 1])
    angle = np.angle(-loop.response[crossing])
    turn = np.angle(loop.response[crossing + 1] / loop.response[crossing])
    margins = np.abs(np.angle(np.exp(1j * (angle + part * turn))))
    return math.degrees(np.fmin.reduce(margins, initial=np.inf))


@np.errstate(divide="ignore", invalid="ignore")  # at a pole
def disk_margin(loop: Any) -> float:
    """Return the symmetric disk margin alpha: gain and phase may vary at once inside its disk.

    The gain may then change by a factor from (2 - alpha) / (2 + alpha) to its inverse (Seiler,
    Packard and Gahinet, "An introduction to disk margins", 2020).
    """
    loop = open_loop(loop)
    if not loop.stable:
        return 0.0
    return float(np.nanmin(2.0 * np.abs((1 + loop.response) / (1 - loop.response))))


def max_sensitivity(loop: Any) -> float:
    """Return Ms, the largest magnitude of 1 / (1 + L): one over the distance of L to -1."""
    loop = open_loop(loop)
    return float(1.0 / np.abs(1.0 + loop.response).min()) if loop.stable else np.inf


def bandwidth(loop: Any) -> float:
    """Return the frequency [rad/s] at which the closed loop has lost 3 dB of its gain at rest.

    Infinite where it never does.
    """
    loop = open_loop(loop)
    if not loop.stable:
        return 0.0
    closed = np.abs(1.0 - 1.0 / (1.0 + loop.response))
    level = math.sqrt(0.5) * closed[0]
    below = np.flatnonzero(closed < level)
    if not len(below):
        return np.inf
    pair = [below[0], below[0] - 1]
    return float(np.interp(level, closed[pair], loop.omega[pair]))


def open_loop(loop: Any) -> OpenLoop:
    """Return the response of a system of python-control; an `OpenLoop` as it is.

    Raises:
        ConfigError: If the loop has several inputs or outputs, or is no system.
    """
    import control

    if isinstance(loop, OpenLoop):
        return loop
    if (getattr(loop, "ninputs", 0), getattr(loop, "noutputs", 0)) != (1, 1):
        raise ConfigError(
            f"loop={loop!r}: expected a system of python-control with one input and one output; "
            "break the loop at one signal"
        )
    if not isinstance(loop, control.TransferFunction | control.StateSpace):
        raise ConfigError(
            f"loop: {type(loop).__name__}, expected a transfer function or a state-space model; "
            "frequency data do not tell whether the closed loop is stable"
        )
    poles = control.feedback(loop, 1).poles()
    inside = np.abs(poles) < 1.0 if loop.isdtime(strict=True) else poles.real < 0.0
    stable = bool(inside.all())
    omega = _frequencies(loop, poles) if stable else np.zeros(0)  # no figure looks at more
    return OpenLoop(omega, _response(loop, omega), stable)


def _frequencies(loop: Any, closed: np.ndarray) -> np.ndarray:
    """Return 0 and frequencies [rad/s] that hold every corner of the open and the closed loop.

    The gain of an open loop may be 1 far beyond its own corners; the closed loop, with the poles
    `closed`, has one there.
    """
    roots = np.concatenate([loop.poles(), loop.zeros(), closed]).astype(complex)
    discrete = loop.isdtime(strict=True)
    if discrete:
        roots = np.log(roots[np.abs(roots) > 1e-9]) / loop.dt
    corners = np.abs(roots)
    # Rounding moves roots away from 0, where they have no corner.
    corners = corners[(corners > 1e-12 * corners.max(initial=0.0)) & np.isfinite(corners)]
    low, high = (corners.min(), corners.max()) if len(corners) else (1.0, 1.0)
    top = np.log10(np.pi / loop.dt) if discrete else np.log10(high) + DECADES
    bottom = min(np.log10(low), top) - DECADES
    points = max(POINTS, math.ceil(PER_DECADE * (top - bottom)))
    return np.append(0.0, beside(roots, np.logspace(bottom, top, points)))


def _response(loop: Any, omega: np.ndarray) -> np.ndarray:
    """Return the response (K,) of a system at frequencies [rad/s], complex; infinite at a pole."""
    import control

    at = np.exp(1j * omega * loop.dt) if loop.isdtime(strict=True) else 1j * omega
    if isinstance(loop, control.StateSpace):
        # Python-control solves for one frequency after the other, which takes three times as long.
        with suppress(np.linalg.LinAlgError):  # at a pole
            states = np.linalg.solve(at[:, None, None] * np.eye(loop.nstates) - loop.A, loop.B)
            return np.asarray((loop.C @ states)[:, 0, 0] + loop.D[0, 0])
    found = np.asarray(loop(at, warn_infinite=False)).reshape(-1)
    return np.where(np.isfinite(found), found, np.inf)


def beside(roots: np.ndarray, omega: np.ndarray) -> np.ndarray:
    """Return a grid of frequencies with further ones beside weakly damped roots.

    Args:
        roots: Poles and zeros in continuous time, complex.
        omega: The grid (K,) [rad/s], increasing.
    """
    weak = roots[(roots.imag > 0) & (np.abs(roots.real) < WEAK * np.abs(roots))]
    if not len(weak):
        return omega
    found = [omega]
    for root in weak:
        # A root on the axis has no width of its own.
        width = max(abs(root.real), 1e-9 * root.imag)
        offset = np.geomspace(0.01 * width, WEAK * root.imag, BESIDE)
        found += [root.imag - offset, root.imag + offset]
    every = np.unique(np.concatenate(found))
    return every[(every >= omega[0]) & (every <= omega[-1])]
