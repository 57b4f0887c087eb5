"""Vectors of sixteen numbers, one for each filter, for the loops of :mod:`pearl_marl.policies.convolution`.

These functions are LLVM's instructions, as Numba does not keep a block of sums in registers by itself.
"""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

FILTERS = 16
FEW, TOGETHER = 4, 8
"""Squares, or filters, that go with a panel of outputs at once, and squares with one: what registers hold."""
VECTORS = 4
PANEL = VECTORS * FILTERS
"""Outputs of the linear layer that are summed together, in so many vectors."""


_VECTOR = ir.VectorType(ir.FloatType(), FILTERS)
_INDEX, _LANE = ir.IntType(64), ir.IntType(32)
_intrinsic: Any = intrinsic
_alloca: Any = cgutils.alloca_once


def _pointer(context: Any, builder: Any, kind: Any, array: Any, at: Any) -> Any:
    """Return a pointer to an element of an array."""
    return builder.gep(context.make_array(kind)(context, builder, array).data, [at])


def _vector(builder: Any, pointer: Any) -> Any:
    """Return a pointer to the sixteen numbers from a number on."""
    return builder.bitcast(pointer, _VECTOR.as_pointer())


def _sixteen(builder: Any, number: Any) -> Any:
    """Return a number sixteen times."""
    single = builder.insert_element(ir.Constant(_VECTOR, ir.Undefined), number, _LANE(0))
    return builder.shuffle_vector(single, single, ir.Constant(ir.VectorType(_LANE, FILTERS), [0] * FILTERS))


def _panel(builder: Any, pointer: Any) -> list[Any]:
    """Return the vectors of a panel from a number on."""
    first = _vector(builder, pointer)
    return [builder.load(builder.gep(first, [_LANE(k)]), align=4) for k in range(VECTORS)]


def _plus_product(builder: Any, total: Any, numbers: Any, factors: Any) -> Any:
    """Return sums with products added; processors that can do both at once round once."""
    fused = ("contract",)
    return builder.fadd(total, builder.fmul(factors, numbers, flags=fused), flags=fused)


def _positive(builder: Any, numbers: Any) -> Any:
    """Return which of sixteen numbers are above 0, or NaN."""
    return builder.fcmp_unordered(">", numbers, ir.Constant(_VECTOR, [0.0] * FILTERS))


@_intrinsic  # type: ignore[untyped-decorator]
def add(_: Any, sums: Any, at: Any, terms: Any, of: Any) -> Any:
    """Add sixteen terms, from ``of`` on, to sixteen sums, from ``at`` on."""

    def generate(context: Any, builder: Any, signature: Any, operands: Any) -> Any:
        total, some = (
            _vector(builder, _pointer(context, builder, signature.args[k], operands[k], operands[k + 1]))
            for k in (0, 2)
        )
        term = builder.load(some, align=4)
        builder.store(builder.fadd(builder.load(total, align=4), term), total, align=4)
        return context.get_dummy_value()

    return types.none(sums, types.int64, terms, types.int64), generate


@_intrinsic  # type: ignore[untyped-decorator]
def rectify(_: Any, made: Any, at: Any, sums: Any, of: Any, bias: Any) -> Any:
    """Store relu(sums + bias) - relu(bias); return a bit for each sum with its bias that is above 0."""

    def generate(context: Any, builder: Any, signature: Any, operands: Any) -> Any:
        to, some = (
            _vector(builder, _pointer(context, builder, signature.args[k], operands[k], operands[k + 1]))
            for k in (0, 2)
        )
        bias = _vector(builder, _pointer(context, builder, signature.args[4], operands[4], _INDEX(0)))
        alone, none = builder.load(bias, align=4), ir.Constant(_VECTOR, [0.0] * FILTERS)
        total = builder.fadd(builder.load(some, align=4), alone)
        flags = _positive(builder, total)
        rectified, of_bias = (
            builder.select(_positive(builder, numbers), numbers, none) for numbers in (total, alone)
        )
        builder.store(builder.fsub(rectified, of_bias), to, align=4)
        return builder.bitcast(flags, ir.IntType(FILTERS))

    return types.uint16(made, types.int64, sums, types.int64, bias), generate


@_intrinsic  # type: ignore[untyped-decorator]
def keep(_: Any, numbers: Any, at: Any, flags: Any) -> Any:
    """Set those of sixteen numbers to 0 whose flag is not set."""

    def generate(context: Any, builder: Any, signature: Any, operands: Any) -> Any:
        some = _vector(builder, _pointer(context, builder, signature.args[0], *operands[:2]))
        flags = builder.bitcast(operands[2], ir.VectorType(ir.IntType(1), FILTERS))
        none = ir.Constant(_VECTOR, [0.0] * FILTERS)
        builder.store(builder.select(flags, builder.load(some, align=4), none), some, align=4)
        return context.get_dummy_value()

    return types.none(numbers, types.int64, types.uint16), generate


