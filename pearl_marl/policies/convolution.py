"""A linear layer over what filters make of planes of 0 and 1, and the gradients by both, compiled for a CPU.

A filter covers squares of 3 by 3, and most of such pictures' squares are empty or equal to the same square of
another picture. Of 512 random pictures of Seaquest, each has 64 squares, of which 24 are not empty; of these,
10 are unlike those of earlier pictures. An empty square gives the linear layer what the filters' biases give
it, which is the same for all pictures. Of others, what the filters make, less what the biases alone do, is
multiplied once for all that are equal, and so is the sum of the gradients by their outputs.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from typing import Any, NamedTuple

import numpy as np
import torch
from gymnasium.spaces import Box, Space
from llvmlite import ir
from numba import njit, types
from numba.core import cgutils
from numba.extending import intrinsic
from torch import Tensor
from torch.autograd.function import once_differentiable

from pearl_marl.base.arrays import Array
from pearl_marl.compiler.loading import compiled_loop

SIDE = 3
"""Rows and columns of a filter."""
FILTERS = 16
BLOCK = 512
"""Pictures that go through both layers at once: their outputs fit a cache."""
SHARED = 128
"""Pictures from which on a thread has enough to do."""
FEW, TOGETHER = 4, 8
"""Squares that are multiplied together by many outputs' weights, and by one's: as many as registers hold."""
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
def _add(_: Any, sums: Any, at: Any, terms: Any, of: Any, factor: Any) -> Any:
    """Add ``factor`` times sixteen terms, from ``of`` on, to sixteen sums, from ``at`` on."""

    def generate(context: Any, builder: Any, signature: Any, operands: Any) -> Any:
        total, some = (
            _vector(builder, _pointer(context, builder, signature.args[k], operands[k], operands[k + 1]))
            for k in (0, 2)
        )
        term = builder.fmul(_sixteen(builder, operands[4]), builder.load(some, align=4))
        builder.store(builder.fadd(builder.load(total, align=4), term), total, align=4)
        return context.get_dummy_value()

    return types.none(sums, types.int64, terms, types.int64, types.float32), generate


@_intrinsic  # type: ignore[untyped-decorator]
def _rectify(_: Any, made: Any, at: Any, sums: Any, of: Any, bias: Any) -> Any:
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
def _keep(_: Any, numbers: Any, at: Any, flags: Any) -> Any:
    """Set those of sixteen numbers to 0 whose flag is not set."""

    def generate(context: Any, builder: Any, signature: Any, operands: Any) -> Any:
        some = _vector(builder, _pointer(context, builder, signature.args[0], *operands[:2]))
        flags = builder.bitcast(operands[2], ir.VectorType(ir.IntType(1), FILTERS))
        none = ir.Constant(_VECTOR, [0.0] * FILTERS)
        builder.store(builder.select(flags, builder.load(some, align=4), none), some, align=4)
        return context.get_dummy_value()

    return types.none(numbers, types.int64, types.uint16), generate


@_intrinsic  # type: ignore[untyped-decorator]
def _multiply(_: Any, products: Any, column: Any, width: Any, made: Any, rank: Any, weights: Any) -> Any:
    """Write a panel of what some kinds' ``made``, from ``rank`` on, comes to when multiplied by weights.

    The weights are ``(filters, width)``, and the products ``(kinds, width)``, as one axis.
    """
    kinds = FEW

    def generate(context: Any, builder: Any, signature: Any, operands: Any) -> Any:
        _, column, width, _, rank, _ = operands

        def element(k: int, index: Any) -> Any:
            return _pointer(context, builder, signature.args[k], operands[k], index)

        ranks = [builder.add(rank, _INDEX(k)) for k in range(kinds)]
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
def _add_products(
    _: Any, by_weights: Any, to: Any, width: Any, made: Any, of: Any, kinds: Any, sums: Any, column: Any
) -> Any:
    """Add to the gradients by a place's weights, of four filters and a panel, those by all kinds of squares.

    ``of`` is the first of the filters. ``sums``, ``(kinds, width)``, are the gradients by outputs.
    """
    filters = 4

    def generate(context: Any, builder: Any, signature: Any, operands: Any) -> Any:
        _, to, width, _, of, kinds, _, column = operands

        def element(k: int, index: Any) -> Any:
            return _pointer(context, builder, signature.args[k], operands[k], index)

        starts = [
            _vector(builder, element(0, builder.add(to, builder.mul(width, _INDEX(j)))))
            for j in range(filters)
        ]
        totals = [builder.gep(start, [_LANE(k)]) for start in starts for k in range(VECTORS)]
        kept = [_alloca(builder, _VECTOR) for _ in totals]
        for total, one in zip(totals, kept, strict=True):
            builder.store(builder.load(total, align=4), one)
        with cgutils.for_range(builder, kinds) as loop:
            loaded = _panel(builder, element(6, builder.add(builder.mul(loop.index, width), column)))
            numbers = element(3, builder.add(of, builder.mul(loop.index, _INDEX(FILTERS))))
            for j in range(filters):
                factor = _sixteen(builder, builder.load(builder.gep(numbers, [_LANE(j)])))
                for vector, one in zip(loaded, kept[j * VECTORS : (j + 1) * VECTORS], strict=True):
                    builder.store(_plus_product(builder, builder.load(one), vector, factor), one)
        for total, one in zip(totals, kept, strict=True):
            builder.store(builder.load(one), total, align=4)
        return context.get_dummy_value()

    index = types.int64
    return types.none(by_weights, index, index, made, index, index, sums, index), generate


@_intrinsic  # type: ignore[untyped-decorator]
def _project(_: Any, by_made: Any, rank: Any, sums: Any, width: Any, weights: Any) -> Any:
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
def _not_zero(_: Any, elements: Any, at: Any) -> Any:
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
def _lowest(_: Any, bits: Any) -> Any:
    """Return the number of the lowest bit that is set, of some that are not all 0."""

    def generate(context: Any, builder: Any, signature: Any, operands: Any) -> Any:
        return builder.cttz(operands[0], ir.Constant(ir.IntType(1), 1))

    return types.int64(types.uint64), generate


_inlined: Callable[..., Any] = njit(forceinline=True)
_compiled: Callable[..., Any] = njit(nogil=True, error_model="numpy")


@_inlined
def _some_not_zero(elements: Array, start: int, count: int) -> Any:
    """Return a bit for each of ``count`` bytes, from ``start`` on, or of the first 64 of them."""
    bits = _not_zero(elements, start)
    return bits & ((np.uint64(1) << np.uint64(count)) - np.uint64(1)) if count < 64 else bits


class FilterLayer(NamedTuple):
    """Filters, and where pictures go through them."""

    shape: tuple[int, int, int]  # of a picture
    places: Array  # where the square that begins with an element is, for each; with a margin of two
    channels: Array  # and its channel
    begins: Array  # the first element of each square
    keys: Array  # random numbers (3, 3, channels), as one axis: see :func:`_hash`
    weights: Array  # (3, 3, channels, filters), as one axis
    bias: Array


class Kinds(NamedTuple):
    """The squares of one place that differ: each has a rank, by its first picture."""

    firsts: Array  # the first picture of each kind
    made: Array  # what filters make of each, less what they make of an empty square; as one axis
    flags: Array  # which of the filters' sums are above 0, a bit each
    members: Array  # the pictures whose square is not empty
    ranks: Array  # and the rank of each of those
    table: Array  # hashes and ranks of kinds, at slots that hashes point to
    slots: Array


@cache
def _places(shape: tuple[int, int, int]) -> tuple[Array, Array, Array]:
    """Return the place of the square that begins with each element, its channel, and each square's first."""
    rows, columns, channels = shape
    row, column, channel = (part.ravel() for part in np.indices(shape))
    inner = (np.arange(rows - 2)[:, None] * columns + np.arange(columns - 2)) * channels
    return (row + 2) * (columns + 2) + column + 2, channel, inner.ravel()


