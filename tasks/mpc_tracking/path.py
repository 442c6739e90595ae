"""The reference path: a sum of three sines, and what the controller is shown of it."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

SPEED = 18.0
"""Reference speed u_r [m/s]."""

STEP = 0.1
"""Step length T_s [s]."""

_AMPLITUDES = (7.5, 2.5, -5.0)  # [m]
_WAVENUMBERS = (2 * math.pi / 200, 2 * math.pi / 300, 2 * math.pi / 400)  # [rad/m]


@njit(cache=True)
def lateral(x: float) -> float:
    """Return y_r(x) [m]."""
    a, b, c = _AMPLITUDES
    p, q, r = _WAVENUMBERS
    return a * math.sin(p * x) + b * math.sin(q * x) + c * math.sin(r * x)


@njit(cache=True)
def slope(x: float) -> float:
    """Return dy_r/dx at `x` [m]."""
    a, b, c = _AMPLITUDES
    p, q, r = _WAVENUMBERS
    return a * p * math.cos(p * x) + b * q * math.cos(q * x) + c * r * math.cos(r * x)


@njit(cache=True)
def heading(x: float) -> float:
    """Return phi_r(x) = arctan(dy_r/dx) [rad]."""
    return math.atan(slope(x))


@njit(cache=True)
def preview(x: float, points: np.ndarray) -> None:
    """Fill `points` (N, 3) with (x_r, y_r, phi_r) [m, m, rad], N steps along the path from `x`.

    x_r goes on by u_r T_s cos(phi_r(x_r)) a step, beginning at the vehicle's own x.
    """
    gradient = slope(x)
    for k in range(len(points)):
        x += SPEED * STEP / math.sqrt(1.0 + gradient * gradient)  # cos(arctan(s))
        gradient = slope(x)
        points[k, 0] = x
        points[k, 1] = lateral(x)
        points[k, 2] = math.atan(gradient)
