"""Backward and forward passes over one lane's horizon.

A lane's data and intermediate results stand in one flat array `lane`, where `at` says. With z_k
the deviation of the state from the rollout and w_k that of the input, the current point is the
row [z_k, w_k] of `point`; `trial` is the point that a pass proposes. Every pass is a Newton step
from the current point, so that running it again refines the result.

Rows are nx + nu numbers and zeros up to `width`, a whole number of vectors.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from .rows import add_row, dot, inlined, kernel, multiply, weigh

# Sides of an input, stored with the numbers.
LOW, FREE, HIGH, PINNED = -1.0, 0.0, 1.0, 2.0  # PINNED: both bounds are the same number

# Relative to the range of an input: closer than this to where its bound begins to matter, an
# input keeps the side it is on, or rounding would move it to and fro for ever.
HYSTERESIS = 1e-12


class Layout(NamedTuple):
    """Where things stand in the flat array of one lane; N stages, each a block as noted."""

    n: int  # N
    x: tuple[int, ...]  # its length is nx
    u: tuple[int, ...]  # its length is nu
    row: tuple[int, ...]  # its length is nx + nu
    vector: tuple[int, ...]  # its length is the width of a stored row
    size: int  # of the whole array
    dynamics: int  # N (nx, width): [A_k B_k]
    hessian: int  # N + 1 (nx + nu, width): of the value in [z, w]; eliminated: P_k, and gains
    product: int  # (nx, width)
    gradient: int  # (width,)
    step: int  # (width,)
    point: int  # N + 1 (width,)
    trial: int  # N + 1 (width,)
    weight: int  # N + 1 (width,), of [x_k, u_k]; zero for x_0
    offset: int  # N + 1 (width,): [x_k - reference_k, u_k] of the rollout
    curvature: int  # N + 1 (width,): weight, and the barrier's curvature
    slope: int  # N + 1 (width,): the barrier's slope; zero outside the interior point
    local: int  # N + 1 (width,): gradient of a stage's own cost
    low: int  # N (nu,): bounds of w
    high: int  # N (nu,)
    side: int  # N (nu,): LOW, FREE, HIGH or PINNED
    inverse: int  # N (nu,): 1 / curvature of the value in each input
    pull: int  # N (nu,): gradient of the value in each input
    newton: int  # N (nu,): gradient of the objective times `inverse`, in units of the input
    multiplier: int  # 2, N (nu,): interior point, of lower and upper bounds
    change: int  # 2, N (nu,): interior point, of `multiplier`


@kernel
def lane_layout(n: int, x: Any, u: Any, vector: Any) -> Layout:
    """Return the layout for `n` stages."""
    rows, width, m = len(x) + len(u), len(vector), n * len(u)
    points = (n + 1) * width
    hessian = n * len(x) * width
    product = hessian + (n + 1) * rows * width
    gradient = product + len(x) * width
    point = gradient + 2 * width
    at = point + 7 * points
    return Layout(
        n, x, u, x + u, vector, at + 10 * m,
        0, hessian, product, gradient, gradient + width, point, point + points,
        point + 2 * points, point + 3 * points, point + 4 * points, point + 5 * points,
        point + 6 * points,
        at, at + m, at + 2 * m, at + 3 * m, at + 4 * m, at + 5 * m, at + 6 * m, at + 8 * m,
    )  # fmt: skip


@kernel
def make_lane(at: Layout) -> Any:
    """Return a lane's array; it begins at a cache line, so that few rows straddle two."""
    block = np.zeros(at.size + 8)
    start = -(block.ctypes.data // 8) % 8
    return block[start : start + at.size]


@inlined
def shape(at: Layout) -> tuple[int, int, int, int]:
    """Return N, nx, nu and the width of a stored row."""
    return at.n, len(at.x), len(at.u), len(at.vector)


@inlined
def place(at: Layout, m: int) -> int:
    """Return where input m of N nu stands in `point` and `trial`."""
    _, nx, nu, width = shape(at)
    return m // nu * width + nx + m % nu


@inlined
def first_side(nominal: float, lowest: float, highest: float) -> float:
    """Where an input is guessed to stay that the rollout has at `nominal`."""
    side = FREE
    if nominal == highest:
        side = HIGH
    if nominal == lowest:
        side = LOW
    if lowest == highest:
        side = PINNED
    return side


@inlined
def stored(side: float, value: float, lowest: float, highest: float) -> float:
    """Return an input's `value` in the plan; at a bound it is that bound, bit for bit."""
    if side == HIGH:
        value = highest
    elif side != FREE:
        value = lowest
    else:
        value = min(max(value, lowest), highest)
    return value


@inlined
def _eliminate(lane: np.ndarray, at: Layout, k: int) -> bool:
    """Riccati recursion from the value of stage k + 1 to that of k; False: not convex."""
    _, nx, nu, width = shape(at)
    here = at.hessian + k * (nx + nu) * width
    after, dynamics = here + (nx + nu) * width, at.dynamics + k * nx * width
    multiply(lane, at.product, after, width, 1, dynamics, None, None, at.x, at.x, at.vector)
    multiply(
        lane, here, dynamics, 1, width, at.product, at.curvature + k * width, None,
        at.row, at.x, at.vector,
    )  # fmt: skip
    convex = True
    for j in range(nu - 1, -1, -1):
        row = here + (nx + j) * width
        pivot = lane[row + nx + j]
        convex = convex and pivot > 0.0
        inverse = 1.0 / pivot
        lane[at.inverse + k * nu + j] = inverse
        if lane[at.side + k * nu + j] == FREE:
            for i in range(nx + j):
                add_row(lane, here + i * width, -inverse * lane[row + i], row, at.vector)
    return convex


@inlined
def begin_gradient(lane: np.ndarray, at: Layout) -> None:
    """What each stage itself adds to the gradient at the current point; `gradient` is the last."""
    n, _, _, width = shape(at)
    for k in range(n + 1):
        row = k * width
        weigh(
            lane, at.local + row, at.weight + row, at.offset + row, at.point + row,
            at.slope + row, at.vector,
        )  # fmt: skip
    for i in range(width):
        lane[at.gradient + i] = lane[at.local + n * width + i]


@inlined
def stage_gradient(lane: np.ndarray, at: Layout, k: int) -> None:
    """`gradient` in [z_k, w_k] from that of k + 1; its first part is the costate."""
    _, nx, _, width = shape(at)
    multiply(
        lane, at.gradient, at.gradient, 0, 1, at.dynamics + k * nx * width, None,
        at.local + k * width, at.u[:1], at.x, at.vector,
    )  # fmt: skip


@kernel
def backward(lane: np.ndarray, at: Layout, last: int) -> bool:
    """Value function of every stage at the current point, with the free inputs eliminated.

    Quadratic parts are computed anew from stage `last` to 0 and taken as they stand behind it;
    linear parts, `pull`, everywhere. Returns False where the problem is not convex.
    """
    n, nx, nu, width = shape(at)
    convex = True
    begin_gradient(lane, at)
    for k in range(n - 1, -1, -1):
        if k <= last:
            convex = _eliminate(lane, at, k) and convex
        stage_gradient(lane, at, k)
        for j in range(nu - 1, -1, -1):
            m = k * nu + j
            pull = lane[at.gradient + nx + j]
            lane[at.pull + m] = pull
            if lane[at.side + m] == FREE:
                row = at.hessian + (k * (nx + nu) + nx + j) * width
                add_row(lane, at.gradient, -pull * lane[at.inverse + m], row, at.vector)
    return convex


@inlined
def propagate(lane: np.ndarray, at: Layout, k: int) -> None:
    """Trial state of stage k + 1 from the trial row of stage k."""
    _, nx, _, width = shape(at)
    row = k * width
    for i in range(nx):
        lane[at.trial + row + width + i] = dot(
            lane, at.dynamics + (k * nx + i) * width, at.trial + row, at.row
        )


@inlined
def _wish(lane: np.ndarray, at: Layout, k: int, j: int) -> float:
    """Value of input j that minimises what is left, given `step` before it; bounds ignored."""
    _, nx, nu, width = shape(at)
    m = k * nu + j
    row = (k * (nx + nu) + nx + j) * width
    pull = lane[at.pull + m] + dot(lane, at.hessian + row, at.step, at.x)
    for i in range(nx, nx + j):
        pull += lane[at.hessian + row + i] * lane[at.step + i]
    return lane[at.point + k * width + nx + j] - pull * lane[at.inverse + m]


@kernel
def forward(lane: np.ndarray, at: Layout) -> None:
    """Newton step in the free inputs, bounds ignored, into `trial`."""
    n, nx, nu, width = shape(at)
    for k in range(n):
        row = k * width
        for i in range(nx):
            lane[at.step + i] = lane[at.trial + row + i] - lane[at.point + row + i]
        for j in range(nu):
            old = lane[at.point + row + nx + j]
            value = _wish(lane, at, k, j) if lane[at.side + k * nu + j] == FREE else old
            lane[at.step + nx + j] = value - old
            lane[at.trial + row + nx + j] = value
        propagate(lane, at, k)


@kernel
def forward_clipped(lane: np.ndarray, at: Layout) -> int:
    """Minimise input by input within the bounds, into `trial`; every input may change sides.

    Returns the last stage where one did, or -1: then `trial` is the solution.
    """
    n, nx, nu, width = shape(at)
    changed = -1
    for k in range(n):
        row = k * width
        for i in range(nx):
            lane[at.step + i] = lane[at.trial + row + i] - lane[at.point + row + i]
        for j in range(nu):
            m = k * nu + j
            wish = _wish(lane, at, k, j)
            low, high, before = lane[at.low + m], lane[at.high + m], lane[at.side + m]
            if before == FREE and low <= wish <= high:
                # What follows would say the same; a guess of this branch need not wait for it.
                lane[at.step + nx + j] = wish - lane[at.point + row + nx + j]
                lane[at.trial + row + nx + j] = wish
                continue
            margin = HYSTERESIS * min(high - low, max(1.0, abs(wish)))
            side = FREE
            if before == PINNED:
                side = PINNED
            elif wish > (high - margin if before == HIGH else high + margin):
                side = HIGH
            elif wish < (low + margin if before == LOW else low - margin):
                side = LOW
            if side != before:
                lane[at.side + m] = side
                changed = k
            value = high if side == HIGH else low if side == LOW else min(max(wish, low), high)
            lane[at.step + nx + j] = value - lane[at.point + row + nx + j]
            lane[at.trial + row + nx + j] = value
        propagate(lane, at, k)
    return changed


@kernel
def accept(lane: np.ndarray, at: Layout) -> None:
    """The trial point becomes the current point."""
    _, _, _, width = shape(at)
    for i in range((at.n + 1) * width):
        lane[at.point + i] = lane[at.trial + i]


@kernel
def move(lane: np.ndarray, at: Layout, fraction: float) -> None:
    """The current point goes a `fraction` of the way to the trial point."""
    _, _, _, width = shape(at)
    for i in range((at.n + 1) * width):
        lane[at.point + i] += fraction * (lane[at.trial + i] - lane[at.point + i])
