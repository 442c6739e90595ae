"""Whether one lane's current point is optimal, by the adjoint equation; if need be after refining.

The certificate is computed from the data alone: neither the gains nor the sides enter it.
"""

from __future__ import annotations

import numpy as np

from .rows import kernel
from .sweeps import (
    PINNED,
    Layout,
    accept,
    backward,
    begin_gradient,
    forward,
    shape,
    stage_gradient,
)

REFINE_ABOVE = 1e-10  # optimality error, relative to an input's range
_SOLVED_BELOW = 1e-7
_SOLVED_BELOW_FIXED = 1e-9  # the same, with the other inputs held
_REFINEMENTS = 3


@kernel
def optimality_error(lane: np.ndarray, at: Layout) -> float:
    """Largest |w - clip(w - g / d)| relative to the input's range; `newton` = g / d.

    g is the objective's gradient at the current point, by the adjoint equation: neither the
    gains nor the sides enter it, so the error certifies the point by itself. d is the value's
    curvature in the input. A gradient that is not finite gives inf.
    """
    n, nx, nu, width = shape(at)
    worst = 0.0
    begin_gradient(lane, at)
    for k in range(n - 1, -1, -1):
        stage_gradient(lane, at, k)
        for j in range(nu):
            m = k * nu + j
            value, low, high = (
                lane[at.point + k * width + nx + j],
                lane[at.low + m],
                lane[at.high + m],
            )
            newton = lane[at.gradient + nx + j] * lane[at.inverse + m]
            lane[at.newton + m] = newton
            if not abs(newton) < np.inf:
                return np.inf
            error = abs(value - min(max(value - newton, low), high))
            scale = high - low if 0.0 < high - low < np.inf else 1.0
            if error > worst * scale:
                worst = error / scale
    return worst


@kernel
def certified(lane: np.ndarray, at: Layout) -> bool:
    """Refine the current point if need be, and say whether it is optimal to tolerance."""
    error = optimality_error(lane, at)
    for _ in range(_REFINEMENTS):
        if not REFINE_ABOVE < error < np.inf:
            break
        backward(lane, at, -1)
        forward(lane, at)
        accept(lane, at)
        error = optimality_error(lane, at)
    return error <= _SOLVED_BELOW


@kernel
def certified_otherwise(lane: np.ndarray, at: Layout) -> bool:
    """Whether the point is optimal by the Hessian's own diagonal instead of the value's curvature.

    Where inputs are nearly interchangeable the value's curvature is tiny, and rounding alone
    keeps the error in its units above tolerance; the diagonal never is. It is what the recursion
    gives when no input is eliminated.
    """
    count = at.n * len(at.u)
    for m in range(count):
        lane[at.multiplier + m] = lane[at.side + m]  # no longer in use
        lane[at.side + m] = PINNED
    backward(lane, at, at.n - 1)
    error = optimality_error(lane, at)
    for m in range(count):
        lane[at.side + m] = lane[at.multiplier + m]
    return error <= _SOLVED_BELOW_FIXED
