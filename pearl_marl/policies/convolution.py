"""A linear layer over what filters make of planes of 0 and 1, and the gradients by both, compiled for a CPU.

A filter covers squares of 3 by 3, and most of such pictures' squares are empty or equal to the same square of
another picture. Of 512 random pictures of Seaquest, each has 64 squares, of which 24 are not empty; of these,
10 are unlike those of earlier pictures. An empty square gives the linear layer what the filters' biases give
it, which is the same for all pictures. Of others, what the filters make, less what the biases alone do, is
multiplied once for all that are equal, and so is the sum of the gradients by their outputs.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache, partial
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
import torch
from gymnasium.spaces import Box, Space
from numba import njit
from torch import Tensor
from torch.autograd.function import once_differentiable

from pearl_marl.base.arrays import Array
from pearl_marl.compiler.loading import compiled_loop
from pearl_marl.policies import convolution_vectors
from pearl_marl.policies.convolution_vectors import (
    FEW,
    FILTERS,
    PANEL,
    TOGETHER,
    add,
    add_products,
    keep,
    lowest,
    multiply,
    not_zero,
    project,
    rectify,
)
from pearl_marl.policies.second_thread import both, is_free, over_rows

SIDE = 3
"""Rows and columns of a filter."""
BLOCK = 512
"""Pictures that go through both layers at once: their outputs fit a cache."""
SHARED = 128
"""Pictures from which on a thread has enough to do."""
SPARE = 64
"""Elements that are read behind the last picture's."""

_inlined: Callable[..., Any] = njit(forceinline=True)
_compiled: Callable[..., Any] = njit(nogil=True, error_model="numpy")
_contracted: Callable[..., Any] = njit(nogil=True, fastmath={"contract"})


@_inlined
def _set_elements(elements: Array, start: int, count: int, found: Array, known: int) -> int:
    """Note which of ``count`` elements, from ``start`` on, are set, behind those ``known``; return how many.

    64 are read at a time, also where fewer are left.
    """
    for k in range(0, count, 64):
        bits = not_zero(elements, start + k)
        if count - k < 64:
            bits &= (np.uint64(1) << np.uint64(count - k)) - np.uint64(1)
        while bits:
            found[known] = k + lowest(bits)
            bits &= bits - np.uint64(1)
            known += 1
    return known


class FilterLayer(NamedTuple):
    """Filters, and where pictures go through them."""

    shape: tuple[int, int, int]  # of a picture
    places: Array  # where the square that begins with an element is, for each; with a margin of two
    channels: Array  # and its channel
    begins: Array  # the first element of each square
    keys: Array  # random numbers (3, 3, channels), as one axis: see :func:`_hash`
    weights: Array  # (3, 3, channels, filters), as one axis
    bias: Array


class Lines(NamedTuple):
    """Some of the lines that pictures' squares lie in."""

    first: int
    end: int  # the first that is not one of them


class Kinds(NamedTuple):
    """The squares of one place that differ: each has a rank, by its first picture."""

    firsts: Array  # the first picture of each kind
    made: Array  # what filters make of each, less what they make of an empty square; as one axis
    flags: Array  # a bit for each filter: whether its sum is above 0
    members: Array  # the pictures whose square is not empty
    ranks: Array  # and the rank of each of those
    table: Array  # hashes of kinds, where their last bits point to, or behind that
    slots: Array  # and the kinds' ranks there


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


@_compiled
def _hash(elements: Array, layer: FilterLayer, lines: Lines, hashes: Array) -> None:
    """Write a hash of each square in some lines of the pictures ``elements``: 0 of one that is empty.

    A hash is the sum of random numbers, one for each element that is set (Zobrist, 1970). Two different
    squares have the same hash with a probability of about 1e-19.
    """
    rows, columns, channels = layer.shape
    wide, size = columns + 2, rows * columns * channels
    sums, found = np.empty((rows + 2) * wide, np.uint64), np.empty(size, np.int64)
    begin, covered = lines.first * columns * channels, (lines.end - lines.first + 2) * columns * channels
    for i in range(hashes.shape[1]):
        sums[:] = 0
        for number in range(_set_elements(elements, i * size + begin, covered, found, 0)):
            place, channel = layer.places[begin + found[number]], layer.channels[begin + found[number]]
            for down in range(SIDE):
                for right in range(SIDE):
                    key = layer.keys[(down * SIDE + right) * channels + channel]
                    sums[place - (down * wide + right)] += key
        for row in range(lines.first, lines.end):
            for column in range(columns - 2):
                hash_of = sums[(row + 2) * wide + column + 2]
                hashes[(row - lines.first) * (columns - 2) + column, i] = hash_of


