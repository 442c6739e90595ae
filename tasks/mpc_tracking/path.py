"""The reference path: a sum of three sines, and what the controller is shown of it."""

import math

import numpy as np

from zoac.mpc.compiled import compiled

SPEED = 18.0
"""Reference speed u_r [m/s]."""

STEP = 0.1
"""Step length T_s [s]."""

_BASE = 2 * math.pi / 1200  # [rad/m]


@compiled(error_model="numpy")
def profile(x: float) -> tuple[float, float]:
    """Return y_r [m] and dy_r/dx at `x` [m].

    y_r = 7.5 sin(2 pi x/200) + 2.5 sin(2 pi x/300) - 5 sin(2 pi x/400): six, four and three
    times the angle 2 pi x/1200, so one sine and one cosine give all three.
    """
    s1, c1 = math.sin(_BASE * x), math.cos(_BASE * x)
    s2, c2 = 2.0 * s1 * c1, 1.0 - 2.0 * s1 * s1
    s3, c3 = s1 * c2 + c1 * s2, c1 * c2 - s1 * s2
    s4, c4 = 2.0 * s2 * c2, 1.0 - 2.0 * s2 * s2
    s6, c6 = 2.0 * s3 * c3, 1.0 - 2.0 * s3 * s3
    height = 7.5 * s6 + 2.5 * s4 - 5.0 * s3
    slope = _BASE * (6.0 * 7.5 * c6 + 4.0 * 2.5 * c4 - 3.0 * 5.0 * c3)
    return height, slope


@compiled(error_model="numpy")
def lateral(x: float) -> float:
    """Return y_r(x) [m]."""
    return profile(x)[0]


@compiled(error_model="numpy")
def heading(x: float) -> float:
    """Return phi_r(x) = arctan(dy_r/dx) [rad]."""
    return math.atan(profile(x)[1])


@compiled(error_model="numpy")
def preview(x: float, points: np.ndarray) -> None:
    """Fill `points` (3 N,) with (x_r, y_r, phi_r) [m, m, rad], N times, along the path from `x`.

    x_r goes on by u_r T_s cos(phi_r(x_r)) a step, beginning at the vehicle's own x.
    """
    _, slope = profile(x)
    for k in range(0, len(points), 3):
        x += SPEED * STEP / math.sqrt(1.0 + slope * slope)  # cos(arctan(s))
        height, slope = profile(x)
        points[k] = x
        points[k + 1] = height
        points[k + 2] = math.atan(slope)
