"""Entries of eight numbers, one a lane, each an LLVM vector: what `stages` is made of.

Offsets count entries. A lane is one of eight problems solved in step.
"""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba.core import types
from numba.extending import intrinsic

from .rows import fused

LANES = 8
LARGEST = 12
"""Most rows nx + nu, since every product is written out."""

_DOUBLE = ir.DoubleType()
_INDEX = ir.IntType(64)
_ENTRY = ir.VectorType(_DOUBLE, LANES)


class Emitter:
    """Writes instructions on entries of the array that is an intrinsic's first argument."""

    def __init__(self, context: Any, builder: Any, signature: Any, args: Any) -> None:
        self.builder = builder
        self._data = context.make_array(signature.args[0])(context, builder, args[0]).data

    def _pointer(self, offset: Any, index: int) -> Any:
        at = self.builder.add(offset, ir.Constant(_INDEX, index))
        at = self.builder.mul(at, ir.Constant(_INDEX, LANES))
        return self.builder.bitcast(self.builder.gep(self._data, [at]), _ENTRY.as_pointer())

    def load(self, offset: Any, index: int = 0) -> Any:
        """Read entry offset + index."""
        return self.builder.load(self._pointer(offset, index), align=8)

    def store(self, value: Any, offset: Any, index: int = 0) -> None:
        """Write entry offset + index."""
        self.builder.store(value, self._pointer(offset, index), align=8)

    def row(self, offset: Any, first: int, count: int) -> list[Any]:
        """Read `count` entries from offset + first on."""
        return [self.load(offset, first + i) for i in range(count)]

    def constant(self, number: float) -> Any:
        """Return an entry of eight times the same number."""
        return ir.Constant(_ENTRY, [number] * LANES)

    def fused(self, x: Any, y: Any, z: Any) -> Any:
        """Return x y + z, rounded once."""
        return fused(self.builder, _ENTRY, x, y, z)

    def chain(self, left: list[Any], right: list[Any], start: Any = None) -> Any:
        """start + sum_k left_k right_k, one after the other; what is None is always zero."""
        total = start
        for x, y in zip(left, right, strict=True):
            if x is None or y is None:
                continue
            total = self.builder.fmul(x, y) if total is None else self.fused(x, y, total)
        return self.constant(0.0) if total is None else total

    def dot(self, left: list[Any], right: list[Any]) -> Any:
        """The same sum as `rows.dot`: even and odd terms apart."""
        even, odd = (self.chain(left[first::2], right[first::2]) for first in (0, 1))
        return self.builder.fadd(even, odd)

    def lesser(self, x: Any, y: Any) -> Any:
        """Return x where it is less, else y."""
        return self.builder.select(self.builder.fcmp_ordered("<", x, y), x, y)

    def greater(self, x: Any, y: Any) -> Any:
        """Return x where it is greater, else y."""
        return self.builder.select(self.builder.fcmp_ordered(">", x, y), x, y)

    def where(self, condition: Any, x: Any, y: Any) -> Any:
        """Return x where `condition` holds, else y."""
        return self.builder.select(condition, x, y)

    def is_side(self, side: Any, which: float) -> Any:
        """Return whether inputs are on side `which`."""
        return self.builder.fcmp_ordered("==", side, self.constant(which))

    def keep_where(self, condition: Any, offset: Any) -> None:
        """Set to 0 the numbers of an entry for which `condition` does not hold."""
        kept = self.builder.select(condition, self.load(offset), self.constant(0.0))
        self.store(kept, offset)


class Dynamics:
    """[A B] of one stage, as the emitter sees it."""

    def __init__(self, emit: Emitter, offset: Any, pattern: Any) -> None:
        self._emit, self._offset = emit, offset
        self._has = [[kind != types.none for kind in row] for row in pattern]

    def entry(self, i: int, j: int) -> Any:
        """Return entry (i, j), None where it is always zero."""
        rows = len(self._has[0])
        return self._emit.load(self._offset, i * rows + j) if self._has[i][j] else None

    def column(self, j: int) -> list[Any]:
        """Return the entries of column j."""
        return [self.entry(i, j) for i in range(len(self._has))]

    def row(self, i: int) -> list[Any]:
        """Return the entries of row i."""
        return [self.entry(i, j) for j in range(len(self._has[0]))]


def sizes(pattern: Any) -> tuple[int, int, int]:
    """Return nx, nu and nx + nu."""
    nx, rows = len(pattern), len(pattern[0])
    return nx, rows - nx, rows


def small(pattern: Any) -> bool:
    """Whether code is to be written; beyond, it would never run."""
    return len(pattern[0]) <= LARGEST


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
def gather(
    typingctx: Any, block: Any, out: Any, source: Any, starts: Any, offset: Any, count: Any
) -> Any:
    """Entry out + i = source[starts[lane] + offset + i] of the eight lanes, i in `count`."""

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        emit = Emitter(context, builder, signature, args)
        rows = _rows_of_lanes(context, builder, signature, args, 2, 3, 4)
        for i in range(count.count):
            emit.store(_across(builder, rows, i), args[1], i)
        return context.get_dummy_value()

    return types.void(block, out, source, starts, offset, count), codegen


def _nothing_if_finite(builder: Any, row: Any, count: int) -> Any:
    """Eight zeros if the `count` numbers of `row` are finite, else NaN somewhere among them."""
    width = min(count, LANES)
    kind = ir.VectorType(_DOUBLE, width)
    total = None
    for first in (*range(0, count - width, width), count - width):  # the last may overlap
        pointer = builder.gep(row, [ir.Constant(_INDEX, first)])
        numbers = builder.load(builder.bitcast(pointer, kind.as_pointer()), align=8)
        nothing = builder.fsub(numbers, numbers)
        total = nothing if total is None else builder.fadd(total, nothing)
    places = [min(i, width) for i in range(LANES)]  # beyond `width`: a zero
    places = ir.Constant(ir.VectorType(ir.IntType(32), LANES), places)
    return builder.shuffle_vector(total, ir.Constant(kind, [0.0] * width), places)


@intrinsic
def gather_dynamics(
    typingctx: Any,
    block: Any,
    out: Any,
    doubts: Any,
    a: Any,
    starts_a: Any,
    offset_a: Any,
    b: Any,
    starts_b: Any,
    offset_b: Any,
    pattern: Any,
) -> Any:
    """The entries of [A B] that can be other than zero, of one stage.

    To the eight entries from `doubts` on, one a lane, it adds NaN where a number of the stage is
    not finite, whether it can be other than zero or not.
    """
    nx, nu, rows = sizes(pattern)

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        emit = Emitter(context, builder, signature, args)
        if not small(pattern):
            return context.get_dummy_value()
        from_a = _rows_of_lanes(context, builder, signature, args, 3, 4, 5)
        from_b = _rows_of_lanes(context, builder, signature, args, 6, 7, 8)
        for lane in range(LANES):
            doubt = emit.load(args[2], lane)
            for row, count in ((from_a[lane], nx * nx), (from_b[lane], nx * nu)):
                doubt = builder.fadd(doubt, _nothing_if_finite(builder, row, count))
            emit.store(doubt, args[2], lane)
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

    arguments = (block, out, doubts, a, starts_a, offset_a, b, starts_b, offset_b, pattern)
    return types.void(*arguments), codegen
