"""The clipped sweeps and the certificate for eight lanes at once.

An entry of `block` is eight numbers, one a lane; offsets and strides count entries. The bits are
those of a lane alone (`stages`). A lane for which sweeps are not the whole story is not
accepted, and is solved by itself from the start.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from .entries import LANES, gather, gather_dynamics
from .rows import kernel
from .stages import advance, certify, eliminate, pull
from .sweeps import first_side, stored


class Block(NamedTuple):
    """Where things stand in `block`; for N stages, each as noted."""

    n: int  # N
    x: tuple[int, ...]  # its length is nx
    u: tuple[int, ...]  # its length is nu
    pattern: Any  # of [A B], nx rows of nx + nu: None where an entry is always zero
    size: int
    dynamics: int  # N (nx, nx + nu): [A_k B_k]
    gains: int  # N (nu, nx + nu): rows of the value's Hessian when its input is eliminated
    inverse: int  # N (nu,): 1 / curvature of the value in each input
    pull: int  # N (nu,): gradient of the value in each input
    weight: int  # N + 1 (nx + nu,), of [x_k, u_k]; zero for x_0
    offset: int  # N + 1 (nx + nu,): [x_k - reference_k, u_k] of the rollout
    point: int  # N + 1 (nx + nu,): deviations from the rollout
    side: int  # N (nu,): LOW, FREE, HIGH or PINNED
    value: int  # (nx, nx): Hessian of the next stage's value
    product: int  # (nx, nx + nu)
    gradient: int  # (nx,): of the next stage's value
    ahead: int  # (nx,): new deviation of the next state
    bounds: int  # 2 (nu,)
    good: int  # 1 where nothing speaks against the lane, else 0
    changed: int  # 1 where an input changed sides in this sweep, else 0
    worst: int  # optimality error
    doubts: int  # 8 entries while loading, one a lane


@kernel
def block_layout(n: int, x: Any, u: Any, pattern: Any) -> Block:
    """Return the layout for `n` stages."""
    nx, nu = len(x), len(u)
    rows = nx + nu
    gains = n * nx * rows
    inverse = gains + n * nu * rows
    weight = inverse + 2 * n * nu
    side = weight + 3 * (n + 1) * rows
    value = side + n * nu
    gradient = value + nx * nx + nx * rows
    bounds = gradient + 2 * nx
    good = bounds + 2 * nu
    return Block(
        n, x, u, pattern, good + 3 + LANES, 0, gains, inverse, inverse + n * nu, weight,
        weight + (n + 1) * rows, weight + 2 * (n + 1) * rows, side, value, value + nx * nx,
        gradient, gradient + nx, bounds, good, good + 1, good + 2,
        good + 3,
    )  # fmt: skip


@kernel
def make_block(at: Block) -> Any:
    """Return the array; it begins at a cache line, as then each entry does."""
    memory = np.empty(at.size * LANES + 8)
    start = -(memory.ctypes.data // 8) % 8
    return memory[start : start + at.size * LANES]


@kernel
def load_batch(
    block: np.ndarray, at: Block, data: Any, low: Any, high: Any, lanes: np.ndarray
) -> None:
    """Write the problems `lanes` (8,) into `block`.

    A lane is good only if its start and all of A and B are finite, which what follows does not
    read, or not all; the certificate sees to the rest.
    """
    n, nx, nu = at.n, len(at.x), len(at.u)
    rows = nx + nu
    states, inputs, a, b, reference, state_weights, input_weights = data
    by_x, by_u, by_state = lanes * (n * nx), lanes * (n * nu), lanes * ((n + 1) * nx)
    by_a, by_b = lanes * (n * nx * nx), lanes * (n * nx * nu)
    block[at.doubts * LANES : (at.doubts + LANES) * LANES] = 0.0
    for k in range(n):
        gather_dynamics(
            block, at.dynamics + k * nx * rows, at.doubts,
            a, by_a, k * nx * nx, b, by_b, k * nx * nu, at.pattern,
        )  # fmt: skip
        row = k * rows
        gather(block, at.weight + row + rows, state_weights, by_x, k * nx, at.x)
        gather(block, at.weight + row + nx, input_weights, by_u, k * nu, at.u)
        gather(block, at.offset + row + nx, inputs, by_u, k * nu, at.u)
        gather(block, at.offset + row + rows, states, by_state, (k + 1) * nx, at.x)
        gather(block, at.point, reference, by_x, k * nx, at.x)
        for i in range(nx * LANES):
            block[(at.offset + row + rows) * LANES + i] -= block[at.point * LANES + i]
    block[at.weight * LANES : (at.weight + nx) * LANES] = 0.0
    block[at.offset * LANES : (at.offset + nx) * LANES] = 0.0
    block[at.point * LANES : (at.point + (n + 1) * rows) * LANES] = 0.0
    for lane in range(LANES):
        doubt = 0.0
        for i in range(nx):
            doubt += states[by_state[lane] + i] - states[by_state[lane] + i]
        for i in range(LANES):
            doubt += block[(at.doubts + lane) * LANES + i]
        block[at.good * LANES + lane] = 1.0 if doubt == 0.0 else 0.0
    for j in range(nu):
        lowest, highest = low[j], high[j]
        block[(at.bounds + j) * LANES : (at.bounds + j + 1) * LANES] = lowest
        block[(at.bounds + nu + j) * LANES : (at.bounds + nu + j + 1) * LANES] = highest
        for k in range(n):
            nominal, side = (at.offset + k * rows + nx + j) * LANES, (at.side + k * nu + j) * LANES
            for lane in range(LANES):
                block[side + lane] = first_side(block[nominal + lane], lowest, highest)


@kernel
def _begin(block: np.ndarray, at: Block) -> None:
    """Gradient of the last stage's own cost at the point."""
    last = at.n * (len(at.x) + len(at.u)) * LANES
    for i in range(len(at.x) * LANES):
        error = block[at.offset * LANES + last + i] + block[at.point * LANES + last + i]
        block[at.gradient * LANES + i] = block[at.weight * LANES + last + i] * error