@cache
def _keys(channels: int) -> Array:
    """Return a random number for each element of a square."""
    return np.random.default_rng(0).integers(1, 1 << 63, SIDE * SIDE * channels, np.uint64)


def _hash(elements: Array, layer: FilterLayer, hashes: Array) -> None:
    """Write a hash of each square of the pictures that ``elements`` are: 0 of one that is empty.

    It is the sum of the random numbers of elements that are set (Zobrist, 1970). That two squares which
    differ have the same is as good as impossible: one pair in 10 to the power of 19 does.
    """
    rows, columns, channels = layer.shape
    wide, size = columns + 2, rows * columns * channels
    sums = np.empty((rows + 2) * wide, np.uint64)
    for i in range(hashes.shape[1]):
        sums[:] = 0
        for k in range(0, size, 64):
            bits = _some_not_zero(elements, i * size + k, size - k)
            while bits:
                element = k + _lowest(bits)
                bits &= bits - np.uint64(1)
                place, channel = layer.places[element], layer.channels[element]
                value = np.uint64(elements[i * size + element])
                for down in range(SIDE):
                    for right in range(SIDE):
                        key = layer.keys[(down * SIDE + right) * channels + channel]
                        sums[place - (down * wide + right)] += key * value
        for row in range(rows - 2):
            for column in range(columns - 2):
                hashes[row * (columns - 2) + column, i] = sums[(row + 2) * wide + column + 2]


