"""What a linear loop shows without a simulation: margins, sensitivity, bandwidth.

All functions take the open loop L, a system of python-control with one input and one output, in
continuous or discrete time, which is closed with negative feedback. Where the closed loop is
unstable margins are 0 and the sensitivity is infinite.
"""

import warnings
from typing import Any

import numpy as np

from zoac.core.errors import ConfigError

POINTS = 2000
"""Frequencies at which the sensitivity is looked at, logarithmic over the loop's corners and
`DECADES` beside them."""

DECADES = 2


def gain_margin(loop: Any) -> float:
    """Return the factor by which the loop's gain may grow until it is unstable."""
    return _margins(loop)[0]


def phase_margin(loop: Any) -> float:
    """Return the phase [deg] that the loop may lose where its gain is 1 until it is unstable."""
    return _margins(loop)[1]


def disk_margin(loop: Any) -> float:
    """Return the symmetric disk margin alpha: gain and phase may vary at once inside its disk.

    The gain may then change by a factor from (2 - alpha) / (2 + alpha) to its inverse (Seiler,
    Packard and Gahinet, "An introduction to disk margins", 2020).
    """
    import control

    if not is_stable(loop):
        return 0.0
    margin, _, _ = control.disk_margins(loop, _frequencies(loop), skew=0.0)
    return float(margin)


def max_sensitivity(loop: Any) -> float:
    """Return Ms, the largest magnitude of 1 / (1 + L): one over the distance of L to -1."""
    if not is_stable(loop):
        return np.inf
    return float(1.0 / np.min(np.abs(1.0 + _response(loop))))


def bandwidth(loop: Any) -> float:
    """Return the frequency [rad/s] at which the closed loop has lost 3 dB of its gain at rest."""
    import control

    if not is_stable(loop):
        return 0.0
    return float(control.bandwidth(control.feedback(loop, 1)))


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
    poles = control.feedback(loop, 1).poles()
    inside = np.abs(poles) < 1.0 if loop.isdtime(strict=True) else poles.real < 0.0
    return bool(inside.all())


def _margins(loop: Any) -> tuple[float, float]:
    import control

    if not is_stable(loop):
        return 0.0, 0.0
    with warnings.catch_warnings():
        # It then computes from the response itself, which is as good, and says so every time.
        warnings.filterwarnings("ignore", "stability_margins: Falling back", UserWarning)
        gain, phase, *_ = control.stability_margins(loop)
    return float(gain), float(phase)


def _frequencies(loop: Any) -> np.ndarray:
    """Return frequencies (K,) [rad/s] that hold every corner of the loop."""
    roots = np.concatenate([loop.poles(), loop.zeros()]).astype(complex)
    discrete = loop.isdtime(strict=True)
    if discrete:
        roots = np.log(roots[np.abs(roots) > 1e-9]) / loop.dt
    corners = np.abs(roots)
    corners = corners[(corners > 1e-6) & np.isfinite(corners)]
    low, high = (corners.min(), corners.max()) if len(corners) else (1.0, 1.0)
    top = np.log10(high) + DECADES
    if discrete:
        top = np.log10(np.pi / loop.dt)
    return np.logspace(min(np.log10(low), top) - DECADES, top, POINTS)


def _response(loop: Any) -> np.ndarray:
    omega = _frequencies(loop)
    at = np.exp(1j * omega * loop.dt) if loop.isdtime(strict=True) else 1j * omega
    return np.asarray(loop(at)).reshape(-1)
