"""A linear layer over what filters make of planes of 0 and 1, and the gradients by both, compiled for a CPU.

Most elements of such pictures are 0, and so are most squares of 3 by 3 that a filter covers: in Seaquest 13 of
1,000 elements are 1, and 25 of 64 squares are not empty. Sums are made of what the others add, where a
convolution of PyTorch's multiplies all; and an empty square gives the linear layer what the filters' biases
give it, which is the same for all pictures. So only squares that are not empty are multiplied: of each, what
its filters make less what the biases alone do.
"""

from __future__ import annotations

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
BLOCK = 256
"""Pictures that go through the filters and the linear layer at once, or fewer if they have many squares."""
SQUARES = 1 << 14
"""The most squares of a block's pictures together: what filters make of them fits a cache."""
TOGETHER = 8
"""Squares of the same place, of different pictures, that are multiplied together."""
VECTORS = 4
PANEL = VECTORS * FILTERS
"""Outputs of the linear layer that are summed together, in so many vectors."""


_FLOAT, _VECTOR = ir.FloatType(), ir.VectorType(ir.FloatType(), FILTERS)
_INDEX, _LANE = ir.IntType(64), ir.IntType(32)
_intrinsic: Any = intrinsic


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


def _plus_product(builder: Any, total: Any, factors: Any, numbers: Any) -> Any:
    """Return sums with products added, which processors that can round but once."""
    fused = ("contract",)
    return builder.fadd(total, builder.fmul(factors, numbers, flags=fused), flags=fused)


def _positive(builder: Any, numbers: Any) -> Any:
    """Return which of sixteen numbers are above 0, or none at all."""
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
    """Add sixteen biases to sums; write what is above 0 less the biases that are; return which sums are."""

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
def _multiply(
    _: Any, outputs: Any, column: Any, width: Any, pictures: Any, at: Any, made: Any, weights: Any, of: Any
) -> Any:
    """Add to a panel of some pictures' outputs what the filters made of a square of each, times weights.

    The pictures are numbered by ``pictures[at:at + 4]``; of each, what the filters made has the same place in
    ``made``. The weights are those from ``of`` on, ``width`` apart for each filter.
    """
    rows = TOGETHER // 2

    def generate(context: Any, builder: Any, signature: Any, operands: Any) -> Any:
        _, column, width, _, at, *_, of = operands

        def element(k: int, index: Any) -> Any:
            return _pointer(context, builder, signature.args[k], operands[k], index)

        totals, numbers = [], []
        for row in range(rows):
            picture = builder.load(element(3, builder.add(at, _INDEX(row))))
            first = builder.add(builder.mul(picture, width), column)
            numbers.append(element(5, builder.mul(builder.add(at, _INDEX(row)), _INDEX(FILTERS))))
            totals.append(_vector(builder, element(0, first)))
        sums = [
            [builder.load(builder.gep(total, [_LANE(k)]), align=4) for k in range(VECTORS)]
            for total in totals
        ]
        for number in range(FILTERS):
            start = builder.add(of, builder.mul(width, _INDEX(number)))
            some = _vector(builder, element(6, start))
            loaded = [builder.load(builder.gep(some, [_LANE(k)]), align=4) for k in range(VECTORS)]
            for row in range(rows):
                factor = _sixteen(builder, builder.load(builder.gep(numbers[row], [_LANE(number)])))
                for k in range(VECTORS):
                    sums[row][k] = _plus_product(builder, sums[row][k], factor, loaded[k])
        for total, vectors in zip(totals, sums, strict=True):
            for k, vector in enumerate(vectors):
                builder.store(vector, builder.gep(total, [_LANE(k)]), align=4)
        return context.get_dummy_value()

    number = types.int64
    return types.none(outputs, number, number, pictures, number, made, weights, number), generate