@_compiled
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


@_inlined
def _elements_of(elements: Array, layer: FilterLayer, start: int, found: Array) -> int:
    """Note which elements of the square that begins at ``start``, as one axis, are set; return how many."""
    _, columns, channels = layer.shape
    known, along = 0, SIDE * channels
    for down in range(SIDE):
        before = known
        known = _set_elements(elements, start + down * columns * channels, along, found, known)
        for number in range(before, known):
            found[number] += down * along
    return known


@_compiled
def _filter(elements: Array, layer: FilterLayer, first: int, kinds: Kinds, count: int) -> None:
    """Write what the filters make of the kinds of squares that begin ``first`` elements after a picture."""
    sums, found = np.empty(FILTERS, np.float32), np.empty(len(layer.keys), np.int64)
    for rank in range(count):
        sums[:] = 0
        start = kinds.firsts[rank] * len(layer.places) + first
        for number in range(_elements_of(elements, layer, start, found)):
            add(sums, 0, layer.weights, found[number] * FILTERS)
        kinds.flags[rank] = rectify(kinds.made, rank * FILTERS, sums, 0, layer.bias)


@_compiled
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
    found = np.empty(len(layer.keys), np.int64)
    for rank in range(count):
        start = kinds.firsts[rank] * len(layer.places) + first
        for number in range(_elements_of(elements, layer, start, found)):
            add(by_filters, found[number] * FILTERS, by_made, rank * FILTERS)


@_compiled
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


@_compiled
def _arranged(weights: Array, width: int, begin: int, count: int, by_filter: bool) -> Array:
    """Return weights ``(outputs, places * filters)`` of ``count`` places, from ``begin`` on.

    They become ``(places, filters * width)``, or ``(places, width * filters)``; the rest are zeros.
    """
    found = np.zeros((count, FILTERS * width), np.float32)
    for square in range(len(found)):
        for output in range(len(weights)):
            for number in range(FILTERS):
                to = number * width + output if by_filter else output * FILTERS + number
                found[square, to] = weights[output, (begin + square) * FILTERS + number]
    return found


