"""Vectors of sixteen numbers, one for each filter, for the loops of :mod:`pearl_marl.policies.convolution`.

Numba does not keep a block of sums in registers by itself: see :mod:`pearl_marl.compiler.vector_code`.
"""

from __future__ import annotations

from functools import partial
from typing import Any

from llvmlite import ir
from numba import types

from pearl_marl.compiler.vector_code import INDEX, LANES, VectorCode, constant, function_of

FILTERS = LANES
FEW, TOGETHER = 4, 8
"""Squares, or filters, that go with a panel of outputs at once, and squares with one: what registers hold."""
VECTORS = 4
PANEL = VECTORS * FILTERS
"""Outputs of the linear layer that are summed together, in so many vectors."""


_NONE = constant(ir.VectorType(ir.FloatType(), LANES), 0.0)


def _panel(code: VectorCode, array: Any, at: Any) -> list[Any]:
    """Return the vectors of a panel from a number on."""
    return [code.load(array, code.plus(at, k * FILTERS)) for k in range(VECTORS)]


def _store_panel(code: VectorCode, vectors: list[Any], array: Any, at: Any) -> None:
    for k, vector in enumerate(vectors):
        code.store(vector, array, code.plus(at, k * FILTERS))


def _positive(code: VectorCode, numbers: Any) -> Any:
    """Return which of sixteen numbers are above 0, or NaN."""
    return code.builder.fcmp_unordered(">", numbers, _NONE)


@function_of
def add(code: VectorCode, sums: Any, at: Any, terms: Any, of: Any) -> None:
    """Add sixteen terms, from ``of`` on, to sixteen sums, from ``at`` on."""
    total, some = code.load(sums, at), code.load(terms, of)
    code.store(code.builder.fadd(total, some), sums, at)


@partial(function_of, result=types.uint16)
def rectify(code: VectorCode, made: Any, at: Any, sums: Any, of: Any, bias: Any) -> Any:
    """Store relu(sums + bias) - relu(bias); return a bit for each sum with its bias that is above 0."""
    builder, alone = code.builder, code.load(bias, INDEX(0))
    total = builder.fadd(code.load(sums, of), alone)
    rectified, of_bias = (
        builder.select(_positive(code, numbers), numbers, _NONE) for numbers in (total, alone)
    )
    code.store(builder.fsub(rectified, of_bias), made, at)
    return builder.bitcast(_positive(code, total), ir.IntType(FILTERS))


@function_of
def keep(code: VectorCode, numbers: Any, at: Any, flags: Any) -> None:
    """Set those of sixteen numbers to 0 whose flag is not set."""
    kept = code.builder.bitcast(flags, ir.VectorType(ir.IntType(1), FILTERS))
    code.store(code.builder.select(kept, code.load(numbers, at), _NONE), numbers, at)


@function_of
def multiply(
    code: VectorCode, products: Any, column: Any, width: Any, made: Any, rank: Any, weights: Any
) -> None:
    """Write a panel of what some kinds' ``made``, from ``rank`` on, comes to when multiplied by weights.

    The weights are ``(filters, width)``, and the products ``(kinds, width)``, as one axis.
    """
    builder, ranks = code.builder, [code.plus(rank, k) for k in range(FEW)]
    sums = [[_NONE] * VECTORS for _ in ranks]
    for number in range(FILTERS):
        loaded = _panel(code, weights, builder.add(column, code.times(width, number)))
        for one, total in zip(ranks, sums, strict=True):
            factor = code.factor(made, code.plus(code.times(one, FILTERS), number))
            total[:] = [code.plus_product(*parts, factor) for parts in zip(total, loaded, strict=True)]
    for one, total in zip(ranks, sums, strict=True):
        _store_panel(code, total, products, builder.add(builder.mul(one, width), column))


@function_of
def add_products(
    code: VectorCode,
    by_weights: Any,
    to: Any,
    width: Any,
    made: Any,
    of: Any,
    kinds: Any,
    sums: Any,
    column: Any,
) -> None:
    """Add to the gradients by a place's weights, of a few filters and a panel, those by all kinds of squares.

    ``of`` is the first of the filters. ``sums``, ``(kinds, width)``, are the gradients by outputs.
    """
    builder = code.builder
    starts = [builder.add(to, code.times(width, j)) for j in range(FEW)]
    totals = [[code.variable(vector) for vector in _panel(code, by_weights, start)] for start in starts]
    with code.each(kinds) as kind:
        loaded = _panel(code, sums, builder.add(builder.mul(kind, width), column))
        first = builder.add(of, code.times(kind, FILTERS))
        for j, total in enumerate(totals):
            factor = code.factor(made, code.plus(first, j))
            for one, vector in zip(total, loaded, strict=True):
                builder.store(code.plus_product(builder.load(one), vector, factor), one)
    for start, total in zip(starts, totals, strict=True):
        _store_panel(code, [builder.load(one) for one in total], by_weights, start)


@function_of
def project(code: VectorCode, by_made: Any, rank: Any, sums: Any, width: Any, weights: Any) -> None:
    """Write the gradients by what the filters made of some kinds of squares, from ``rank`` on.

    The weights are ``(width, filters)``, and ``sums``, the gradients by outputs, ``(kinds, width)``.
    """
    builder, ranks = code.builder, [code.plus(rank, k) for k in range(TOGETHER)]
    totals = [code.variable(_NONE) for _ in ranks]
    with code.each(width) as output:
        loaded = code.load(weights, code.times(output, FILTERS))
        for one, total in zip(ranks, totals, strict=True):
            factor = code.factor(sums, builder.add(builder.mul(one, width), output))
            builder.store(code.plus_product(builder.load(total), loaded, factor), total)
    for one, total in zip(ranks, totals, strict=True):
        code.store(builder.load(total), by_made, code.times(one, FILTERS))


@partial(function_of, result=types.uint64)
def not_zero(code: VectorCode, elements: Any, at: Any) -> Any:
    """Return a bit for each of 64 bytes, from ``at`` on: whether it is not 0."""
    kind = ir.VectorType(ir.IntType(8), 64)
    flags = code.builder.icmp_unsigned("!=", code.load(elements, at, kind), constant(kind, 0))
    return code.builder.bitcast(flags, ir.IntType(64))


@partial(function_of, result=types.int64)
def lowest(code: VectorCode, bits: Any) -> Any:
    """Return the number of the lowest bit that is set, of some that are not all 0."""
    return code.builder.cttz(bits, ir.Constant(ir.IntType(1), 1))