@_intrinsic  # type: ignore[untyped-decorator]
def _add_products(
    _: Any,
    by_weights: Any,
    to: Any,
    width: Any,
    made: Any,
    of: Any,
    pictures: Any,
    first: Any,
    count: Any,
    by_outputs: Any,
    column: Any,
) -> Any:
    """Add to the weights' gradients, of some filters and a panel of outputs, those by one place's squares.

    These are ``count`` squares, from ``first`` on. ``of`` is where the first filter made its first number.
    """
    some_filters = 4

    def generate(context: Any, builder: Any, signature: Any, operands: Any) -> Any:
        _, to, width, _, of, _, first, count, _, column = operands

        def element(k: int, index: Any) -> Any:
            return _pointer(context, builder, signature.args[k], operands[k], index)

        starts = [
            _vector(builder, element(0, builder.add(to, builder.mul(width, _INDEX(j)))))
            for j in range(some_filters)
        ]
        totals = [(start, k) for start in starts for k in range(VECTORS)]
        sums = [cgutils.alloca_once(builder, _VECTOR) for _ in totals]
        for (start, k), total in zip(totals, sums, strict=True):
            builder.store(builder.load(builder.gep(start, [_LANE(k)]), align=4), total)
        with cgutils.for_range(builder, count) as loop:
            picture = builder.load(element(5, builder.add(first, loop.index)))
            by = _vector(builder, element(8, builder.add(builder.mul(picture, width), column)))
            loaded = [builder.load(builder.gep(by, [_LANE(k)]), align=4) for k in range(VECTORS)]
            numbers = element(3, builder.add(of, builder.mul(loop.index, _INDEX(FILTERS))))
            for j in range(some_filters):
                factor = _sixteen(builder, builder.load(builder.gep(numbers, [_LANE(j)])))
                for vector, total in zip(loaded, sums[j * VECTORS : (j + 1) * VECTORS], strict=True):
                    builder.store(_plus_product(builder, builder.load(total), factor, vector), total)
        for (start, k), total in zip(totals, sums, strict=True):
            builder.store(builder.load(total), builder.gep(start, [_LANE(k)]), align=4)
        return context.get_dummy_value()

    index = types.int64
    arguments = by_weights, index, index, made, index, pictures, index, index, by_outputs, index
    return types.none(*arguments), generate


@_intrinsic  # type: ignore[untyped-decorator]
def _project(
    _: Any, by_made: Any, pictures: Any, at: Any, by_outputs: Any, width: Any, weights: Any, of: Any
) -> Any:
    """Write the gradients by what the filters made of squares of some pictures, from the square ``at`` on.

    The weights are those from ``of`` on: sixteen for each output.
    """

    def generate(context: Any, builder: Any, signature: Any, operands: Any) -> Any:
        _, _, at, _, width, _, of = operands

        def element(k: int, index: Any) -> Any:
            return _pointer(context, builder, signature.args[k], operands[k], index)

        squares = [builder.add(at, _INDEX(row)) for row in range(TOGETHER)]
        rows = [element(3, builder.mul(builder.load(element(1, square)), width)) for square in squares]
        sums = [cgutils.alloca_once(builder, _VECTOR) for _ in squares]
        for total in sums:
            builder.store(ir.Constant(_VECTOR, [0.0] * FILTERS), total)
        with cgutils.for_range(builder, width) as loop:
            start = builder.add(of, builder.mul(loop.index, _INDEX(FILTERS)))
            loaded = builder.load(_vector(builder, element(5, start)), align=4)
            for row, total in zip(rows, sums, strict=True):
                factor = _sixteen(builder, builder.load(builder.gep(row, [loop.index])))
                builder.store(_plus_product(builder, builder.load(total), factor, loaded), total)
        for square, total in zip(squares, sums, strict=True):
            to = _vector(builder, element(0, builder.mul(square, _INDEX(FILTERS))))
            builder.store(builder.load(total), to, align=4)
        return context.get_dummy_value()

    number = types.int64
    return types.none(by_made, pictures, number, by_outputs, number, weights, number), generate


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


def _found(elements: Array, found: Array) -> int:
    """Write down which elements are not 0; return how many."""
    count, whole = 0, len(elements) // 64 * 64
    for start in range(0, whole, 64):
        bits = _not_zero(elements, start)
        while bits:
            found[count] = start + _lowest(bits)
            bits &= bits - np.uint64(1)
            count += 1
    for k in range(whole, len(elements)):
        found[count] = k
        count += elements[k] != 0
    return count


_found_of: Callable[..., int] = _inlined(_found)


class Squares(NamedTuple):
    """The squares of 3 by 3 of a block's pictures that are not empty, by place; a block has room at each.

    ``made`` is what the filters make of them, less what they make of an empty one, and ``flags`` which of
    these are above 0 (of both, those that are); ``pictures`` the pictures that they belong to. ``ranks``, shape
    ``(pictures, places)``, is where a square stands among those of its place, or -1, and ``counts`` how many
    these are.
    """

    made: Array
    flags: Array
    pictures: Array
    ranks: Array
    counts: Array


