"""SIMD vectors of the pulse loop.

The compiler vectorises a loop only if it can prove that no array overlaps another, and it sums across a vector where
another order needs a third of the work. So the few hot loops use explicit vectors of 16 gaps (float32) or 4 modal
coordinates (float64). The order of operations is the same on processors with wider or narrower registers.

In compiled code `load` reads a vector from an array and `store` writes it back. ``+ - * /`` work with another vector
or a number.
"""

import operator
from collections.abc import Callable
from typing import Any

from llvmlite import ir
from numba import types
from numba.extending import intrinsic, overload, register_model

from edmsim.compiled.jit import FAST, compiled
from edmsim.compiled.numba_internals import cgutils, datamodel

GAPS, COORDINATES = 16, 4  # elements of a float32 vector, and of a float64 vector
PACK, EACH = 5, 3  # slices that share a float32 vector, and lanes of each slice; the last lane is unused
_FAST = tuple(sorted(FAST))


@compiled
def filled(count: int, lanes: int = COORDINATES) -> int:
    """Round `count` up to a multiple of `lanes`, by default those of a float64 vector."""
    return (count + lanes - 1) // lanes * lanes


@compiled
def packs(slices: int) -> int:
    """Number of packs for a number of slices."""
    return (slices + PACK - 1) // PACK


@compiled
def filled_packs(slices: int) -> int:
    """Number of slices rounded up to whole packs, then to whole float64 vectors."""
    return filled(packs(slices) * PACK)


@compiled
def packed_lanes(rays: int) -> int:
    """Lanes of a pack of slices with a number of rays each, rounded up to whole vectors."""
    return (rays + EACH - 1) // EACH * GAPS


class Vector(types.Type):  # type: ignore[misc]
    """Type of a vector in compiled code; the type of its elements determines their number."""

    def __init__(self, element: types.Float) -> None:
        self.element = element
        self.count = GAPS if element == types.float32 else COORDINATES
        super().__init__(name=f"Vector({element} x {self.count})")


_VECTORS: dict[Any, Vector] = {element: Vector(element) for element in (types.float32, types.float64)}


@register_model(Vector)
class _VectorModel(datamodel.PrimitiveModel):  # type: ignore[misc]
    def __init__(self, manager: Any, kind: Vector) -> None:
        scalar = ir.FloatType() if kind.element == types.float32 else ir.DoubleType()
        super().__init__(manager, kind, ir.VectorType(scalar, kind.count))


def _llvm(context: Any, kind: Vector) -> Any:
    return context.get_value_type(kind)


def _place(context: Any, builder: Any, array: Any, of: Any, index: Any, index_of: Any) -> Any:
    """Return a pointer to a vector in a C-contiguous array."""
    view = context.make_array(of)(context, builder, array)
    indices = [
        context.cast(builder, value, kind, types.intp)
        for value, kind in zip(cgutils.unpack_tuple(builder, index), index_of, strict=True)
    ]
    pointer = cgutils.get_item_pointer(context, builder, of, view, indices)
    return builder.bitcast(pointer, _llvm(context, _VECTORS[of.dtype]).as_pointer())


