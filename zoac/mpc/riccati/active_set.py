"""Primal active-set method on one lane, for the last steps to the solution."""

from __future__ import annotations

import numpy as np

from .certificate import optimality_error
from .rows import kernel
from .sweeps import (
    FREE,
    HIGH,
    LOW,
    Layout,
    accept,
    backward,
    forward,
    move,
    place,
)

# Relative to an input's range: gains below this are rounding, and not followed.
_RELEASE_ABOVE = 1e-10


@kernel
def _advance(lane: np.ndarray, at: Layout) -> int:
    """Go towards `trial` as far as the bounds allow; returns the input that stopped it, or -1."""
    fraction, stop, side = 1.0, -1, FREE
    for m in range(at.n * len(at.u)):
        w = place(at, m)
        value, wish = lane[at.point + w], lane[at.trial + w]
        low, high = lane[at.low + m], lane[at.high + m]
        if lane[at.side + m] != FREE or low <= wish <= high:
            continue
        reach = ((high if wish > high else low) - value) / (wish - value)
        if reach < fraction:
            fraction, stop = reach, m
            side = HIGH if wish > high else LOW
    if stop < 0:
        accept(lane, at)
    else:
        move(lane, at, fraction)
        bound = at.high if side == HIGH else at.low
        lane[at.point + place(at, stop)] = lane[bound + stop]
        lane[at.side + stop] = side
    return stop


@kernel
def _release(lane: np.ndarray, at: Layout) -> int:
    """Free the input whose bound holds it back most; returns it, or -1 if none is held back."""
    worst, release = _RELEASE_ABOVE, -1
    for m in range(at.n * len(at.u)):
        side = lane[at.side + m]
        if side in (LOW, HIGH):
            spread = lane[at.high + m] - lane[at.low + m]
            gain = side * lane[at.newton + m] / (spread if spread < np.inf else 1.0)
            if gain > worst:
                worst, release = gain, m
    if release >= 0:
        lane[at.side + release] = FREE
    return release


@kernel
def active_set(lane: np.ndarray, at: Layout, limit: int) -> tuple[int, bool]:
    """Solve from the feasible current point, changing one side at a time.

    Between two minimisers of the objective over the free inputs, the second of them lower, sides
    are only taken, so it ends (Nocedal and Wright, Numerical Optimization, section 16.5). Returns
    the number of factorisations, -1 where one failed, and whether it ended within `limit`.
    """
    changed = at.n - 1
    for count in range(1, limit + 1):
        if not backward(lane, at, changed):
            return -1, False
        forward(lane, at)
        change = _advance(lane, at)
        if change < 0:
            optimality_error(lane, at)
            change = _release(lane, at)
        if change < 0:
            return count, True
        changed = change // len(at.u)
    return limit, False