class FilterLayer(NamedTuple):
    """Filters, and where pictures go through them."""

    shape: tuple[int, int]  # of a picture
    filters: Array  # the first number of its channel's filters, for each element of a picture
    places: Array  # and the place of each
    weights: Array  # (channels, 3, 3, filters), as one axis
    bias: Array


@cache
def _places(shape: tuple[int, ...]) -> tuple[Array, Array]:
    """Return for each element of a picture the first number of its channel's filters, and its place.

    Places are those of squares with a margin of two: what an element adds outside of the picture is thrown
    away.
    """
    columns = shape[1]
    row, column, channel = (part.ravel() for part in np.indices(shape))
    return channel * SIDE * SIDE * FILTERS, (row + 2) * (columns + 2) + column + 2


def _filter(pictures: Array, layer: FilterLayer, squares: Squares) -> None:
    """Write what the filters make of the squares of pictures ``(n, elements)`` that are not empty."""
    rows, columns = layer.shape
    wide = columns + 2
    block = len(squares.pictures) // len(squares.counts)
    found = np.empty(pictures.shape[1], np.int64)
    sums = np.empty((rows + 2) * wide * FILTERS, np.float32)
    touched = np.empty((rows + 2) * wide, np.bool_)
    squares.counts[:] = 0
    squares.ranks[:] = -1
    for i in range(len(pictures)):
        picture = pictures[i]
        sums[:] = 0
        touched[:] = False
        for number in range(_found_of(picture, found)):
            element = found[number]
            place, of, value = layer.places[element], layer.filters[element], np.float32(picture[element])
            for down in range(SIDE):
                for right in range(SIDE):
                    at = place - (down * wide + right)
                    _add(sums, at * FILTERS, layer.weights, of + (down * SIDE + right) * FILTERS, value)
                    touched[at] = True
        for row in range(rows - 2):
            for column in range(columns - 2):
                at, square = (row + 2) * wide + column + 2, row * (columns - 2) + column
                if touched[at]:
                    rank = squares.counts[square]
                    to = square * block + rank
                    squares.flags[to] = _rectify(squares.made, to * FILTERS, sums, at * FILTERS, layer.bias)
                    squares.pictures[to] = i
                    squares.ranks[i, square] = rank
                    squares.counts[square] = rank + 1
    for square in range(len(squares.counts)):
        count = squares.counts[square]
        for to in range(square * block + count, square * block + -(-count // TOGETHER) * TOGETHER):
            squares.pictures[to] = block  # a row that nobody reads
            squares.made[to * FILTERS : (to + 1) * FILTERS] = 0


def _sum_up(squares: Squares, weights: Array, width: int, outputs: Array) -> None:
    """Add to ``outputs``, rows of ``width``, what the filters made, times ``weights``.

    These are ``(squares, filters, width)``, as one axis.
    """
    block = len(squares.pictures) // len(squares.counts)
    for square in range(len(squares.counts)):
        first = square * block
        for at in range(first, first + squares.counts[square], TOGETHER // 2):
            for column in range(0, width, PANEL):
                of = square * FILTERS * width + column
                _multiply(outputs, column, width, squares.pictures, at, squares.made, weights, of)


def _differentiate(
    squares: Squares,
    weights: Array,
    width: int,
    by_outputs: Array,
    by_weights: Array,
    by_made: Array,
    by_biases: Array,
) -> None:
    """Add the gradients by the linear layer's weights; write those by what the filters made.

    ``weights`` are ``(places, width, filters)``, as one axis. Of ``by_biases``, the first sixteen are what
    squares that are not empty add to the gradients by the filters' biases; the others are what they would add
    if they were empty, and the biases above 0.
    """
    block = len(squares.pictures) // len(squares.counts)
    for square in range(len(squares.counts)):
        first, count = square * block, squares.counts[square]
        for number in range(0, FILTERS, 4):
            for column in range(0, width, PANEL):
                to, of = (square * FILTERS + number) * width + column, first * FILTERS + number
                _add_products(
                    by_weights,
                    to,
                    width,
                    squares.made,
                    of,
                    squares.pictures,
                    first,
                    count,
                    by_outputs,
                    column,
                )
        for at in range(first, first + count, TOGETHER):
            _project(by_made, squares.pictures, at, by_outputs, width, weights, square * width * FILTERS)
        for at in range(first, first + count):
            _add(by_biases, FILTERS, by_made, at * FILTERS, np.float32(1))
            _keep(by_made, at * FILTERS, squares.flags[at])
            _add(by_biases, 0, by_made, at * FILTERS, np.float32(1))


def _filter_gradients(
    pictures: Array, layer: FilterLayer, squares: Squares, by_made: Array, by_weights: Array
) -> None:
    """Add the gradients by the filters' weights, given those by what they made."""
    rows, columns = layer.shape
    wide = columns + 2
    block = len(squares.pictures) // len(squares.counts)
    found = np.empty(pictures.shape[1], np.int64)
    by = np.zeros((rows + 2) * wide * FILTERS, np.float32)
    for i in range(len(pictures)):
        picture = pictures[i]
        for row in range(rows - 2):
            for column in range(columns - 2):
                square = row * (columns - 2) + column
                rank = squares.ranks[i, square]
                if rank >= 0:
                    at, of = (row + 2) * wide + column + 2, square * block + rank
                    by[at * FILTERS : (at + 1) * FILTERS] = by_made[of * FILTERS : (of + 1) * FILTERS]
        for number in range(_found_of(picture, found)):
            element = found[number]
            place, of, value = layer.places[element], layer.filters[element], np.float32(picture[element])
            for down in range(SIDE):
                for right in range(SIDE):
                    at = place - (down * wide + right)
                    _add(by_weights, of + (down * SIDE + right) * FILTERS, by, at * FILTERS, value)


_filter_of, _sum_up_of, _differentiate_of, _filter_gradients_of = (
    _compiled(part) for part in (_filter, _sum_up, _differentiate, _filter_gradients)
)


def _no_squares(places: int, size: int) -> Squares:
    """Return arrays for the squares of so many pictures, which have so many places."""
    return Squares(
        np.empty(places * size * FILTERS, np.float32),
        np.empty(places * size, np.uint16),
        np.empty(places * size, np.int64),
        np.empty((size, places), np.int16),
        np.empty(places, np.int64),
    )


_no_squares_of = _compiled(_no_squares)


def _outputs(
    pictures: Array, layer: FilterLayer, size: int, weights: Array, of_empty: Array, outputs: Array
) -> None:
    """Write what the linear layer makes of pictures, a block of ``size`` after the other.

    ``weights`` are ``(places, filters, width)``, where the width is one of whole panels.
    """
    width = weights.shape[2]
    squares = _no_squares_of(len(weights), size)
    rows = np.zeros((size + 1, width), np.float32)  # and one for squares that make up a number
    for start in range(0, len(pictures), size):
        some, made = pictures[start : start + size], outputs[start : start + size]
        rows[:, : len(of_empty)] = of_empty
        _filter_of(some, layer, squares)
        _sum_up_of(squares, weights.ravel(), width, rows.ravel())
        made[:] = rows[: len(made), : len(of_empty)]


def _gradients(
    pictures: Array,
    layer: FilterLayer,
    size: int,
    weights: Array,
    by_outputs: Array,
    by_weights: Array,
    by_filters: Array,
    by_biases: Array,
) -> None:
    """Add the gradients of all pictures, a block of ``size`` after the other.

    ``weights`` are ``(places, width, filters)`` here; for the others see :func:`_differentiate`.
    """
    width = weights.shape[1]
    squares = _no_squares_of(len(weights), size)
    by_made = np.empty_like(squares.made)
    rows = np.zeros((size + 1, width), np.float32)
    for start in range(0, len(pictures), size):
        some, by = pictures[start : start + size], by_outputs[start : start + size]
        rows[: len(by), : by.shape[1]] = by
        _filter_of(some, layer, squares)
        _differentiate_of(squares, weights.ravel(), width, rows.ravel(), by_weights, by_made, by_biases)
        _filter_gradients_of(some, layer, squares, by_made, by_filters)


_outputs_of = compiled_loop(_outputs)
_gradients_of = compiled_loop(_gradients)


class PlanesLayer(torch.autograd.Function):
    """A linear layer over what filters of 3 by 3 make of planes, and is above 0.

    A block of pictures at a time goes through both, while what the filters made is in the processor's
    cache. It is not kept for the gradients: to make it again takes less time than to fetch it from memory.
    """

    @staticmethod
    def forward(
        ctx: Any, planes: Tensor, filters: Tensor, filter_bias: Tensor, weights: Tensor, bias: Tensor
    ) -> Tensor:
        """Return what the layer makes of planes, for which :func:`are_planes`; weights are PyTorch's."""
        ctx.save_for_backward(planes, filters, filter_bias, weights)
        return _Planes(planes, filters, filter_bias).outputs(weights.detach(), bias.detach())

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, by_outputs: Tensor) -> tuple[Tensor | None, ...]:
        """Return the gradients by all weights."""
        planes, filters, filter_bias, weights = ctx.saved_tensors
        return None, *_Planes(planes, filters, filter_bias).gradients(weights, by_outputs)


def are_planes(space: Space[Any]) -> bool:
    """Return whether pictures of a space, channels last, are of bytes or flags that are 0 or 1."""
    if not isinstance(space, Box) or len(space.shape) != 3 or space.dtype.itemsize != 1:
        return False
    return bool(space.low.min() >= 0 and space.high.max() <= 1)


@cache
def _helper() -> ThreadPoolExecutor:
    """Return the thread that does half of what can be shared."""
    return ThreadPoolExecutor(1, "pearl-planes")


class _Planes:
    """Pictures and filters: what the linear layer makes of both, and the gradients."""

    def __init__(self, planes: Tensor, filters: Tensor, bias: Tensor) -> None:
        n, rows, columns, channels = planes.shape
        by_channel = filters.detach().numpy().transpose(1, 2, 3, 0)
        self._elements = planes.flatten(1).contiguous().numpy().view(np.uint8)
        self._layer = FilterLayer(
            (rows, columns),
            *_places((rows, columns, channels)),
            np.ascontiguousarray(by_channel, np.float32).ravel(),
            np.ascontiguousarray(bias.detach().numpy(), np.float32),
        )
        self._squares = (rows - 2) * (columns - 2)
        most = min(BLOCK, SQUARES // self._squares, n)
        self._size = max(most // TOGETHER, 1) * TOGETHER

    def outputs(self, weights: Tensor, bias: Tensor) -> Tensor:
        """Return what the linear layer makes of all pictures."""
        width, n = len(weights), len(self._elements)
        outputs = np.empty((n, width), np.float32)
        of_empty = torch.addmv(bias, weights, self._of_empty()).numpy()
        ordered = torch.zeros(self._squares, FILTERS, _whole(width))
        ordered[..., :width] = weights.t().view(self._squares, FILTERS, width)

        def write(some: slice) -> None:
            arguments = self._layer, self._size, ordered.numpy(), of_empty, outputs[some]
            _outputs_of()(self._elements[some], *arguments)

        if n > self._size and torch.get_num_threads() > 1:
            middle = n // self._size // 2 * self._size or self._size
            other = _helper().submit(write, slice(middle, n))
            write(slice(0, middle))
            other.result()
        else:
            write(slice(0, n))
        return torch.from_numpy(outputs)

    def gradients(self, weights: Tensor, by_outputs: Tensor) -> Iterator[Tensor]:
        """Yield those by filters, their biases, weights and biases, given those by the outputs."""
        width, layer = len(weights), self._layer
        ordered = torch.zeros(self._squares, _whole(width), FILTERS)
        ordered[:, :width] = weights.view(width, self._squares, FILTERS).transpose(0, 1)
        by_weights = torch.zeros(self._squares * FILTERS, _whole(width))
        by_filters, by_biases = np.zeros_like(layer.weights), np.zeros(2 * FILTERS, np.float32)
        by_rows = by_outputs.contiguous().numpy()
        arguments = ordered.numpy(), by_rows, by_weights.numpy().ravel(), by_filters, by_biases
        _gradients_of()(self._elements, layer, self._size, *arguments)
        channels = len(by_filters) // (SIDE * SIDE * FILTERS)
        whole = torch.from_numpy(by_filters).view(channels, SIDE, SIDE, FILTERS)
        yield whole.permute(3, 0, 1, 2).contiguous()
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


def _whole(width: int) -> int:
    """Return the width of whole panels."""
    return -(-width // PANEL) * PANEL