def _find_kinds(hashes: Array, kinds: Kinds) -> tuple[int, int]:
    """Find the kinds of one place's squares; return how many they are, and how many squares are not empty."""
    table, slots = kinds.table, kinds.slots
    table[:] = 0
    last = np.uint64(len(table) - 1)
    count = members = 0
    for i in range(len(hashes)):
        key = hashes[i]
        if key != 0:
            slot = key & last
            while table[slot] != key and table[slot] != 0:
                slot = (slot + np.uint64(1)) & last
            if table[slot] == 0:
                table[slot], slots[slot], kinds.firsts[count] = key, count, i
                count += 1
            kinds.members[members], kinds.ranks[members] = i, slots[slot]
            members += 1
    return count, members


def _filter(elements: Array, layer: FilterLayer, first: int, kinds: Kinds, count: int) -> None:
    """Write what the filters make of the kinds of squares that begin ``first`` elements after a picture."""
    rows, columns, channels = layer.shape
    sums = np.empty(FILTERS, np.float32)
    for rank in range(count):
        start = kinds.firsts[rank] * rows * columns * channels + first
        sums[:] = 0
        for down in range(SIDE):
            of = down * SIDE * channels
            for k in range(0, SIDE * channels, 64):
                bits = _some_not_zero(elements, start + k, SIDE * channels - k)
                while bits:
                    j = k + _lowest(bits)
                    bits &= bits - np.uint64(1)
                    _add(sums, 0, layer.weights, (of + j) * FILTERS, np.float32(elements[start + j]))
            start += columns * channels
        kinds.flags[rank] = _rectify(kinds.made, rank * FILTERS, sums, 0, layer.bias)


def _filter_gradients(
    elements: Array,
    layer: FilterLayer,
    first: int,
    kinds: Kinds,
    count: int,
    by_made: Array,
    by_filters: Array,
) -> None:
    """Add the gradients by the filters' weights, given those by what they made of such squares."""
    rows, columns, channels = layer.shape
    for rank in range(count):
        start = kinds.firsts[rank] * rows * columns * channels + first
        for down in range(SIDE):
            of = down * SIDE * channels
            for k in range(0, SIDE * channels, 64):
                bits = _some_not_zero(elements, start + k, SIDE * channels - k)
                while bits:
                    j = k + _lowest(bits)
                    bits &= bits - np.uint64(1)
                    value = np.float32(elements[start + j])
                    _add(by_filters, (of + j) * FILTERS, by_made, rank * FILTERS, value)
            start += columns * channels


def _no_kinds(size: int) -> Kinds:
    """Return arrays for the kinds of so many squares.

    Squares are multiplied a few at a time; where fewer are left, so is what lies behind them, for nothing.
    """
    slots = 2
    while slots < 2 * size:
        slots *= 2
    return Kinds(
        np.empty(size, np.int64),
        np.zeros(size * FILTERS, np.float32),
        np.empty(size, np.uint16),
        np.empty(size, np.int64),
        np.empty(size, np.int64),
        np.empty(slots, np.uint64),
        np.empty(slots, np.int64),
    )


_hash_of, _find_kinds_of, _filter_of, _filter_gradients_of, _no_kinds_of = (
    _compiled(part) for part in (_hash, _find_kinds, _filter, _filter_gradients, _no_kinds)
)


