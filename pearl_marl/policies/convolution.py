"""The filters that planes of 0 and 1 go through first, and the gradients by them, compiled for a CPU.

Most elements of such pictures are 0, and sums are made of what the others add: of 1,000 elements in Seaquest
they are some 13, where a convolution of PyTorch's multiplies all.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import cache
from typing import Any

import numpy as np
import torch
from gymnasium.spaces import Box, Space
from llvmlite import ir
from numba import njit, types
from numba.extending import intrinsic
from torch import Tensor
from torch.autograd.function import once_differentiable

from pearl_marl.base.arrays import Array
from pearl_marl.compiler.loading import compiled_loop

SIDE = 3
"""Rows and columns of a filter."""
FILTERS = 16
BLOCK = 256
"""Pictures that go through the filters and the linear layer behind them at once."""


_VECTOR = ir.VectorType(ir.FloatType(), FILTERS)
_intrinsic: Any = intrinsic


def _vector(context: Any, builder: Any, signature: Any, operands: Any, k: int) -> Any:
    """Return a pointer to the sixteen numbers of the array ``k`` from operand ``k + 1`` on."""
    kind = signature.args[k]
    data = context.make_array(kind)(context, builder, operands[k]).data
    return builder.bitcast(builder.gep(data, [operands[k + 1]]), _VECTOR.as_pointer())


@_intrinsic  # type: ignore[untyped-decorator]
def _add(_: Any, sums: Any, at: Any, terms: Any, of: Any, factor: Any) -> Any:
    """Add ``factor`` times sixteen terms, from ``of`` on, to sixteen sums, from ``at`` on."""

    def generate(context: Any, builder: Any, signature: Any, operands: Any) -> Any:
        total, terms = (_vector(context, builder, signature, operands, k) for k in (0, 2))
        single = builder.insert_element(ir.Constant(_VECTOR, ir.Undefined), operands[4], ir.IntType(32)(0))
        same = ir.Constant(ir.VectorType(ir.IntType(32), FILTERS), [0] * FILTERS)
        term = builder.fmul(builder.shuffle_vector(single, single, same), builder.load(terms, align=4))
        builder.store(builder.fadd(builder.load(total, align=4), term), total, align=4)
        return context.get_dummy_value()

    return types.none(sums, types.int64, terms, types.int64, types.float32), generate


@_intrinsic  # type: ignore[untyped-decorator]
def _where_above(_: Any, kept: Any, at: Any, numbers: Any, of: Any, sums: Any, by: Any) -> Any:
    """Keep those of sixteen numbers, from ``of`` on, whose sums, from ``by`` on, are above 0; else 0."""

    def generate(context: Any, builder: Any, signature: Any, operands: Any) -> Any:
        kept, numbers, sums = (_vector(context, builder, signature, operands, k) for k in (0, 2, 4))
        none = ir.Constant(_VECTOR, [0.0] * FILTERS)
        above = builder.fcmp_unordered(">", builder.load(sums, align=4), none)
        builder.store(builder.select(above, builder.load(numbers, align=4), none), kept, align=4)
        return context.get_dummy_value()

    return types.none(kept, types.int64, numbers, types.int64, sums, types.int64), generate


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


@cache
def _places(shape: tuple[int, ...]) -> tuple[Array, Array]:
    """Return for each element of a picture the first number of its channel's filters, and of its place.

    Places are those of sums with a margin of two: what an element adds outside of the picture is thrown away.
    """
    columns = shape[1]
    row, column, channel = (part.ravel() for part in np.indices(shape))
    filters = channel * SIDE * SIDE * FILTERS
    return filters, ((row + 2) * (columns + 2) + column + 2) * FILTERS


def _forward(
    pictures: Array,
    shape: tuple[int, int],
    filters: Array,
    places: Array,
    weights: Array,
    bias: Array,
    sums: Array,
) -> None:
    """Write what the filters make of pictures ``(n, elements)``, and is above 0.

    ``shape`` is that of a picture. ``weights`` are ``(channels, 3, 3, filters)``, as one axis, and ``sums``
    ``(n, (rows - 2) * (columns - 2) * filters)``.
    """
    rows, columns = shape
    wide = columns + 2
    found = np.empty(pictures.shape[1], np.int64)
    all_sums = np.empty((rows + 2) * wide * FILTERS, np.float32)
    for i in range(len(pictures)):
        picture, out = pictures[i], sums[i]
        all_sums[:] = 0
        for number in range(_found_of(picture, found)):
            element = found[number]
            place, of, value = places[element], filters[element], np.float32(picture[element])
            for down in range(SIDE):
                for right in range(SIDE):
                    at = place - (down * wide + right) * FILTERS
                    _add(all_sums, at, weights, of + (down * SIDE + right) * FILTERS, value)
        for row in range(rows - 2):
            first, start = row * (columns - 2) * FILTERS, ((row + 2) * wide + 2) * FILTERS
            for at in range(0, (columns - 2) * FILTERS, FILTERS):
                _add(all_sums, start + at, bias, 0, np.float32(1))
                _where_above(out, first + at, all_sums, start + at, all_sums, start + at)


def _backward(
    pictures: Array,
    shape: tuple[int, int],
    filters: Array,
    places: Array,
    sums: Array,
    by_sums: Array,
    by_weights: Array,
    by_bias: Array,
) -> None:
    """Add the gradients by weights and biases, given those by the ``sums``."""
    rows, columns = shape
    wide = columns + 2
    found = np.empty(pictures.shape[1], np.int64)
    by = np.zeros((rows + 2) * wide * FILTERS, np.float32)
    of_picture = np.empty(FILTERS, np.float32)
    for i in range(len(pictures)):
        picture, out, by_out = pictures[i], sums[i], by_sums[i]
        of_picture[:] = 0
        for row in range(rows - 2):
            first, start = row * (columns - 2) * FILTERS, ((row + 2) * wide + 2) * FILTERS
            for at in range(0, (columns - 2) * FILTERS, FILTERS):
                _where_above(by, start + at, by_out, first + at, out, first + at)
                _add(of_picture, 0, by, start + at, np.float32(1))
        _add(by_bias, 0, of_picture, 0, np.float32(1))
        for number in range(_found_of(picture, found)):
            element = found[number]
            place, of, value = places[element], filters[element], np.float32(picture[element])
            for down in range(SIDE):
                for right in range(SIDE):
                    at = place - (down * wide + right) * FILTERS
                    _add(by_weights, of + (down * SIDE + right) * FILTERS, by, at, value)


_forward_of = compiled_loop(_forward)
_backward_of = compiled_loop(_backward)


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
        outputs = weights.new_empty((len(planes), len(weights)))
        for block, sums in _Filters(planes, filters, filter_bias).blocks():
            torch.addmm(bias, sums, weights.t(), out=outputs[block])
        return outputs

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, by_outputs: Tensor) -> tuple[Tensor | None, ...]:
        """Return the gradients by all weights."""
        planes, filters, filter_bias, weights = ctx.saved_tensors
        made = _Filters(planes, filters, filter_bias)
        by_weights, by_sums = torch.zeros_like(weights), weights.new_empty((BLOCK, weights.shape[1]))
        for block, sums in made.blocks():
            by = by_outputs[block]
            torch.addmm(by_weights, by.t(), sums, out=by_weights)
            made.learn(block, torch.mm(by, weights, out=by_sums[: len(by)]))
        return None, *made.gradients(), by_weights, by_outputs.sum(0)


def are_planes(space: Space[Any]) -> bool:
    """Return whether pictures of a space, channels last, are of bytes or flags that are 0 or 1."""
    if not isinstance(space, Box) or len(space.shape) != 3 or space.dtype.itemsize != 1:
        return False
    return bool(space.low.min() >= 0 and space.high.max() <= 1)


class _Filters:
    """What filters make of planes, a block of pictures at a time, and the gradients by the filters."""

    def __init__(self, planes: Tensor, weights: Tensor, bias: Tensor) -> None:
        n, rows, columns, channels = planes.shape
        by_channel = weights.detach().numpy().transpose(1, 2, 3, 0)
        self._elements = planes.flatten(1).contiguous().numpy().view(np.uint8)
        self._weights = np.ascontiguousarray(by_channel, np.float32).ravel()
        self._bias = np.ascontiguousarray(bias.detach().numpy(), np.float32)
        self._where = (rows, columns), *_places((rows, columns, channels))
        self._channels = channels
        self._by_weights, self._by_bias = np.zeros_like(self._weights), np.zeros_like(self._bias)
        self._sums = np.empty((min(n, BLOCK), (rows - 2) * (columns - 2) * FILTERS), np.float32)

    def blocks(self) -> Iterator[tuple[slice, Tensor]]:
        """Yield blocks of pictures, and what the filters make of them until the next block is asked for."""
        write = _forward_of()
        for start in range(0, len(self._elements), BLOCK):
            block = slice(start, start + BLOCK)
            some = self._elements[block]
            sums = self._sums[: len(some)]
            write(some, *self._where, self._weights, self._bias, sums)
            yield block, torch.from_numpy(sums)

    def learn(self, block: slice, by_sums: Tensor) -> None:
        """Add the gradients of the block that was made last, given those by what the filters made."""
        some, by = self._elements[block], by_sums.numpy()
        _backward_of()(some, *self._where, self._sums[: len(by)], by, self._by_weights, self._by_bias)

    def gradients(self) -> tuple[Tensor, Tensor]:
        """Return the gradients by the filters and by their biases."""
        by = torch.from_numpy(self._by_weights).view(self._channels, SIDE, SIDE, FILTERS)
        return by.permute(3, 0, 1, 2).contiguous(), torch.from_numpy(self._by_bias)
