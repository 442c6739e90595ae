"""Interior-point method on one lane: near the solution in about ten factorisations.

Mehrotra's predictor and corrector (Nocedal and Wright, Numerical Optimization, section 16.6) for
a box: every Newton system is the unconstrained problem with a barrier's curvature and slope
added to the inputs, which the Riccati passes solve. It ends with a guess of the active set, from
which an active-set method has little left to do.
"""

from __future__ import annotations

import numpy as np

from .certificate import optimality_error
from .rows import kernel
from .sweeps import (
    FREE,
    HIGH,
    LOW,
    PINNED,
    Layout,
    accept,
    backward,
    forward,
    move,
    place,
    propagate,
    shape,
)

_ITERATIONS = 40
_REDUCTION = 1e-10  # of the complementarity, from beginning to end
_CENTRE = 0.1  # first multipliers, relative to the gradient
_MARGIN = 0.1  # first distance from the bounds, relative to the range
_BACK_OFF = 0.99  # of the step that would reach a bound


@kernel
def _slack(lane: np.ndarray, at: Layout, bound: int, m: int, value: float) -> float:
    """Distance of input m from its lower (0) or upper (1) bound; inf where there is none."""
    if lane[at.side + m] == PINNED:
        return np.inf
    return value - lane[at.low + m] if bound == 0 else lane[at.high + m] - value


@kernel
def _begin(lane: np.ndarray, at: Layout) -> None:
    """A point inside the box, and multipliers that make the dual residual vanish."""
    n, _, nu, _ = shape(at)
    count = n * nu
    for m in range(count):
        w, low, high = place(at, m), lane[at.low + m], lane[at.high + m]
        margin = _MARGIN * (high - low if high - low < np.inf else 1.0)
        if lane[at.side + m] != PINNED:
            lane[at.side + m] = FREE
        lane[at.trial + w] = min(max(lane[at.point + w], low + margin), high - margin)
    for k in range(n):
        propagate(lane, at, k)
    accept(lane, at)
    optimality_error(lane, at)
    mean = 0.0
    for m in range(count):
        mean += abs(lane[at.newton + m] / lane[at.inverse + m]) / count
    for m in range(count):
        gradient = lane[at.newton + m] / lane[at.inverse + m]
        centre = _CENTRE * (mean + abs(gradient))
        for bound in range(2):
            push = max(gradient if bound == 0 else -gradient, 0.0)
            bounded = _slack(lane, at, bound, m, 0.0) < np.inf
            lane[at.multiplier + bound * count + m] = push + centre if bounded else 0.0
            lane[at.change + bound * count + m] = 0.0


@kernel
def _complementarity(lane: np.ndarray, at: Layout, fraction: float) -> float:
    """Sum of slack times multiplier after a `fraction` of the step."""
    count = at.n * len(at.u)
    total = 0.0
    for m in range(count):
        w = place(at, m)
        value = lane[at.point + w] + fraction * (lane[at.trial + w] - lane[at.point + w])
        for bound in range(2):
            b = bound * count + m
            slack = _slack(lane, at, bound, m, value)
            if slack < np.inf:
                total += slack * (lane[at.multiplier + b] + fraction * lane[at.change + b])
    return total


@kernel
def _set_curvature(lane: np.ndarray, at: Layout) -> None:
    """The barrier's curvature, with no slope: what the predictor takes."""
    count = at.n * len(at.u)
    for m in range(count):
        w = place(at, m)
        lane[at.slope + w] = 0.0
        lane[at.curvature + w] = lane[at.weight + w]
        for bound in range(2):
            multiplier = lane[at.multiplier + bound * count + m]
            lane[at.curvature + w] += multiplier / _slack(lane, at, bound, m, lane[at.point + w])


@kernel
def _set_target(lane: np.ndarray, at: Layout, target: float) -> None:
    """`change` becomes the product aimed at, corrected by the predictor; `slope` follows."""
    count = at.n * len(at.u)
    for m in range(count):
        w = place(at, m)
        lane[at.slope + w] = 0.0
        for bound in range(2):
            b, sign = bound * count + m, 1.0 - 2.0 * bound
            moved = sign * (lane[at.trial + w] - lane[at.point + w])
            lane[at.change + b] = target - moved * lane[at.change + b]
            slack = _slack(lane, at, bound, m, lane[at.point + w])
            lane[at.slope + w] -= sign * lane[at.change + b] / slack


@kernel
def _step(lane: np.ndarray, at: Layout, corrected: bool) -> float:
    """Newton step into `trial` and `change`; returns how much of it stays inside."""
    forward(lane, at)
    count = at.n * len(at.u)
    fraction = 1.0
    for m in range(count):
        w = place(at, m)
        for bound in range(2):
            slack = _slack(lane, at, bound, m, lane[at.point + w])
            if slack == np.inf:
                continue
            b = bound * count + m
            moved = (1.0 - 2.0 * bound) * (lane[at.trial + w] - lane[at.point + w])
            target = lane[at.change + b] if corrected else 0.0
            multiplier = lane[at.multiplier + b]
            change = (target - multiplier * moved) / slack - multiplier
            lane[at.change + b] = change
            if moved < 0.0:
                fraction = min(fraction, -_BACK_OFF * slack / moved)
            if change < 0.0:
                fraction = min(fraction, -_BACK_OFF * multiplier / change)
    return fraction


@kernel
def _guess_sides(lane: np.ndarray, at: Layout) -> None:
    """An input whose multiplier outweighs its slack goes to its bound; the barrier goes."""
    count = at.n * len(at.u)
    for m in range(count):
        w, low, high = place(at, m), lane[at.low + m], lane[at.high + m]
        curvature = 1.0 / lane[at.inverse + m] - lane[at.curvature + w] + lane[at.weight + w]
        value = min(max(lane[at.point + w], low), high)
        if curvature * _slack(lane, at, 0, m, value) < lane[at.multiplier + m]:
            lane[at.side + m] = LOW
            value = low
        elif curvature * _slack(lane, at, 1, m, value) < lane[at.multiplier + count + m]:
            lane[at.side + m] = HIGH
            value = high
        lane[at.trial + w] = value
        lane[at.curvature + w] = lane[at.weight + w]
        lane[at.slope + w] = 0.0
    for k in range(at.n):
        propagate(lane, at, k)
    accept(lane, at)


@kernel
def interior_point(lane: np.ndarray, at: Layout) -> int:
    """Bring `point` near the solution and `side` near its active set.

    `inverse` must come from an earlier `backward`. Returns the number of factorisations, or -1
    where one failed.
    """
    pairs = 2 * at.n * len(at.u)
    _begin(lane, at)
    first = _complementarity(lane, at, 0.0)
    count = 0
    while count < _ITERATIONS:
        now = _complementarity(lane, at, 0.0)
        if not now > _REDUCTION * first:
            break
        count += 1
        _set_curvature(lane, at)
        if not backward(lane, at, at.n - 1):
            return -1
        ahead = _complementarity(lane, at, _step(lane, at, False))
        _set_target(lane, at, (ahead / now) ** 3 * now / pairs)
        backward(lane, at, -1)
        fraction = _step(lane, at, True)
        move(lane, at, fraction)
        for b in range(pairs):
            lane[at.multiplier + b] += fraction * lane[at.change + b]
    _guess_sides(lane, at)
    return count