def _outputs(
    elements: Array, layer: FilterLayer, size: int, weights: Array, of_empty: Array, outputs: Array
) -> None:
    """Write what the linear layer makes of pictures, a block of ``size`` after the other.

    ``weights`` are ``(places, filters * width)``, and ``outputs`` ``(pictures, width)``, of whole panels. Of
    ``elements``, 64 more have to be there.
    """
    width, kinds = outputs.shape[1], _no_kinds_of(size)
    # With a few columns more, a picture's hashes do not all fall into the same set of the cache.
    hashes = np.empty((len(weights), size + TOGETHER), np.uint64)
    products = np.empty(size * width, np.float32)
    for start in range(0, len(outputs), size):
        rows, n = outputs[start : start + size].ravel(), min(size, len(outputs) - start)
        some = elements[start * len(layer.places) :]
        _hash_of(some, layer, hashes[:, :n])
        for i in range(n):
            rows[i * width : (i + 1) * width] = of_empty
        for square in range(len(weights)):
            count, members = _find_kinds_of(hashes[square, :n], kinds)
            _filter_of(some, layer, layer.begins[square], kinds, count)
            for rank in range(0, count, FEW):
                for column in range(0, width, PANEL):
                    _multiply(products, column, width, kinds.made, rank, weights[square])
            for k in range(members):
                at, of = kinds.members[k] * width, kinds.ranks[k] * width
                for column in range(0, width, FILTERS):
                    _add(rows, at + column, products, of + column, np.float32(1))


def _gradients(
    elements: Array,
    layer: FilterLayer,
    size: int,
    weights: Array,
    by_outputs: Array,
    by_weights: Array,
    by_filters: Array,
    by_biases: Array,
) -> None:
    """Add the gradients of all pictures, a block of ``size`` after the other.

    ``weights`` are ``(places, width * filters)`` here. Of ``by_biases``, the first sixteen are what squares
    that are not empty add to the gradients by the filters' biases; the others are what they would add if they
    were empty, and the biases above 0.
    """
    width, kinds = by_outputs.shape[1], _no_kinds_of(size)
    # With a few columns more, a picture's hashes do not all fall into the same set of the cache.
    hashes = np.empty((len(weights), size + TOGETHER), np.uint64)
    sums, by_made = np.zeros(size * width, np.float32), np.empty(size * FILTERS, np.float32)
    for start in range(0, len(by_outputs), size):
        by, n = by_outputs[start : start + size].ravel(), min(size, len(by_outputs) - start)
        some = elements[start * len(layer.places) :]
        _hash_of(some, layer, hashes[:, :n])
        for square in range(len(weights)):
            count, members = _find_kinds_of(hashes[square, :n], kinds)
            _filter_of(some, layer, layer.begins[square], kinds, count)
            sums[: count * width] = 0
            for k in range(members):
                at, of = kinds.ranks[k] * width, kinds.members[k] * width
                for column in range(0, width, FILTERS):
                    _add(sums, at + column, by, of + column, np.float32(1))
            for number in range(0, FILTERS, 4):
                for column in range(0, width, PANEL):
                    to = (square * FILTERS + number) * width + column
                    _add_products(by_weights, to, width, kinds.made, number, count, sums, column)
            for rank in range(0, count, TOGETHER):
                _project(by_made, rank, sums, width, weights[square])
            for rank in range(count):
                _add(by_biases, FILTERS, by_made, rank * FILTERS, np.float32(1))
                _keep(by_made, rank * FILTERS, kinds.flags[rank])
                _add(by_biases, 0, by_made, rank * FILTERS, np.float32(1))
            _filter_gradients_of(some, layer, layer.begins[square], kinds, count, by_made, by_filters)


_outputs_of = compiled_loop(_outputs)
_gradients_of = compiled_loop(_gradients)


class PlanesLayer(torch.autograd.Function):
    """A linear layer over what filters of 3 by 3 make of planes, and is above 0.

    Squares are not kept for the gradients: to find them again takes less time than to fetch them from memory.
    """

    @staticmethod
    def forward(
        ctx: Any, planes: Tensor, filters: Tensor, filter_bias: Tensor, weights: Tensor, bias: Tensor
    ) -> Tensor:
        """Return what the layer makes of planes, for which :func:`are_planes`; weights are PyTorch's."""
        ctx.save_for_backward(planes, filters, filter_bias, weights)
        return Planes(planes, filters, filter_bias).outputs(weights.detach(), bias.detach())

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, by_outputs: Tensor) -> tuple[Tensor | None, ...]:
        """Return the gradients by all weights."""
        planes, filters, filter_bias, weights = ctx.saved_tensors
        return None, *Planes(planes, filters, filter_bias).gradients(weights, by_outputs)