@_contracted
def _add_empty(
    by_weights: Array, width: int, begin: int, of_empty: Array, total: Array, by_linear: Array
) -> None:
    """Write the gradients by weights of the linear layer, of which empty squares make a part."""
    for square in range(len(by_weights) // (width * FILTERS)):
        for output in range(len(total)):
            for number in range(square * FILTERS, (square + 1) * FILTERS):
                to = begin * FILTERS + number
                by_linear[output, to] = by_weights[number * width + output] + total[output] * of_empty[to]


@_inlined
def _places_in(layer: FilterLayer, lines: Lines) -> tuple[int, int]:
    """Return the first place of some lines, and how many there are."""
    wide = layer.shape[1] - 2
    return lines.first * wide, (lines.end - lines.first) * wide


def _outputs(
    elements: Array,
    layer: FilterLayer,
    lines: Lines,
    size: int,
    linear: Array,
    of_empty: Array,
    outputs: Array,
) -> None:
    """Write what the linear layer makes of some lines of pictures, a block of ``size`` after the other.

    ``linear`` are its weights, and ``outputs`` are ``(pictures, width)``, of whole panels. Of ``elements``,
    :data:`SPARE` more have to be there.
    """
    width, kinds, (begin, squares) = outputs.shape[1], _no_kinds(size), _places_in(layer, lines)
    weights = _arranged(linear, width, begin, squares, True)
    # With a few columns more, a picture's hashes do not all fall into the same set of the cache.
    hashes = np.empty((squares, size + TOGETHER), np.uint64)
    products = np.empty(size * width, np.float32)
    for start in range(0, len(outputs), size):
        rows, n = outputs[start : start + size].ravel(), min(size, len(outputs) - start)
        some = elements[start * len(layer.places) :]
        _hash(some, layer, lines, hashes[:, :n])
        for i in range(n):
            rows[i * width : (i + 1) * width] = of_empty
        for square in range(squares):
            count, members = _find_kinds(hashes[square, :n], kinds)
            _filter(some, layer, layer.begins[begin + square], kinds, count)
            for rank in range(0, count, FEW):
                for column in range(0, width, PANEL):
                    multiply(products, column, width, kinds.made, rank, weights[square])
            for k in range(members):
                at, of = kinds.members[k] * width, kinds.ranks[k] * width
                for column in range(0, width, FILTERS):
                    add(rows, at + column, products, of + column)


def _gradients(
    elements: Array,
    layer: FilterLayer,
    lines: Lines,
    size: int,
    linear: Array,
    by_outputs: Array,
    of_empty: Array,
    total: Array,
    by_linear: Array,
    by_filters: Array,
    by_biases: Array,
) -> None:
    """Find the gradients by some lines of all pictures, a block of ``size`` after the other.

    Write those by the weights ``linear`` of these lines into ``by_linear``; add those by the filters to
    ``by_filters`` and ``by_biases``. ``of_empty`` is what filters make of an empty picture, and ``total`` the
    sum of ``by_outputs``. Of ``by_biases``, the first sixteen are what squares that are not empty add to the
    gradients by the filters' biases; the others are what they would add if they were empty, and the biases
    above 0.
    """
    width, kinds, (begin, squares) = by_outputs.shape[1], _no_kinds(size), _places_in(layer, lines)
    weights = _arranged(linear, width, begin, squares, False)
    by_weights = np.zeros(weights.size, np.float32)
    # With a few columns more, a picture's hashes do not all fall into the same set of the cache.
    hashes = np.empty((squares, size + TOGETHER), np.uint64)
    sums, by_made = np.zeros(size * width, np.float32), np.empty(size * FILTERS, np.float32)
    for start in range(0, len(by_outputs), size):
        by, n = by_outputs[start : start + size].ravel(), min(size, len(by_outputs) - start)
        some = elements[start * len(layer.places) :]
        _hash(some, layer, lines, hashes[:, :n])
        for square in range(squares):
            count, members = _find_kinds(hashes[square, :n], kinds)
            _filter(some, layer, layer.begins[begin + square], kinds, count)
            sums[: count * width] = 0
            for k in range(members):
                at, of = kinds.ranks[k] * width, kinds.members[k] * width
                for column in range(0, width, FILTERS):
                    add(sums, at + column, by, of + column)
            for number in range(0, FILTERS, FEW):
                for column in range(0, width, PANEL):
                    to = (square * FILTERS + number) * width + column
                    add_products(by_weights, to, width, kinds.made, number, count, sums, column)
            for rank in range(0, count, TOGETHER):
                project(by_made, rank, sums, width, weights[square])
            for rank in range(count):
                add(by_biases, FILTERS, by_made, rank * FILTERS)
                keep(by_made, rank * FILTERS, kinds.flags[rank])
                add(by_biases, 0, by_made, rank * FILTERS)
            _filter_gradients(some, layer, layer.begins[begin + square], kinds, count, by_made, by_filters)
    _add_empty(by_weights, width, begin, of_empty, total, by_linear)


_outputs_of = compiled_loop(_outputs, convolution_vectors)
_gradients_of = compiled_loop(_gradients, convolution_vectors)


class PlanesLayer(torch.autograd.Function):
    """A linear layer over what filters of 3 by 3 make of planes, and is above 0.

    An element counts as 1 if it is not 0; see :func:`are_planes`.
    Squares are not kept for the gradients: to find them again takes less time than to fetch them from memory.
    """

    @staticmethod
    def forward(
        ctx: Any, planes: Tensor, filters: Tensor, filter_bias: Tensor, weights: Tensor, bias: Tensor
    ) -> Tensor:
        """Return what the layer makes of planes, for which :func:`are_planes`; weights are PyTorch's."""
        ctx.save_for_backward(planes, filters, filter_bias, weights)
        layer = Planes(elements_of(planes), planes.shape[1:], filters, filter_bias)
        return layer.outputs(weights.detach(), bias.detach())

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, by_outputs: Tensor) -> tuple[Tensor | None, ...]:
        """Return the gradients by all weights."""
        planes, *parameters = ctx.saved_tensors
        filters, filter_bias, weights = parameters
        found = [*map(torch.empty_like, parameters), by_outputs.new_empty(len(weights))]
        layer = Planes(elements_of(planes), planes.shape[1:], filters, filter_bias)
        layer.find_gradients(weights.detach(), by_outputs, found)
        return None, *found


def are_planes(space: Space[Any]) -> bool:
    """Return whether pictures of a space, channels last, are of bytes or flags that are 0 or 1."""
    if not isinstance(space, Box) or len(space.shape) != 3 or space.dtype.itemsize != 1:
        return False
    return bool(space.low.min() >= 0 and space.high.max() <= 1)


def room_for(n: int, size: int) -> Array:
    """Return room for the elements of ``n`` pictures, each of so many; with :data:`SPARE` zeros behind it."""
    elements = np.empty(n * size + SPARE, np.uint8)
    elements[n * size :] = 0
    return elements


def elements_of(planes: Tensor) -> Array:
    """Return the elements of pictures, with :data:`SPARE` zeros behind them."""
    return np.concatenate((planes.flatten().numpy().view(np.uint8), np.zeros(SPARE, np.uint8)))


