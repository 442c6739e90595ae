"""The clipped sweeps and the certificate for eight lanes at once.

An entry of `block` is eight numbers, one a lane, and one LLVM vector. Each lane's arithmetic is
that of `_riccati_sweeps`, operation by operation, so that the bits are the same; what those would
multiply by zero, or would not read, is left out. A lane for which sweeps are not the whole story
is not accepted, and is solved by itself from the start.

Offsets and strides of `block` count entries.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from llvmlite import ir
from numba.core import cgutils, types
from numba.extending import intrinsic

from zoac.mpc.solvers._riccati_rows import _fused, kernel
from zoac.mpc.solvers._riccati_sweeps import (
    FREE,
    HIGH,
    HYSTERESIS,
    LOW,
    PINNED,
    first_side,
    stored,
)

LANES = 8
LARGEST = 12
"""Most rows nx + nu, since every product is written out."""

_DOUBLE = ir.DoubleType()
_INDEX = ir.IntType(64)
_ENTRY = ir.VectorType(_DOUBLE, LANES)


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
        n, x, u, pattern, good + 3, 0, gains, inverse, inverse + n * nu, weight,
        weight + (n + 1) * rows, weight + 2 * (n + 1) * rows, side, value, value + nx * nx,
        gradient, gradient + nx, bounds, good, good + 1, good + 2,
    )  # fmt: skip


class _Emitter:
    """Writes instructions on entries of the array that is an intrinsic's first argument."""

    def __init__(self, context: Any, builder: Any, signature: Any, args: Any) -> None:
        self.builder = builder
        self._data = context.make_array(signature.args[0])(context, builder, args[0]).data

    def _pointer(self, offset: Any, index: int) -> Any:
        at = self.builder.add(offset, ir.Constant(_INDEX, index))
        at = self.builder.mul(at, ir.Constant(_INDEX, LANES))
        return self.builder.bitcast(self.builder.gep(self._data, [at]), _ENTRY.as_pointer())

    def load(self, offset: Any, index: int = 0) -> Any:
        return self.builder.load(self._pointer(offset, index), align=8)

    def store(self, value: Any, offset: Any, index: int = 0) -> None:
        self.builder.store(value, self._pointer(offset, index), align=8)

    def row(self, offset: Any, first: int, count: int) -> list[Any]:
        return [self.load(offset, first + i) for i in range(count)]

    def constant(self, number: float) -> Any:
        return ir.Constant(_ENTRY, [number] * LANES)

    def fused(self, x: Any, y: Any, z: Any) -> Any:
        return _fused(self.builder, _ENTRY, x, y, z)

    def chain(self, left: list[Any], right: list[Any], start: Any = None) -> Any:
        """start + sum_k left_k right_k, one after the other; what is None is always zero."""
        total = start
        for x, y in zip(left, right, strict=True):
            if x is None or y is None:
                continue
            total = self.builder.fmul(x, y) if total is None else self.fused(x, y, total)
        return total

    def dot(self, left: list[Any], right: list[Any]) -> Any:
        """The same sum as `_riccati_rows.dot`: even and odd terms apart."""
        sums = [self.chain(left[first::2], right[first::2]) for first in (0, 1)]
        given = [part for part in sums if part is not None]
        return self.builder.fadd(*given) if len(given) == 2 else (given or [self.constant(0.0)])[0]

    def lesser(self, x: Any, y: Any) -> Any:
        return self.builder.select(self.builder.fcmp_ordered("<", x, y), x, y)

    def greater(self, x: Any, y: Any) -> Any:
        return self.builder.select(self.builder.fcmp_ordered(">", x, y), x, y)

    def where(self, condition: Any, x: Any, y: Any) -> Any:
        return self.builder.select(condition, x, y)

    def is_side(self, side: Any, which: float) -> Any:
        return self.builder.fcmp_ordered("==", side, self.constant(which))

    def keep_where(self, condition: Any, offset: Any) -> None:
        """Set to 0 the numbers of an entry for which `condition` does not hold."""
        kept = self.builder.select(condition, self.load(offset), self.constant(0.0))
        self.store(kept, offset)


class _Dynamics:
    """[A B] of one stage, as the emitter sees it."""

    def __init__(self, emit: _Emitter, offset: Any, pattern: Any) -> None:
        self._emit, self._offset, self.sizes = emit, offset, _sizes(pattern)
        self._has = [[kind != types.none for kind in row] for row in pattern]

    def entry(self, i: int, j: int) -> Any:
        rows = len(self._has[0])
        return self._emit.load(self._offset, i * rows + j) if self._has[i][j] else None

    def column(self, j: int) -> list[Any]:
        return [self.entry(i, j) for i in range(len(self._has))]

    def row(self, i: int) -> list[Any]:
        return [self.entry(i, j) for j in range(len(self._has[0]))]


