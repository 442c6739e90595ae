"""One stage of the clipped sweeps and of the certificate, for eight lanes in step.

Each lane's arithmetic is that of `sweeps`, operation by operation, so that the bits are
the same; what those would multiply by zero, or would not read, is left out.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numba.core import cgutils, types
from numba.extending import intrinsic

from .entries import Dynamics, Emitter, sizes, small
from .sweeps import FREE, HIGH, HYSTERESIS, LOW, PINNED


def _stage(write: Callable[[Emitter, list[Any], Any], None]) -> Any:
    """Return the intrinsic (block, places, pattern) whose code `write` emits."""

    def stage(typingctx: Any, block: Any, places: Any, pattern: Any) -> Any:
        def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            if small(pattern):
                emit = Emitter(context, builder, signature, args)
                write(emit, cgutils.unpack_tuple(builder, args[1]), pattern)
            return context.get_dummy_value()

        return types.void(block, places, pattern), codegen

    stage.__name__ = write.__name__
    return intrinsic(stage)


@_stage
def eliminate(emit: Emitter, at: list[Any], pattern: Any) -> None:
    """`sweeps._eliminate`: `value` of stage k + 1 to that of k."""
    builder = emit.builder
    nx, nu, rows = sizes(pattern)
    value, product, dynamics, weight, gains, inverse, side, good = at
    both = Dynamics(emit, dynamics, pattern)
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


def _stage_gradient(emit: Emitter, at: list[Any], pattern: Any) -> list[Any]:
    """`sweeps._stage_gradient`, the gradient of the stage's own cost included."""
    nx, _, rows = sizes(pattern)
    gradient, dynamics, weight, offset, point = at
    both = Dynamics(emit, dynamics, pattern)
    left, row = emit.row(gradient, 0, nx), []
    for j in range(rows):
        error = emit.builder.fadd(emit.load(offset, j), emit.load(point, j))
        local = emit.builder.fmul(emit.load(weight, j), error)
        row.append(emit.chain(left, both.column(j), local))
    return row


@_stage
def pull(emit: Emitter, at: list[Any], pattern: Any) -> None:
    """The linear part of `sweeps.backward` for one stage."""
    builder = emit.builder
    nx, nu, rows = sizes(pattern)
    gradient, gains, inverse, side, pull = at[0], *at[5:]
    row = _stage_gradient(emit, at[:5], pattern)
    for j in range(nu - 1, -1, -1):
        emit.store(row[nx + j], pull, j)
        factor = builder.fmul(builder.fneg(row[nx + j]), emit.load(inverse, j))
        free = emit.is_side(emit.load(side, j), FREE)
        factor = emit.where(free, factor, emit.constant(0.0))
        for i in range(nx + j):
            row[i] = emit.fused(factor, emit.load(gains, j * rows + i), row[i])
    for i in range(nx):
        emit.store(row[i], gradient, i)


@_stage
def advance(emit: Emitter, at: list[Any], pattern: Any) -> None:
    """`sweeps.forward_clipped` for one stage, whose state is `ahead`; the new row of the
    point takes the place of the old one."""
    builder = emit.builder
    nx, nu, rows = sizes(pattern)
    point, ahead, dynamics, gains, inverse, pull, offset, *rest = at
    side, bounds, good, changed = rest
    both, row = Dynamics(emit, dynamics, pattern), emit.row(ahead, 0, nx)
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


def _new_side(emit: Emitter, before: Any, wish: Any, low: Any, high: Any) -> Any:
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


@_stage
def certify(emit: Emitter, at: list[Any], pattern: Any) -> None:
    """`sweeps.optimality_error` for one stage."""
    builder = emit.builder
    nx, nu, _ = sizes(pattern)
    gradient, offset, point, inverse, bounds, good, worst = at[0], *at[3:]
    row = _stage_gradient(emit, at[:5], pattern)
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
        scale = emit.where(usable, span, one)
        before = emit.load(worst)
        more = builder.fcmp_ordered(">", error, builder.fmul(before, scale))
        emit.store(emit.where(more, builder.fdiv(error, scale), before), worst)
    for i in range(nx):
        emit.store(row[i], gradient, i)