class Planes:
    """Pictures and filters: what the linear layer makes of both, and the gradients.

    ``elements`` are those of all pictures, with :data:`SPARE` zeros behind them.
    """

    def __init__(self, elements: Array, shape: Sequence[int], filters: Tensor, bias: Tensor) -> None:
        rows, columns, channels = shape
        by_element = filters.detach().numpy().transpose(2, 3, 1, 0)
        self._elements, self._picture = elements, rows * columns * channels
        self._n = (len(elements) - SPARE) // self._picture
        self._layer = FilterLayer(
            (rows, columns, channels),
            *_places((rows, columns, channels)),
            _keys(channels),
            np.ascontiguousarray(by_element, np.float32).ravel(),
            np.ascontiguousarray(bias.detach().numpy(), np.float32),
        )
        self._squares = (rows - 2) * (columns - 2)
        self._size = min(BLOCK, -(-max(self._n, 1) // TOGETHER) * TOGETHER)
        # Of a block, halves have fewer equal pictures' squares than all: it is better divided by lines.
        divided = SHARED <= self._n < BLOCK and rows > SIDE
        edges = [0, (rows - 2) // 2, rows - 2] if divided else [0, rows - 2]
        self._lines = [Lines(*pair) for pair in pairwise(edges)]

    def _of_all_lines(self, work: Callable[[Lines], Array]) -> Array:
        """Return the sum of what is found for all lines, which two threads may do."""
        parts = [partial(work, lines) for lines in self._lines]
        found = both(*parts) if len(parts) == 2 and is_free() else [part() for part in parts]
        return found[0] if len(found) == 1 else found[0] + found[1]

    def outputs(self, weights: Tensor, bias: Tensor) -> Tensor:
        """Return what the linear layer makes of all pictures."""
        width, linear, outputs_of = len(weights), weights.contiguous().numpy(), _outputs_of()
        of_empty = _whole(torch.addmv(bias, weights, self._of_empty())).numpy()

        def of(lines: Lines) -> Array:
            outputs = np.empty((self._n, len(of_empty)), np.float32)
            others = of_empty if lines.first == 0 else np.zeros_like(of_empty)

            def write(some: slice) -> None:
                elements = self._elements[some.start * self._picture :]
                outputs_of(elements, self._layer, lines, self._size, linear, others, outputs[some])

            over_rows(self._n, SHARED, write)
            return outputs

        return torch.from_numpy(self._of_all_lines(of))[:, :width].contiguous()

    def find_gradients(self, weights: Tensor, by_outputs: Tensor, found: Sequence[Tensor]) -> None:
        """Write those by filters, their biases, weights and biases, given those by the outputs."""
        layer, (by_filters, by_filter_bias, by_weights, by_bias) = self._layer, found
        by_rows, of_empty = _whole(by_outputs.t()).t().contiguous(), self._of_empty()
        torch.sum(by_outputs, 0, out=by_bias)
        arguments = weights.contiguous(), by_rows, of_empty, by_bias, by_weights
        arrays, gradients_of = [tensor.numpy() for tensor in arguments], _gradients_of()

        def of(lines: Lines) -> Array:
            by_filters_and_biases = np.zeros(layer.weights.size + 2 * FILTERS, np.float32)
            parts = np.split(by_filters_and_biases, [layer.weights.size])
            gradients_of(self._elements, layer, lines, self._size, *arrays, *parts)
            return by_filters_and_biases

        sums, by_biases = np.split(self._of_all_lines(of), [layer.weights.size])
        whole = torch.from_numpy(sums).view(SIDE, SIDE, layer.shape[2], FILTERS)
        by_filters.copy_(whole.permute(3, 2, 0, 1))
        # If all squares were empty, their biases would get these; less those of squares that are not.
        by_empty = torch.mv(weights.t(), by_bias).view(self._squares, FILTERS).sum(0)
        some, not_empty = torch.from_numpy(by_biases).view(2, FILTERS)
        by_filter_bias.copy_(some + (by_empty - not_empty) * (of_empty[:FILTERS] != 0))

    def _of_empty(self) -> Tensor:
        """Return what filters make of a picture that is empty."""
        return torch.from_numpy(self._layer.bias).relu().repeat(self._squares)


def _whole(rows: Tensor) -> Tensor:
    """Return rows, of a layer's outputs, with some of zeros where they do not make up whole panels."""
    missing = -len(rows) % PANEL
    return torch.cat((rows, rows.new_zeros(missing, *rows.shape[1:]))) if missing else rows