def _sizes(pattern: Any) -> tuple[int, int, int]:
    """nx, nu and nx + nu; nothing, so that no code is written, where it would never run."""
    nx, rows = len(pattern), len(pattern[0])
    return (nx, rows - nx, rows) if rows <= LARGEST else (0, 0, 0)


def _rows_of_lanes(
    context: Any, builder: Any, signature: Any, args: Any, source: int, starts: int, offset: int
) -> list[Any]:
    """Pointers into array `source`, at starts[lane] + offset, all three arguments by position."""
    data = context.make_array(signature.args[source])(context, builder, args[source]).data
    begins = context.make_array(signature.args[starts])(context, builder, args[starts]).data
    rows = []
    for lane in range(LANES):
        start = builder.load(builder.gep(begins, [ir.Constant(_INDEX, lane)]))
        rows.append(builder.gep(data, [builder.add(start, args[offset])]))
    return rows


def _across(builder: Any, rows: list[Any], i: int) -> Any:
    """An entry made of number i of every row."""
    entry = ir.Constant(_ENTRY, ir.Undefined)
    for lane, row in enumerate(rows):
        number = builder.load(builder.gep(row, [ir.Constant(_INDEX, i)]))
        entry = builder.insert_element(entry, number, ir.Constant(ir.IntType(32), lane))
    return entry


@intrinsic
def _gather(
    typingctx: Any, block: Any, out: Any, source: Any, starts: Any, offset: Any, count: Any
) -> Any:
    """Entry out + i = source[starts[lane] + offset + i] of the eight lanes, i in `count`."""

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        emit = _Emitter(context, builder, signature, args)
        rows = _rows_of_lanes(context, builder, signature, args, 2, 3, 4)
        for i in range(count.count):
            emit.store(_across(builder, rows, i), args[1], i)
        return context.get_dummy_value()

    return types.void(block, out, source, starts, offset, count), codegen


@intrinsic
def _gather_dynamics(
    typingctx: Any,
    block: Any,
    out: Any,
    a: Any,
    starts_a: Any,
    offset_a: Any,
    b: Any,
    starts_b: Any,
    offset_b: Any,
    pattern: Any,
) -> Any:
    """The entries of [A B] that can be other than zero, of one stage."""
    nx, nu, rows = _sizes(pattern)

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        emit = _Emitter(context, builder, signature, args)
        from_a = _rows_of_lanes(context, builder, signature, args, 2, 3, 4)
        from_b = _rows_of_lanes(context, builder, signature, args, 5, 6, 7)
        for i in range(nx):
            for j in range(rows):
                if pattern[i][j] == types.none:
                    continue
                if j < nx:
                    entry = _across(builder, from_a, i * nx + j)
                else:
                    entry = _across(builder, from_b, i * nu + j - nx)
                emit.store(entry, args[1], i * rows + j)
        return context.get_dummy_value()

    arguments = (block, out, a, starts_a, offset_a, b, starts_b, offset_b, pattern)
    return types.void(*arguments), codegen


@intrinsic
def _eliminate(typingctx: Any, block: Any, places: Any, pattern: Any) -> Any:
    """`_riccati_sweeps._eliminate`: `value` of stage k + 1 to that of k."""
    nx, nu, rows = _sizes(pattern)

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        emit = _Emitter(context, builder, signature, args)
        at = cgutils.unpack_tuple(builder, args[1])
        value, product, dynamics, weight, gains, inverse, side, good = at
        both = _Dynamics(emit, dynamics, pattern)
        for i in range(nx):
            left = emit.row(value, i * nx, nx)
            for j in range(rows):
                emit.store(emit.chain(left, both.column(j)), product, i * rows + j)

        def hessian(i: int, columns: int, eliminated: list[Any]) -> list[Any]:
            left, row = both.column(i), []
            for j in range(columns):
                right = [emit.load(product, k * rows + j) for k in range(nx)]
                row.append(emit.chain(left, right, emit.load(weight, i) if i == j else None))
            for other, minus_inverse, free in eliminated:
                factor = builder.fmul(minus_inverse, other[i])
                factor = emit.where(free, factor, emit.constant(0.0))
                row = [emit.fused(factor, other[j], row[j]) for j in range(columns)]
            return row

        eliminated: list[Any] = []
        for j in range(nu - 1, -1, -1):
            row = hessian(nx + j, nx + j + 1, eliminated)
            pivot = row[nx + j]
            emit.keep_where(builder.fcmp_ordered(">", pivot, emit.constant(0.0)), good)
            inverted = builder.fdiv(emit.constant(1.0), pivot)
            emit.store(inverted, inverse, j)
            for i, number in enumerate(row):
                emit.store(number, gains, j * rows + i)
            free = emit.is_side(emit.load(side, j), FREE)
            eliminated.append((row, builder.fneg(inverted), free))
        for i in range(nx):
            for j, number in enumerate(hessian(i, nx, eliminated)):
                emit.store(number, value, i * nx + j)
        return context.get_dummy_value()

    return types.void(block, places, pattern), codegen


