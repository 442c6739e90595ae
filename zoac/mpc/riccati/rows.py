"""Arithmetic on short rows of a flat array, as SIMD instructions.

numba leaves loops over a few numbers scalar, because it cannot prove that its arrays do not
overlap; one row written as one LLVM vector is six to eight times as fast for six states and two
inputs. The compiler splits a row into whatever the processor has, and fused
multiply-add is exactly specified, so the bits do not depend on the processor.

All offsets count elements; `count` and `width` are tuples whose lengths are the sizes, which
makes them compile-time constants.
"""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba import njit
from numba.core import cgutils, types
from numba.extending import intrinsic

# Python's division raises at zero; ours gives infinity, which the certificate catches.
# Python calls none of these itself; leaving its wrappers out saves time to compile.
_options = {"error_model": "numpy", "no_cpython_wrapper": True, "no_cfunc_wrapper": True}
kernel = njit(**_options)
inlined = njit(inline="always", **_options)

_DOUBLE = ir.DoubleType()
_INDEX = ir.IntType(64)
_LANE = ir.IntType(32)
_UNROLLED = 16  # rows written out one by one; beyond, a loop keeps the code small


def _pointer(context: Any, builder: Any, signature: Any, args: Any, offset: Any) -> Any:
    """Address of element `offset` of the array that is the first argument."""
    data = context.make_array(signature.args[0])(context, builder, args[0]).data
    return builder.gep(data, [offset])


def _row_pointer(builder: Any, pointer: Any, row: ir.VectorType) -> Any:
    return builder.bitcast(pointer, row.as_pointer())


def _splat(builder: Any, number: Any, row: ir.VectorType) -> Any:
    undefined = ir.Constant(row, ir.Undefined)
    first = builder.insert_element(undefined, number, ir.Constant(_LANE, 0))
    zeros = ir.Constant(ir.VectorType(_LANE, row.count), [0] * row.count)
    return builder.shuffle_vector(first, undefined, zeros)


def fused(builder: Any, kind: Any, x: Any, y: Any, z: Any) -> Any:
    """Return x * y + z, rounded once."""
    name = f"llvm.fma.v{kind.count}f64" if isinstance(kind, ir.VectorType) else "llvm.fma.f64"
    signature = ir.FunctionType(kind, [kind] * 3)
    return builder.call(cgutils.get_or_insert_function(builder.module, signature, name), [x, y, z])


def _load_row(builder: Any, pointer: Any, row: ir.VectorType) -> Any:
    return builder.load(_row_pointer(builder, pointer, row), align=8)


def _store_row(builder: Any, value: Any, pointer: Any, row: ir.VectorType) -> None:
    builder.store(value, _row_pointer(builder, pointer, row), align=8)


