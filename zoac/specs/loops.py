"""What a linear loop shows without a simulation: margins, sensitivity, bandwidth.

All functions take the open loop L, a system of python-control with one input and one output, in
continuous or discrete time, which is closed with negative feedback. Where the closed loop is
unstable margins are 0 and the sensitivity is infinite.
"""

import math
from collections.abc import Callable
from contextlib import suppress
from typing import Any

import numpy as np

from zoac.core.errors import ConfigError

POINTS, PER_DECADE = 2000, 200
"""Frequencies at least at which a response is looked at, logarithmic over the corners of the open
and the closed loop and `DECADES` beside them."""

DECADES = 2

WEAK = 0.1
"""Damping ratio below which a root has a peak that may fall between two points of the grid."""

BESIDE = 150
"""Frequencies on each side of a weakly damped root."""

Figure = Callable[[np.ndarray], np.ndarray]
"""Function of frequencies (K,) [rad/s] that returns as many numbers."""


def gain_margin(loop: Any) -> float:
    """Return the factor above 1 by which the loop's gain may grow until it is unstable."""
    if not is_stable(loop):
        return 0.0
    at = _crossings(loop, lambda omega: _response(loop, omega).imag)
    real = _response(loop, np.append(at, _ends(loop))).real
    # Rounding may put the response of a loop at its limit on either side of -1.
    return float(np.min(-1.0 / real[(real < 0) & (real > -1.0 - 1e-9)], initial=np.inf))


def phase_margin(loop: Any) -> float:
    """Return the phase [deg] that the loop may lose where its gain is 1 until it is unstable."""
    if not is_stable(loop):
        return 0.0
    at = _crossings(loop, lambda omega: np.abs(_response(loop, omega)) - 1.0)
    return math.degrees(np.min(np.abs(np.angle(-_response(loop, at))), initial=np.inf))


def disk_margin(loop: Any) -> float:
    """Return the symmetric disk margin alpha: gain and phase may vary at once inside its disk.

    The gain may then change by a factor from (2 - alpha) / (2 + alpha) to its inverse (Seiler,
    Packard and Gahinet, "An introduction to disk margins", 2020).
    """
    if not is_stable(loop):
        return 0.0

    def inverse(omega: np.ndarray) -> np.ndarray:
        response = _response(loop, omega)
        return np.abs((1.0 - response) / (1.0 + response)) / 2.0

    largest = _highest(loop, inverse)
    return 1.0 / largest if largest else np.inf


def max_sensitivity(loop: Any) -> float:
    """Return Ms, the largest magnitude of 1 / (1 + L): one over the distance of L to -1."""
    if not is_stable(loop):
        return np.inf
    return _highest(loop, lambda omega: 1.0 / np.abs(1.0 + _response(loop, omega)))


def bandwidth(loop: Any) -> float:
    """Return the frequency [rad/s] at which the closed loop has lost 3 dB of its gain at rest.

    Infinite where it never does.
    """
    import control

    if not is_stable(loop):
        return 0.0
    closed = control.feedback(loop, 1)
    level = math.sqrt(0.5) * abs(_response(closed, np.zeros(1))[0])
    at = _crossings(loop, lambda omega: np.abs(_response(closed, omega)) - level)
    return float(at[0]) if len(at) else np.inf


def is_stable(loop: Any) -> bool:
    """Tell whether the closed loop is stable.

    Raises:
        ConfigError: If the loop has several inputs or outputs, or is no system.
    """
    import control

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
    return bool(inside.all())


def _frequencies(loop: Any) -> np.ndarray:
    """Return frequencies (K,) [rad/s] that hold every corner of the open and the closed loop.

    The gain of an open loop may be 1 far beyond its own corners; the closed loop has one there.
    """
    import control

    closed = control.feedback(loop, 1)
    roots = np.concatenate([loop.poles(), loop.zeros(), closed.poles()]).astype(complex)
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
    return beside(roots, np.logspace(bottom, top, points))


def _ends(loop: Any) -> np.ndarray:
    """Return the frequencies [rad/s] at which a response without a pole there is a real number."""
    return np.array([0.0, np.pi / loop.dt] if loop.isdtime(strict=True) else [0.0])


def _response(loop: Any, omega: np.ndarray) -> np.ndarray:
    """Return the response (K,) of a system at frequencies [rad/s], complex."""
    import control

    at = np.exp(1j * omega * loop.dt) if loop.isdtime(strict=True) else 1j * omega
    if isinstance(loop, control.StateSpace):
        # Python-control solves for one frequency after the other, which takes three times as long.
        with suppress(np.linalg.LinAlgError):  # at a pole
            states = np.linalg.solve(at[:, None, None] * np.eye(loop.nstates) - loop.A, loop.B)
            return np.asarray((loop.C @ states)[:, 0, 0] + loop.D[0, 0])
    return np.asarray(loop(at, warn_infinite=False)).reshape(-1)


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


@np.errstate(divide="ignore", invalid="ignore")  # at a pole on the axis
def _highest(loop: Any, figure: Figure) -> float:
    """Return the largest value of a figure: on the loop's grid, refined between the neighbours."""
    omega = _frequencies(loop)
    values = figure(omega)
    for _ in range(REFINEMENTS):
        k = int(np.nanargmax(values))
        omega = np.linspace(omega[max(k - 1, 0)], omega[min(k + 1, len(omega) - 1)], REFINED)
        values = figure(omega)
    return float(np.nanmax(values))


REFINEMENTS, REFINED = 3, 41
"""How often the neighbourhood of a peak is looked at more closely, and at how many points."""


@np.errstate(divide="ignore", invalid="ignore")  # at a pole on the axis
def _crossings(loop: Any, figure: Figure) -> np.ndarray:
    """Return the frequencies (N,) [rad/s] at which a figure changes its sign.

    One change between two points of the loop's grid is found.
    """
    omega = _frequencies(loop)
    values = figure(omega)
    omega, signs = omega[np.isfinite(values)], np.sign(values[np.isfinite(values)])
    at = np.flatnonzero(signs[:-1] != signs[1:])
    before, after, sign = omega[at], omega[at + 1], signs[at]
    for _ in range(HALVINGS if len(at) else 0):
        middle = 0.5 * (before + after)
        same = np.sign(figure(middle)) == sign
        before, after = np.where(same, middle, before), np.where(same, after, middle)
    return before


HALVINGS = 50
"""Of the interval around a crossing: as many as a double has bits."""