def _stage_gradient(
    emit: _Emitter,
    both: _Dynamics,
    gradient: Any,
    weight: Any,
    offset: Any,
    point: Any,
) -> list[Any]:
    """`_riccati_sweeps._stage_gradient`, the gradient of the stage's own cost included."""
    nx, _, rows = both.sizes
    left, row = emit.row(gradient, 0, nx), []
    for j in range(rows):
        error = emit.builder.fadd(emit.load(offset, j), emit.load(point, j))
        local = emit.builder.fmul(emit.load(weight, j), error)
        row.append(emit.chain(left, both.column(j), local))
    return row


@intrinsic
def _pull(typingctx: Any, block: Any, places: Any, pattern: Any) -> Any:
    """The linear part of `_riccati_sweeps.backward` for one stage."""
    nx, nu, rows = _sizes(pattern)

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        emit = _Emitter(context, builder, signature, args)
        gradient, dynamics, weight, offset, point, gains, inverse, side, pull = (
            cgutils.unpack_tuple(builder, args[1])
        )
        both = _Dynamics(emit, dynamics, pattern)
        row = _stage_gradient(emit, both, gradient, weight, offset, point)
        for j in range(nu - 1, -1, -1):
            emit.store(row[nx + j], pull, j)
            factor = builder.fmul(builder.fneg(row[nx + j]), emit.load(inverse, j))
            free = emit.is_side(emit.load(side, j), FREE)
            factor = emit.where(free, factor, emit.constant(0.0))
            for i in range(nx + j):
                row[i] = emit.fused(factor, emit.load(gains, j * rows + i), row[i])
        for i in range(nx):
            emit.store(row[i], gradient, i)
        return context.get_dummy_value()

    return types.void(block, places, pattern), codegen


@intrinsic
def _advance(typingctx: Any, block: Any, places: Any, pattern: Any) -> Any:
    """`_riccati_sweeps.forward_clipped` for one stage, whose state is `ahead`; the new row of the
    point takes the place of the old one."""
    nx, nu, rows = _sizes(pattern)

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        emit = _Emitter(context, builder, signature, args)
        at = cgutils.unpack_tuple(builder, args[1])
        point, ahead, dynamics, gains, inverse, pull, offset, *rest = at
        side, bounds, good, changed = rest
        both, row = _Dynamics(emit, dynamics, pattern), emit.row(ahead, 0, nx)
        step = [builder.fsub(row[i], emit.load(point, i)) for i in range(nx)]
        for i in range(nx):
            emit.store(row[i], point, i)
        for j in range(nu):
            total = emit.dot(emit.row(gains, j * rows, nx), step[:nx])
            total = builder.fadd(emit.load(pull, j), total)
            for i in range(nx, nx + j):
                total = builder.fadd(total, builder.fmul(emit.load(gains, j * rows + i), step[i]))
            old, nominal = emit.load(point, nx + j), emit.load(offset, nx + j)
            wish = builder.fsub(old, builder.fmul(total, emit.load(inverse, j)))
            emit.keep_where(builder.fcmp_ordered("==", wish, wish), good)
            low = builder.fsub(emit.load(bounds, j), nominal)
            high = builder.fsub(emit.load(bounds, nu + j), nominal)
            before = emit.load(side, j)
            after = _new_side(emit, before, wish, low, high)
            emit.store(after, side, j)
            moved = builder.fcmp_ordered("!=", after, before)
            emit.store(emit.where(moved, emit.constant(1.0), emit.load(changed)), changed)
            value = emit.lesser(emit.greater(wish, low), high)
            value = emit.where(emit.is_side(after, LOW), low, value)
            value = emit.where(emit.is_side(after, HIGH), high, value)
            emit.store(value, point, nx + j)
            row.append(value)
            step.append(builder.fsub(value, old))
        for i in range(nx):
            emit.store(emit.dot(both.row(i), row), ahead, i)
        return context.get_dummy_value()

    return types.void(block, places, pattern), codegen


def _new_side(emit: _Emitter, before: Any, wish: Any, low: Any, high: Any) -> Any:
    """Which side an input is on that would like to be at `wish`."""
    builder, one = emit.builder, emit.constant(1.0)
    size = emit.greater(one, emit.greater(wish, builder.fneg(wish)))
    margin = emit.lesser(builder.fsub(high, low), size)
    margin = builder.fmul(emit.constant(HYSTERESIS), margin)
    upper = emit.where(
        emit.is_side(before, HIGH), builder.fsub(high, margin), builder.fadd(high, margin)
    )
    lower = emit.where(
        emit.is_side(before, LOW), builder.fadd(low, margin), builder.fsub(low, margin)
    )
    below, above = (builder.fcmp_ordered("<", x, y) for x, y in ((wish, lower), (upper, wish)))
    after = emit.where(below, emit.constant(LOW), emit.constant(FREE))
    after = emit.where(above, emit.constant(HIGH), after)
    return emit.where(emit.is_side(before, PINNED), before, after)


