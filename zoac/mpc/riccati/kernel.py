"""Solve lanes one by one: clipped sweeps, else interior point and active set; then certify."""

from __future__ import annotations

import enum
import hashlib
from pathlib import Path
from typing import Any

import numpy as np
from numba import literal_unroll, njit

from .active_set import active_set
from .batch import (
    block_layout,
    certify_batch,
    load_batch,
    make_block,
    store_plan,
    sweep_batch,
)
from .certificate import REFINE_ABOVE, certified, certified_otherwise
from .entries import LANES, LARGEST
from .interior import interior_point
from .rows import copy_row, kernel
from .sweeps import (
    Layout,
    accept,
    backward,
    first_side,
    forward_clipped,
    lane_layout,
    make_lane,
    place,
    shape,
    stored,
)


class Status(enum.IntEnum):
    """How the solve of one programme ended."""

    SOLVED = 0
    INACCURATE = 1
    ITERATION_LIMIT = 2
    NUMERICAL_FAILURE = 3
    NOT_FINITE = 4


_SOLVED = int(Status.SOLVED)
_INACCURATE = int(Status.INACCURATE)
_ITERATION_LIMIT = int(Status.ITERATION_LIMIT)
_NUMERICAL_FAILURE = int(Status.NUMERICAL_FAILURE)
_NOT_FINITE = int(Status.NOT_FINITE)
_OPEN = -1  # not solved yet
_MIN_LANES = 2  # lanes for which a sweep of eight takes less time than their own


@kernel
def _finite(data: Any, index: int, lanes: int) -> bool:
    """Whether the data of problem `index` hold neither NaN nor infinity."""
    bad = 0
    for array in literal_unroll(data):
        size = len(array) // lanes
        own = array[index * size : (index + 1) * size]  # a slice, or it would not be vectorised
        for i in range(size):
            bad += not np.isfinite(own[i])
    return bad == 0


@kernel
def _flatten(problem: Any) -> Any:
    """Return the seven arrays of a problem, flat."""
    states, inputs, a, b, reference, state_weights, input_weights = problem
    return (
        states.reshape(-1),
        inputs.reshape(-1),
        a.reshape(-1),
        b.reshape(-1),
        reference.reshape(-1),
        state_weights.reshape(-1),
        input_weights.reshape(-1),
    )


@kernel
def _load_bounds(lane: np.ndarray, at: Layout, low: np.ndarray, high: np.ndarray) -> None:
    """Bounds about the rollout's inputs; one that stands at a bound is guessed to stay there."""
    n, nx, nu, width = shape(at)
    for j in range(nu):
        lowest, highest = low[j], high[j]
        for k in range(n):
            m, nominal = k * nu + j, lane[at.offset + k * width + nx + j]
            lane[at.low + m], lane[at.high + m] = lowest - nominal, highest - nominal
            lane[at.side + m] = first_side(nominal, lowest, highest)


@kernel
def _load(
    lane: np.ndarray, at: Layout, data: Any, low: np.ndarray, high: np.ndarray, index: int
) -> None:
    """Write problem `index` into the lane's array; the current point is the rollout."""
    n, nx, nu, width = shape(at)
    states, inputs, a, b, reference, state_weights, input_weights = data
    for k in range(n):
        stage, here = index * n + k, k * width
        for i in range(nx):
            row = at.dynamics + (k * nx + i) * width
            copy_row(lane, row, a, (stage * nx + i) * nx, at.x)
            copy_row(lane, row + nx, b, (stage * nx + i) * nu, at.u)
        copy_row(lane, at.weight + here + width, state_weights, stage * nx, at.x)
        copy_row(lane, at.weight + here + nx, input_weights, stage * nu, at.u)
        copy_row(lane, at.offset + here + nx, inputs, stage * nu, at.u)
        for i in range(nx):
            error = states[(stage + index + 1) * nx + i] - reference[stage * nx + i]
            lane[at.offset + here + width + i] = error
    _load_bounds(lane, at, low, high)
    points = (n + 1) * width
    lane[at.point : at.point + points] = 0.0
    lane[at.slope : at.slope + points] = 0.0
    for k in range(n + 1):
        copy_row(lane, at.curvature + k * width, lane, at.weight + k * width, at.vector)
    for i in range(nx):
        row = at.hessian + (n * (nx + nu) + i) * width
        lane[row + i] = lane[at.weight + n * width + i]


@kernel
def _sweep(lane: np.ndarray, at: Layout, limit: int) -> tuple[int, bool]:
    """Sweep until no input changes sides.

    Returns the number of factorisations, -1 where one failed, and whether it ended within
    `limit`.
    """
    changed = at.n - 1
    for count in range(1, limit + 1):
        if not backward(lane, at, changed):
            return -1, False
        changed = forward_clipped(lane, at)
        accept(lane, at)
        if changed < 0:
            return count, True
    return limit, False