@_intrinsic  # type: ignore[untyped-decorator]
def multiply(_: Any, products: Any, column: Any, width: Any, made: Any, rank: Any, weights: Any) -> Any:
    """Write a panel of what some kinds' ``made``, from ``rank`` on, comes to when multiplied by weights.

    The weights are ``(filters, width)``, and the products ``(kinds, width)``, as one axis.
    """

    def generate(context: Any, builder: Any, signature: Any, operands: Any) -> Any:
        _, column, width, _, rank, _ = operands

        def element(k: int, index: Any) -> Any:
            return _pointer(context, builder, signature.args[k], operands[k], index)

        ranks = [builder.add(rank, _INDEX(k)) for k in range(FEW)]
        numbers = [element(3, builder.mul(one, _INDEX(FILTERS))) for one in ranks]
        sums = [[ir.Constant(_VECTOR, [0.0] * FILTERS)] * VECTORS for _ in ranks]
        for number in range(FILTERS):
            start = builder.add(column, builder.mul(width, _INDEX(number)))
            loaded = _panel(builder, element(5, start))
            for own, total in zip(numbers, sums, strict=True):
                factor = _sixteen(builder, builder.load(builder.gep(own, [_LANE(number)])))
                total[:] = [
                    _plus_product(builder, *parts, factor) for parts in zip(total, loaded, strict=True)
                ]
        for one, total in zip(ranks, sums, strict=True):
            to = _vector(builder, element(0, builder.add(builder.mul(one, width), column)))
            for k, vector in enumerate(total):
                builder.store(vector, builder.gep(to, [_LANE(k)]), align=4)
        return context.get_dummy_value()

    return types.none(products, types.int64, types.int64, made, types.int64, weights), generate


@_intrinsic  # type: ignore[untyped-decorator]
def add_products(
    _: Any, by_weights: Any, to: Any, width: Any, made: Any, of: Any, kinds: Any, sums: Any, column: Any
) -> Any:
    """Add to the gradients by a place's weights, of a few filters and a panel, those by all kinds of squares.

    ``of`` is the first of the filters. ``sums``, ``(kinds, width)``, are the gradients by outputs.
    """

    def generate(context: Any, builder: Any, signature: Any, operands: Any) -> Any:
        _, to, width, _, of, kinds, _, column = operands

        def element(k: int, index: Any) -> Any:
            return _pointer(context, builder, signature.args[k], operands[k], index)

        starts = [
            _vector(builder, element(0, builder.add(to, builder.mul(width, _INDEX(j))))) for j in range(FEW)
        ]
        totals = [builder.gep(start, [_LANE(k)]) for start in starts for k in range(VECTORS)]
        kept = [_alloca(builder, _VECTOR) for _ in totals]
        for total, one in zip(totals, kept, strict=True):
            builder.store(builder.load(total, align=4), one)
        with cgutils.for_range(builder, kinds) as loop:
            loaded = _panel(builder, element(6, builder.add(builder.mul(loop.index, width), column)))
            numbers = element(3, builder.add(of, builder.mul(loop.index, _INDEX(FILTERS))))
            for j in range(FEW):
                factor = _sixteen(builder, builder.load(builder.gep(numbers, [_LANE(j)])))
                for vector, one in zip(loaded, kept[j * VECTORS : (j + 1) * VECTORS], strict=True):
                    builder.store(_plus_product(builder, builder.load(one), vector, factor), one)
        for total, one in zip(totals, kept, strict=True):
            builder.store(builder.load(one), total, align=4)
        return context.get_dummy_value()

    index = types.int64
    return types.none(by_weights, index, index, made, index, index, sums, index), generate


@_intrinsic  # type: ignore[untyped-decorator]
def project(_: Any, by_made: Any, rank: Any, sums: Any, width: Any, weights: Any) -> Any:
    """Write the gradients by what the filters made of some kinds of squares, from ``rank`` on.

    The weights are ``(width, filters)``, and ``sums``, the gradients by outputs, ``(kinds, width)``.
    """

    def generate(context: Any, builder: Any, signature: Any, operands: Any) -> Any:
        _, rank, _, width, _ = operands

        def element(k: int, index: Any) -> Any:
            return _pointer(context, builder, signature.args[k], operands[k], index)

        ranks = [builder.add(rank, _INDEX(k)) for k in range(TOGETHER)]
        rows = [element(2, builder.mul(one, width)) for one in ranks]
        kept = [_alloca(builder, _VECTOR) for _ in ranks]
        for one in kept:
            builder.store(ir.Constant(_VECTOR, [0.0] * FILTERS), one)
        with cgutils.for_range(builder, width) as loop:
            numbers = _vector(builder, element(4, builder.mul(loop.index, _INDEX(FILTERS))))
            loaded = builder.load(numbers, align=4)
            for row, one in zip(rows, kept, strict=True):
                factor = _sixteen(builder, builder.load(builder.gep(row, [loop.index])))
                builder.store(_plus_product(builder, builder.load(one), loaded, factor), one)
        for rank, one in zip(ranks, kept, strict=True):
            to = _vector(builder, element(0, builder.mul(rank, _INDEX(FILTERS))))
            builder.store(builder.load(one), to, align=4)
        return context.get_dummy_value()

    return types.none(by_made, types.int64, sums, types.int64, weights), generate


@_intrinsic  # type: ignore[untyped-decorator]
def not_zero(_: Any, elements: Any, at: Any) -> Any:
    """Return a bit for each of 64 bytes, from ``at`` on: whether it is not 0."""

    def generate(context: Any, builder: Any, signature: Any, operands: Any) -> Any:
        array = context.make_array(signature.args[0])(context, builder, operands[0])
        kind = ir.VectorType(ir.IntType(8), 64)
        first = builder.gep(array.data, [operands[1]])
        found = builder.load(builder.bitcast(first, kind.as_pointer()), align=1)
        flags = builder.icmp_unsigned("!=", found, ir.Constant(kind, [0] * 64))
        return builder.bitcast(flags, ir.IntType(64))

    return types.uint64(elements, types.int64), generate


@_intrinsic  # type: ignore[untyped-decorator]
def lowest(_: Any, bits: Any) -> Any:
    """Return the number of the lowest bit that is set, of some that are not all 0."""

    def generate(context: Any, builder: Any, signature: Any, operands: Any) -> Any:
        return builder.cttz(operands[0], ir.Constant(ir.IntType(1), 1))

    return types.int64(types.uint64), generate