@intrinsic
def _certify(typingctx: Any, block: Any, places: Any, pattern: Any) -> Any:
    """`_riccati_sweeps.optimality_error` for one stage."""
    nx, nu, _ = _sizes(pattern)

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        emit = _Emitter(context, builder, signature, args)
        gradient, dynamics, weight, offset, point, inverse, bounds, good, worst = (
            cgutils.unpack_tuple(builder, args[1])
        )
        both = _Dynamics(emit, dynamics, pattern)
        row = _stage_gradient(emit, both, gradient, weight, offset, point)
        zero, one, infinite = (emit.constant(number) for number in (0.0, 1.0, np.inf))
        for j in range(nu):
            nominal, deviation = emit.load(offset, nx + j), emit.load(point, nx + j)
            low = builder.fsub(emit.load(bounds, j), nominal)
            high = builder.fsub(emit.load(bounds, nu + j), nominal)
            newton = builder.fmul(row[nx + j], emit.load(inverse, j))
            size = emit.greater(newton, builder.fneg(newton))
            emit.keep_where(builder.fcmp_ordered("<", size, infinite), good)
            target = emit.lesser(emit.greater(builder.fsub(deviation, newton), low), high)
            error = builder.fsub(deviation, target)
            error = emit.greater(error, builder.fneg(error))
            span = builder.fsub(high, low)
            usable = builder.and_(
                builder.fcmp_ordered("<", zero, span), builder.fcmp_ordered("<", span, infinite)
            )
            scale = builder.select(usable, span, one)
            before = emit.load(worst)
            more = builder.fcmp_ordered(">", error, builder.fmul(before, scale))
            emit.store(builder.select(more, builder.fdiv(error, scale), before), worst)
        for i in range(nx):
            emit.store(row[i], gradient, i)
        return context.get_dummy_value()

    return types.void(block, places, pattern), codegen


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
    """Write the problems `lanes` (8,) into `block`."""
    n, nx, nu = at.n, len(at.x), len(at.u)
    rows = nx + nu
    states, inputs, a, b, reference, state_weights, input_weights = data
    by_x, by_u, by_state = lanes * (n * nx), lanes * (n * nu), lanes * ((n + 1) * nx)
    by_a, by_b = lanes * (n * nx * nx), lanes * (n * nx * nu)
    for k in range(n):
        _gather_dynamics(
            block, at.dynamics + k * nx * rows, a, by_a, k * nx * nx, b, by_b, k * nx * nu,
            at.pattern,
        )  # fmt: skip
        row = k * rows
        _gather(block, at.weight + row + rows, state_weights, by_x, k * nx, at.x)
        _gather(block, at.weight + row + nx, input_weights, by_u, k * nu, at.u)
        _gather(block, at.offset + row + nx, inputs, by_u, k * nu, at.u)
        _gather(block, at.offset + row + rows, states, by_state, (k + 1) * nx, at.x)
        _gather(block, at.point, reference, by_x, k * nx, at.x)
        for i in range(nx * LANES):
            block[(at.offset + row + rows) * LANES + i] -= block[at.point * LANES + i]
    block[at.weight * LANES : (at.weight + nx) * LANES] = 0.0
    block[at.offset * LANES : (at.offset + nx) * LANES] = 0.0
    block[at.point * LANES : (at.point + (n + 1) * rows) * LANES] = 0.0
    block[at.good * LANES : (at.good + 1) * LANES] = 1.0
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
        _eliminate(block, quadratic, at.pattern)
        offset, point = at.offset + row, at.point + row
        linear = (
            at.gradient, dynamics, weight, offset, point, gains, inverse, side, at.pull + m
        )  # fmt: skip
        _pull(block, linear, at.pattern)
    block[at.ahead * LANES : (at.ahead + nx) * LANES] = 0.0
    block[at.changed * LANES : (at.changed + 1) * LANES] = 0.0
    for k in range(n):
        row, m = k * rows, k * nu
        places = (
            at.point + row, at.ahead, at.dynamics + k * nx * rows, at.gains + k * nu * rows,
            at.inverse + m, at.pull + m, at.offset + row, at.side + m, at.bounds, at.good,
            at.changed,
        )  # fmt: skip
        _advance(block, places, at.pattern)
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
        _certify(block, places, at.pattern)


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