def are_planes(space: Space[Any]) -> bool:
    """Return whether pictures of a space, channels last, are of bytes or flags that are 0 or 1."""
    if not isinstance(space, Box) or len(space.shape) != 3 or space.dtype.itemsize != 1:
        return False
    return bool(space.low.min() >= 0 and space.high.max() <= 1)


@cache
def _helper() -> ThreadPoolExecutor:
    """Return the thread that does half of what can be shared."""
    return ThreadPoolExecutor(1, "pearl-planes")


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_helper.cache_clear)  # the thread stays behind


class Planes:
    """Pictures and filters: what the linear layer makes of both, and the gradients."""

    def __init__(self, planes: Tensor, filters: Tensor, bias: Tensor) -> None:
        n, rows, columns, channels = planes.shape
        by_element = filters.detach().numpy().transpose(2, 3, 1, 0)
        self._n, self._picture = n, rows * columns * channels
        # 64 are read at a time, also where fewer are left.
        self._elements = np.zeros(n * self._picture + 64, np.uint8)
        self._elements[:-64] = planes.flatten().numpy().view(np.uint8)
        self._layer = FilterLayer(
            (rows, columns, channels),
            *_places((rows, columns, channels)),
            _keys(channels),
            np.ascontiguousarray(by_element, np.float32).ravel(),
            np.ascontiguousarray(bias.detach().numpy(), np.float32),
        )
        self._squares = (rows - 2) * (columns - 2)
        self._size = min(BLOCK, -(-max(n, 1) // TOGETHER) * TOGETHER)

    def outputs(self, weights: Tensor, bias: Tensor) -> Tensor:
        """Return what the linear layer makes of all pictures."""
        width, n = len(weights), self._n
        of_empty = _whole(torch.addmv(bias, weights, self._of_empty())).numpy()
        by_place = _whole(weights).t().contiguous().view(self._squares, -1).numpy()
        outputs = np.empty((n, len(of_empty)), np.float32)

        def write(some: slice) -> None:
            arguments = self._size, by_place, of_empty, outputs[some]
            _outputs_of()(self._elements[some.start * self._picture :], self._layer, *arguments)

        if n >= 2 * SHARED and torch.get_num_threads() > 1:
            other = _helper().submit(write, slice(n // 2, n))
            write(slice(0, n // 2))
            other.result()
        else:
            write(slice(0, n))
        return torch.from_numpy(outputs)[:, :width].contiguous()

    def gradients(self, weights: Tensor, by_outputs: Tensor) -> Iterator[Tensor]:
        """Yield those by filters, their biases, weights and biases, given those by the outputs."""
        width, layer = len(weights), self._layer
        by_place = _whole(weights).view(-1, self._squares, FILTERS).transpose(0, 1).flatten(1).numpy()
        by_rows = _whole(by_outputs.t()).t().contiguous()
        by_weights = torch.zeros(weights.shape[1], by_rows.shape[1])
        by_filters, by_biases = np.zeros_like(layer.weights), np.zeros(2 * FILTERS, np.float32)
        arguments = by_rows.numpy(), by_weights.numpy().ravel(), by_filters, by_biases
        _gradients_of()(self._elements, layer, self._size, by_place, *arguments)
        whole = torch.from_numpy(by_filters).view(SIDE, SIDE, layer.shape[2], FILTERS)
        yield whole.permute(3, 2, 0, 1).contiguous()
        of_empty, total = self._of_empty(), by_outputs.sum(0)
        # If all squares were empty, their biases would get these; less those of squares that are not.
        by_empty = torch.mv(weights.t(), total).view(self._squares, FILTERS).sum(0)
        by_bias, not_empty = torch.from_numpy(by_biases).view(2, FILTERS)
        yield by_bias + (by_empty - not_empty) * (of_empty[:FILTERS] != 0)
        yield torch.addr(by_weights[:, :width].t(), total, of_empty)
        yield total

    def _of_empty(self) -> Tensor:
        """Return what filters make of a picture that is empty."""
        return torch.from_numpy(self._layer.bias).relu().repeat(self._squares)


def _whole(rows: Tensor) -> Tensor:
    """Return rows, of a layer's outputs, with some of zeros where they do not make up whole panels."""
    missing = -len(rows) % PANEL
    return torch.cat((rows, rows.new_zeros(missing, *rows.shape[1:]))) if missing else rows