@kernel
def sweep_batch(block: np.ndarray, at: Block) -> None:
    """One backward and one forward pass; then `changed` says whether an input changed sides."""
    n, nx, nu = at.n, len(at.x), len(at.u)
    rows = nx + nu
    _begin(block, at)
    block[at.value * LANES : (at.value + nx * nx) * LANES] = 0.0
    for i in range(nx):
        for lane in range(LANES):
            weight = block[(at.weight + n * rows + i) * LANES + lane]
            block[(at.value + i * nx + i) * LANES + lane] = weight
    for k in range(n - 1, -1, -1):
        dynamics, row, m = at.dynamics + k * nx * rows, k * rows, k * nu
        gains = at.gains + k * nu * rows
        weight, inverse, side = at.weight + row, at.inverse + m, at.side + m
        quadratic = (at.value, at.product, dynamics, weight, gains, inverse, side, at.good)
        eliminate(block, quadratic, at.pattern)
        offset, point = at.offset + row, at.point + row
        linear = (
            at.gradient, dynamics, weight, offset, point, gains, inverse, side, at.pull + m
        )  # fmt: skip
        pull(block, linear, at.pattern)
    block[at.ahead * LANES : (at.ahead + nx) * LANES] = 0.0
    block[at.changed * LANES : (at.changed + 1) * LANES] = 0.0
    for k in range(n):
        row, m = k * rows, k * nu
        places = (
            at.point + row, at.ahead, at.dynamics + k * nx * rows, at.gains + k * nu * rows,
            at.inverse + m, at.pull + m, at.offset + row, at.side + m, at.bounds, at.good,
            at.changed,
        )  # fmt: skip
        advance(block, places, at.pattern)
    for i in range(nx * LANES):
        block[(at.point + n * rows) * LANES + i] = block[at.ahead * LANES + i]


@kernel
def certify_batch(block: np.ndarray, at: Block) -> None:
    """Write the optimality error of the point to `worst`."""
    n, nx, nu = at.n, len(at.x), len(at.u)
    rows = nx + nu
    _begin(block, at)
    block[at.worst * LANES : (at.worst + 1) * LANES] = 0.0
    for k in range(n - 1, -1, -1):
        row = k * rows
        places = (
            at.gradient, at.dynamics + k * nx * rows, at.weight + row, at.offset + row,
            at.point + row, at.inverse + k * nu, at.bounds, at.good, at.worst,
        )  # fmt: skip
        certify(block, places, at.pattern)


@kernel
def store_plan(
    block: np.ndarray, at: Block, lane: int, low: np.ndarray, high: np.ndarray, plan: np.ndarray
) -> None:
    """Write a lane's inputs into `plan` (N, nu)."""
    nx, nu = len(at.x), len(at.u)
    for k in range(at.n):
        for j in range(nu):
            i = k * (nx + nu) + nx + j
            nominal = block[(at.offset + i) * LANES + lane]
            value = nominal + block[(at.point + i) * LANES + lane]
            side = block[(at.side + k * nu + j) * LANES + lane]
            plan[k, j] = stored(side, value, low[j], high[j])