@kernel
def _solve_lane(
    lane: np.ndarray, at: Layout, robust: bool, sweeps: int, limit: int
) -> tuple[int, int]:
    """Solve the loaded lane; returns status and number of factorisations."""
    # Even the robust way needs one factorisation first, for the scale of the inputs.
    used, ended = _sweep(lane, at, 1 if robust else sweeps)
    if used < 0:
        return _NUMERICAL_FAILURE, 0
    if ended and not robust and certified(lane, at):
        return _SOLVED, used
    count = interior_point(lane, at)
    if count < 0:
        return _NUMERICAL_FAILURE, used
    used += count
    count, ended = active_set(lane, at, limit)
    if count < 0:
        return _NUMERICAL_FAILURE, used
    used += count
    if certified(lane, at) or certified_otherwise(lane, at):
        return _SOLVED, used
    return (_INACCURATE if ended else _ITERATION_LIMIT), used


@kernel
def _explain(at: Layout, status: int, data: Any, index: int, lanes: int) -> int:
    """Return `status`, or that the data are not finite, where that is the reason.

    Data that are not finite spoil the certificate; all but the start, which has no part in it.
    """
    start = 0.0
    for i in range(len(at.x)):
        start += abs(data[0][index * (at.n + 1) * len(at.x) + i])
    doubtful = status != _SOLVED or not start < np.inf
    return _NOT_FINITE if doubtful and not _finite(data, index, lanes) else status


@kernel
def _store(
    lane: np.ndarray,
    at: Layout,
    low: np.ndarray,
    high: np.ndarray,
    usable: bool,
    plan: np.ndarray,
) -> None:
    """Write the inputs of the current point, or the rollout's where there is nothing to use."""
    nu = len(at.u)
    for m in range(at.n * nu):
        k, j, w = m // nu, m % nu, place(at, m)
        value = lane[at.offset + w]
        if usable:
            value = stored(lane[at.side + m], value + lane[at.point + w], low[j], high[j])
        plan[k, j] = value


@kernel
def _solve_in_batches(
    at: Layout,
    pattern: Any,
    data: Any,
    low: np.ndarray,
    high: np.ndarray,
    sweeps: int,
    plans: np.ndarray,
    status: np.ndarray,
    iterations: np.ndarray,
) -> None:
    """Solve the lanes for which sweeps do and no refinement is needed; leave the others open."""
    count = len(plans)
    stands = block_layout(at.n, at.x, at.u, pattern)
    block = make_block(stands)
    lanes = np.empty(LANES, np.int64)
    sweeping = np.empty(LANES, np.bool_)
    for first in range(0, count, LANES):
        for i in range(LANES):
            lanes[i] = min(first + i, count - 1)
            sweeping[i] = first + i < count
        load_batch(block, stands, data, low, high, lanes)
        for used in range(1, sweeps + 1):
            if np.sum(sweeping) < _MIN_LANES:
                break
            sweep_batch(block, stands)
            ended = False
            for i in range(LANES):
                ended |= sweeping[i] and block[stands.changed * LANES + i] == 0.0
            if ended:
                certify_batch(block, stands)
            for i in range(LANES):
                if block[stands.good * LANES + i] != 1.0:
                    sweeping[i] = False
                if not sweeping[i] or block[stands.changed * LANES + i] != 0.0:
                    continue
                sweeping[i] = False
                index = first + i
                error = block[stands.worst * LANES + i]
                if error <= REFINE_ABOVE:
                    store_plan(block, stands, i, low, high, plans[index])
                    status[index], iterations[index] = _SOLVED, used


def _compile(source: str) -> Any:
    """Return the compiled entry point.

    numba's cache looks at the date of one file only, but at the values in a function's closure
    too: `source`, a digest of the other files, keeps it from running stale code.
    """

    @njit(cache=True, nogil=True, error_model="numpy")
    def solve_lanes(
        problem: Any,
        low: np.ndarray,
        high: np.ndarray,
        sizes: Any,
        robust: bool,
        sweeps: int,
        limit: int,
        plans: np.ndarray,
        status: np.ndarray,
        iterations: np.ndarray,
    ) -> bool:
        """Solve every lane of `problem`, the first seven arguments of `solve_about` in order.

        `sizes` are three tuples whose lengths are nx, nu and the width of a stored row, and the
        pattern of `batch.Block`. Returns False, having done nothing, where the bounds
        are not in order.
        """
        for j in range(len(low)):
            if not low[j] <= high[j]:
                return False
        at = lane_layout(plans.shape[1], sizes[0], sizes[1], sizes[2])
        data = _flatten(problem)
        status[:] = _OPEN
        if not robust and len(at.row) <= LARGEST:
            _solve_in_batches(at, sizes[3], data, low, high, sweeps, plans, status, iterations)
        remaining = np.flatnonzero(status == _OPEN)
        lane = make_lane(at) if len(remaining) else np.empty(0)
        for index in remaining:
            _load(lane, at, data, low, high, index)
            outcome, iterations[index] = _solve_lane(lane, at, robust, sweeps, limit)
            outcome = _explain(at, outcome, data, index, len(plans))
            usable = outcome not in (_NOT_FINITE, _NUMERICAL_FAILURE)
            _store(lane, at, low, high, usable, plans[index])
            status[index] = outcome
        return len(source) > 0  # always: `source` must be used to be in the closure

    return solve_lanes


SOURCE_FILES = sorted(Path(__file__).parent.glob("*.py"))
"""An edit to any of them compiles anew."""

solve_lanes = _compile(
    hashlib.sha256(b"".join(path.read_bytes() for path in SOURCE_FILES)).hexdigest()
)