@intrinsic
def load(_typing: Any, array: Any, index: Any) -> Any:
    """Load a vector from an array, starting at an index (a tuple)."""
    kind = _VECTORS[array.dtype]

    def generate(context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        place = _place(context, builder, arguments[0], array, arguments[1], index)
        return builder.load(place, align=array.dtype.bitwidth // 8)

    return kind(array, index), generate


@intrinsic
def store(_typing: Any, array: Any, index: Any, vector: Any) -> Any:
    """Write a vector to an array, starting at an index (a tuple)."""

    def generate(context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        place = _place(context, builder, arguments[0], array, arguments[1], index)
        builder.store(arguments[2], place, align=array.dtype.bitwidth // 8)
        return context.get_dummy_value()

    return types.none(array, index, vector), generate


def _spread(context: Any, builder: Any, value: Any, of: Any, kind: Any) -> Any:
    """Return a vector with a number in every lane; a vector is returned unchanged."""
    if isinstance(of, Vector):
        return value
    vector = _llvm(context, kind)
    scalar = context.cast(builder, value, of, kind.element)
    single = builder.insert_element(ir.Constant(vector, ir.Undefined), scalar, ir.Constant(ir.IntType(32), 0))
    mask = ir.Constant(ir.VectorType(ir.IntType(32), kind.count), None)
    return builder.shuffle_vector(single, single, mask)


@intrinsic
def spread(_typing: Any, number: Any) -> Any:
    """Vector with a float32 or float64 in every lane."""
    kind = _VECTORS[number]

    def generate(context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        return _spread(context, builder, arguments[0], number, kind)

    return kind(number), generate


def _kind_of(a: Any, b: Any) -> Any:
    """Return the result type of an operation on two vectors, or a vector and a number; None for other operands."""
    for one, other in ((a, b), (b, a)):
        if isinstance(one, Vector) and (other == one or isinstance(other, types.Float)):
            return one
    return None


def _lane_by_lane(combine: Callable[[Any, Any, Any], Any]) -> Any:
    """Return an operation on two vectors, or a vector and a number; `combine(builder, left, right)` emits it."""

    @intrinsic
    def apply(_typing: Any, a: Any, b: Any) -> Any:
        kind = _kind_of(a, b)

        def generate(context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
            left, right = (
                _spread(context, builder, value, of, kind) for value, of in zip(arguments, (a, b), strict=True)
            )
            return combine(builder, left, right)

        return kind(a, b), generate

    return apply


def _arithmetic(instruction: str, *signs: Any) -> None:
    apply = _lane_by_lane(
        lambda builder, left, right: getattr(builder, instruction)(left, right, flags=_FAST)
    )

    def operation(a: Any, b: Any) -> Callable[[Any, Any], Any] | None:
        return (lambda a, b: apply(a, b)) if _kind_of(a, b) is not None else None

    for sign in signs:
        overload(sign, strict=False)(operation)


_arithmetic("fadd", operator.add, operator.iadd)
_arithmetic("fsub", operator.sub)
_arithmetic("fmul", operator.mul)
_arithmetic("fdiv", operator.truediv)

highest = _lane_by_lane(
    lambda builder, left, right: builder.select(builder.fcmp_ordered(">", left, right), left, right)
)
"""Lane by lane, the greater of two vectors, or of a vector and a number."""
lowest = _lane_by_lane(
    lambda builder, left, right: builder.select(builder.fcmp_ordered("<", left, right), left, right)
)
"""Lane by lane, the smaller of two vectors, or of a vector and a number."""

_HALVES = (0.99992264, -0.69098249, 0.22997734, -0.03895358)
"""Coefficients of ``2^-x`` from 0 to 1, to 8e-5 (ours: least squares of the relative error at Chebyshev nodes)."""
_MOST_HALVES = 125.0
"""Numbers below 2^-126 are subnormal, and slow on most processors."""


@intrinsic
def power_of_half(_typing: Any, vector: Any) -> Any:
    """``2^-x`` of each element x >= 0 of a float32 vector, to 8e-5; elements above 125 count as 125."""

    def generate(context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        kind, whole_kind = arguments[0].type, ir.VectorType(ir.IntType(32), vector.count)
        most = ir.Constant(kind, [_MOST_HALVES] * vector.count)
        x = builder.select(builder.fcmp_ordered("<", arguments[0], most), arguments[0], most)
        whole = builder.fptosi(x, whole_kind)
        part = builder.fsub(x, builder.sitofp(whole, kind))
        series = ir.Constant(kind, [_HALVES[-1]] * vector.count)
        for coefficient in _HALVES[-2::-1]:
            series = builder.fadd(
                builder.fmul(series, part, flags=_FAST), ir.Constant(kind, [coefficient] * vector.count), flags=_FAST
            )
        exponent = builder.shl(whole, ir.Constant(whole_kind, [23] * vector.count))
        return builder.bitcast(builder.sub(builder.bitcast(series, whole_kind), exponent), kind)

    return vector(vector), generate


@intrinsic
def total(_typing: Any, vector: Any) -> Any:
    """Sum of a vector's elements."""

    def generate(context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        scalar = context.get_value_type(vector.element)
        name = f"llvm.vector.reduce.fadd.v{vector.count}f{vector.element.bitwidth}"
        kind = ir.FunctionType(scalar, [scalar, arguments[0].type])
        function = cgutils.get_or_insert_function(builder.module, kind, name)
        return builder.call(function, [ir.Constant(scalar, -0.0), arguments[0]], fastmath=_FAST)

    return vector.element(vector), generate


def _shuffled(builder: Any, a: Any, b: Any, lanes: list[int]) -> Any:
    mask = ir.Constant(ir.VectorType(ir.IntType(32), len(lanes)), lanes)
    return builder.shuffle_vector(a, b, mask)


@intrinsic
def packed(_typing: Any, four: Any, fifth: Any) -> Any:
    """Float32 vector with the value of each slice of a pack in the slice's lanes, from four values and the fifth."""
    kind = _VECTORS[types.float32]

    def generate(_context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        numbers = _shuffled(builder, arguments[0], arguments[0], [*range(COORDINATES)] * 2)
        numbers = builder.insert_element(numbers, arguments[1], ir.Constant(ir.IntType(32), PACK - 1))
        single = builder.fptrunc(numbers, ir.VectorType(ir.FloatType(), 2 * COORDINATES))
        return _shuffled(builder, single, single, [min(k // EACH, PACK - 1) for k in range(kind.count)])

    return kind(four, fifth), generate


@intrinsic
def counted(_typing: Any, first: Any) -> Any:
    """Float64 vector of a number, the number plus 1, and so on."""
    kind = _VECTORS[types.float64]

    def generate(context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        steps = ir.Constant(_llvm(context, kind), [float(k) for k in range(kind.count)])
        return builder.fadd(_spread(context, builder, arguments[0], first, kind), steps)

    return kind(first), generate


def _rows(builder: Any, vectors: Any) -> list[Any]:
    """Sum four vectors over the lanes of each slice; return a float64 vector with four sums for each slice."""
    sums = []
    for vector in vectors:
        first, second, third = (
            _shuffled(builder, vector, vector, [min(EACH * k + lane, GAPS - 1) for k in range(GAPS // 2)])
            for lane in range(EACH)
        )
        sums.append(builder.fadd(builder.fadd(first, second, flags=_FAST), third, flags=_FAST))
    ab, cd = (_shuffled(builder, low, high, list(range(GAPS))) for low, high in (sums[:2], sums[2:]))
    half = GAPS // 2
    rows = [_shuffled(builder, ab, cd, [k, half + k, GAPS + k, GAPS + half + k]) for k in range(PACK)]
    return [builder.fpext(row, ir.VectorType(ir.DoubleType(), COORDINATES)) for row in rows]


@intrinsic
def store_sums(_typing: Any, sums: Any, first: Any, a: Any, b: Any, c: Any, d: Any) -> Any:
    """Write the sums of four float32 vectors over each slice's lanes to the slice's row of `sums` (slices, 4)."""
    # Returns the sum of the rows. Slices beyond the end of the array are skipped.
    kind = _VECTORS[types.float64]

    def generate(context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        view = context.make_array(sums)(context, builder, arguments[0])
        slices = builder.extract_value(view.shape, 0)
        at, everything = context.cast(builder, arguments[1], first, types.intp), None
        for k, row in enumerate(_rows(builder, arguments[2:])):
            slice_ = builder.add(at, ir.Constant(at.type, k))
            with builder.if_then(builder.icmp_signed("<", slice_, slices), likely=True):
                place = cgutils.get_item_pointer(context, builder, sums, view, [slice_, ir.Constant(at.type, 0)])
                builder.store(row, builder.bitcast(place, row.type.as_pointer()), align=8)
            everything = row if everything is None else builder.fadd(everything, row, flags=_FAST)
        return everything

    return kind(sums, first, a, b, c, d), generate


@intrinsic
def element(_typing: Any, vector: Any, lane: Any) -> Any:
    """One element of a vector."""

    def generate(context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        return builder.extract_element(arguments[0], context.cast(builder, arguments[1], lane, types.int32))

    return vector.element(vector, lane), generate


@intrinsic
def running(_typing: Any, vector: Any) -> Any:
    """Cumulative sums of a vector's elements, each including its own lane."""

    def generate(context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        sums, lanes = arguments[0], vector.count
        zero = ir.Constant(_llvm(context, vector), None)
        away = 1
        while away < lanes:
            moved = _shuffled(builder, zero, sums, [k - away + lanes if k >= away else k for k in range(lanes)])
            sums = builder.fadd(sums, moved)
            away *= 2
        return sums

    return vector(vector), generate


def _flags(builder: Any, vector: Vector, flags: Any) -> Any:
    """Return the truth values of a vector's lanes as the bits of an integer."""
    return builder.zext(builder.bitcast(flags, ir.IntType(vector.count)), ir.IntType(64))


@intrinsic
def passed(_typing: Any, vector: Any, number: Any) -> Any:
    """Number of lanes that do not exceed a number."""

    def generate(context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        limit = _spread(context, builder, arguments[1], number, vector)
        flags = _flags(builder, vector, builder.fcmp_ordered("<=", arguments[0], limit))
        return builder.ctpop(flags)

    return types.int64(vector, number), generate


@intrinsic
def least(_typing: Any, vector: Any) -> Any:
    """Least element of a vector, and the first lane that has it."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        found = arguments[0]
        while found.type.count > 1:
            half = found.type.count // 2
            low, high = (_shuffled(builder, found, found, [k + first for k in range(half)]) for first in (0, half))
            found = builder.select(builder.fcmp_ordered("<", low, high), low, high)
        smallest = builder.extract_element(found, ir.Constant(ir.IntType(32), 0))
        limit = _spread(context, builder, smallest, vector.element, vector)
        flags = _flags(builder, vector, builder.fcmp_ordered("<=", arguments[0], limit))
        place = builder.cttz(flags, ir.Constant(ir.IntType(1), 0))
        return context.make_tuple(builder, signature.return_type, [smallest, place])

    return types.Tuple([vector.element, types.int64])(vector), generate