@intrinsic
def multiply(
    typingctx: Any,
    x: Any,
    out: Any,
    left: Any,
    row_stride: Any,
    step: Any,
    right: Any,
    diagonal: Any,
    addend: Any,
    rows: Any,
    count: Any,
    width: Any,
) -> Any:
    """out = left right, plus a diagonal or an addend if one is given.

    out is (rows, width); left[i, k] stands at left + i row_stride + k step; right is
    (count, width); diagonal is where (rows,) numbers are, addend where (rows, width) are, or
    None. A single row may go where it came from.
    """
    row = ir.VectorType(_DOUBLE, width.count)

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        pointers = [_pointer(context, builder, signature, args, args[i]) for i in (1, 2, 5)]
        target, factors, first = pointers
        sources = [
            _load_row(builder, builder.gep(first, [ir.Constant(_INDEX, k * width.count)]), row)
            for k in range(count.count)
        ]

        def emit(i: Any) -> None:
            total = None
            if diagonal != types.none:
                start = _pointer(context, builder, signature, args, args[6])
                number = builder.load(builder.gep(start, [i]))
                zeros = ir.Constant(row, [0.0] * width.count)
                total = builder.insert_element(zeros, number, builder.trunc(i, _LANE))
            elif addend != types.none:
                start = _pointer(context, builder, signature, args, args[7])
                at = builder.gep(start, [builder.mul(i, ir.Constant(_INDEX, width.count))])
                total = _load_row(builder, at, row)
            factor = builder.gep(factors, [builder.mul(i, args[3])])
            for k, source in enumerate(sources):
                index = builder.mul(ir.Constant(_INDEX, k), args[4])
                a = _splat(builder, builder.load(builder.gep(factor, [index])), row)
                if total is None:
                    total = builder.fmul(a, source)
                else:
                    total = fused(builder, row, a, source, total)
            at = builder.gep(target, [builder.mul(i, ir.Constant(_INDEX, width.count))])
            _store_row(builder, total, at, row)

        if rows.count <= _UNROLLED:
            for i in range(rows.count):
                emit(ir.Constant(_INDEX, i))
        else:
            with cgutils.for_range(builder, ir.Constant(_INDEX, rows.count)) as loop:
                emit(loop.index)
        return context.get_dummy_value()

    arguments = (x, out, left, row_stride, step, right, diagonal, addend, rows, count, width)
    return types.void(*arguments), codegen


@intrinsic
def add_row(typingctx: Any, x: Any, out: Any, factor: Any, source: Any, width: Any) -> Any:
    """out += factor source, rows of `width`."""
    row = ir.VectorType(_DOUBLE, width.count)

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        target, other = (_pointer(context, builder, signature, args, args[i]) for i in (1, 3))
        old, added = (_load_row(builder, pointer, row) for pointer in (target, other))
        new = fused(builder, row, _splat(builder, args[2], row), added, old)
        _store_row(builder, new, target, row)
        return context.get_dummy_value()

    return types.void(x, out, factor, source, width), codegen


@intrinsic
def weigh(typingctx: Any, x: Any, out: Any, weight: Any, a: Any, b: Any, c: Any, width: Any) -> Any:
    """out = weight (a + b) + c, entry by entry, rows of `width`."""
    row = ir.VectorType(_DOUBLE, width.count)

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        pointers = [_pointer(context, builder, signature, args, args[i]) for i in range(1, 6)]
        by, left, right, extra = (_load_row(builder, p, row) for p in pointers[1:])
        value = fused(builder, row, by, builder.fadd(left, right), extra)
        _store_row(builder, value, pointers[0], row)
        return context.get_dummy_value()

    return types.void(x, out, weight, a, b, c, width), codegen


@intrinsic
def copy_row(typingctx: Any, x: Any, out: Any, source: Any, start: Any, count: Any) -> Any:
    """x[out + i] = source[start + i], i in `count`; `source` is another flat array."""
    row = ir.VectorType(_DOUBLE, count.count)

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        data = context.make_array(signature.args[2])(context, builder, args[2]).data
        value = _load_row(builder, builder.gep(data, [args[3]]), row)
        _store_row(builder, value, _pointer(context, builder, signature, args, args[1]), row)
        return context.get_dummy_value()

    return types.void(x, out, source, start, count), codegen


@intrinsic
def dot(typingctx: Any, x: Any, left: Any, right: Any, count: Any) -> Any:
    """sum_i x[left + i] x[right + i], i in `count`; even and odd terms apart, to wait less."""

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        starts = [_pointer(context, builder, signature, args, args[i]) for i in (1, 2)]
        sums: list[Any] = []
        for i in range(count.count):
            at = [ir.Constant(_INDEX, i)]
            a, b = (builder.load(builder.gep(start, at)) for start in starts)
            if i < 2:
                sums.append(builder.fmul(a, b))
            else:
                sums[i % 2] = fused(builder, _DOUBLE, a, b, sums[i % 2])
        return builder.fadd(*sums) if len(sums) == 2 else sums[0]

    return types.float64(x, left, right, count), codegen
