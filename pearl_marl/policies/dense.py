"""Networks of two hidden layers, forward and back, compiled for a CPU.

They are small, and PyTorch would spend most of its time on calling operations and on moving values between
them. Here a few rows go through all layers at once, while they are in the processor's first cache.
Matrices are multiplied by a block of sums that stay in SIMD registers, made of LLVM's vectors.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Annotated, Any, NamedTuple

import numpy as np
from llvmlite import ir
from numba import njit, types

from pearl_marl.base.arrays import Array
from pearl_marl.compiler.loading import compiled_loop
from pearl_marl.compiler.vector_code import INDEX, LANES, VectorCode, function_of

ROWS = 64
"""Rows that go through all layers at once."""

HIGH, WIDE = 8, LANES
"""Size of a block of sums: eight vectors of sixteen."""

Vector = Annotated[Array, types.Array(types.float32, 1, "C")]
Matrix = Annotated[Array, types.Array(types.float32, 2, "C")]


class Layers(NamedTuple):
    """Weights, or gradients by them; all ``float32``. An output is ``third @ h + bias3``, and so on."""

    first: Matrix  # (width, inputs); for numbers as inputs, (width, 0)
    table: Matrix  # (numbers, width), of which rows are added to what the first layer makes; may be empty
    indicator: Matrix  # (positions, width), of which one is added; may be empty
    bias1: Vector
    second: Matrix  # (width, width)
    bias2: Vector
    third: Matrix  # (outputs, width)
    bias3: Vector
    layer_norm: bool  # whether what the first and the second layer make is standardised, row by row
    rectified: bool  # whether of that, what is below 0 becomes 0; else all becomes its hyperbolic tangent


class NetworkInputs(NamedTuple):
    """The inputs of a network, a row for each agent."""

    x: Array  # (n, inputs) float32, before they are standardised
    mean: Array  # (inputs,) float32, subtracted from them, before they are clipped at 10
    scale: Array  # (inputs,) float32
    numbers: Array  # (n, parts) int64: rows of the table
    position: Array  # (n,) int64: the row of the indicator; or empty

    def pick(self, rows: slice) -> NetworkInputs:
        """Return some rows."""
        position = self.position[rows] if len(self.position) else self.position
        return self._replace(x=self.x[rows], numbers=self.numbers[rows], position=position)


@function_of
def _block(code: VectorCode, c: Any, a: Any, b: Any, at: Any) -> None:
    """Add to a block of ``c`` the product of eight rows of ``a`` and sixteen columns of ``b``.

    ``at`` says where: first and width of ``c``; first of ``a`` and how far it is to the next row and column;
    first of ``b`` and how far to the next row; the number of products to add.
    """
    builder, (c0, width, a0, down, along, b0, across, depth) = code.builder, at
    rows = [builder.add(c0, code.times(width, row)) for row in range(HIGH)]
    before, outside = [code.load(c, row) for row in rows], builder.block
    body, after = builder.append_basic_block("sum"), builder.append_basic_block("summed")
    builder.branch(body)
    builder.position_at_end(body)
    # Not a loop over variables: where registers are few, LLVM would spill more of them.
    k, totals = builder.phi(INDEX), [builder.phi(sums.type) for sums in before]
    columns = code.load(b, builder.add(b0, builder.mul(k, across)))
    start, summed = builder.add(a0, builder.mul(k, along)), []
    for row, total in enumerate(totals):
        factor = code.factor(a, builder.add(start, code.times(down, row)))
        summed.append(code.plus_product(total, columns, factor))
    following = code.plus(k, 1)
    for phi, first, new in zip((k, *totals), (INDEX(0), *before), (following, *summed), strict=True):
        phi.add_incoming(first, outside)
        phi.add_incoming(new, body)
    builder.cbranch(builder.icmp_signed("<", following, depth), body, after)
    builder.position_at_end(after)
    for row, total in zip(rows, summed, strict=True):
        code.store(total, c, row)


@partial(function_of, result=types.float32)
def _power_of_two(code: VectorCode, exponent: Any) -> Any:
    """Return two to the power of an ``int32``, as a ``float32``."""
    builder, bits = code.builder, ir.IntType(32)
    return builder.bitcast(builder.shl(builder.add(exponent, bits(127)), bits(23)), ir.FloatType())


ARITHMETIC: Any = {"error_model": "numpy", "fastmath": {"contract"}}
# Only loops call them: without wrappers for Python, they compile sooner.
_FOR_LOOPS: Any = {**ARITHMETIC, "no_cpython_wrapper": True, "no_cfunc_wrapper": True}

_inlined: Callable[..., Any] = njit(forceinline=True, **_FOR_LOOPS)
called: Callable[..., Any] = njit(**_FOR_LOOPS)
# Sums of a row in any order, so that they are done by vectors.
_summed: Callable[..., Any] = njit(**{**_FOR_LOOPS, "fastmath": {"contract", "reassoc"}})

FARTHEST = 10
"""Deviations from the mean at which inputs are clipped."""

EPSILON = 1e-5
"""What layer norm adds to a variance."""

_FARTHEST, _EPSILON = np.float32(FARTHEST), np.float32(EPSILON)
_NONE, _ONE, _TWO, _HALF = np.float32(0), np.float32(1), np.float32(2), np.float32(0.5)
_PER_LN2, _LN2, _LN2_REST = np.float32(1.44269504), np.float32(0.693359375), np.float32(-2.12194440e-4)
_LOWEST, _HIGHEST = np.float32(-87), np.float32(88)
_TERMS = tuple(np.float32(1 / number) for number in (5040, 720, 120, 24, 6, 2))


@_inlined
def exponential(x: Any) -> Any:
    """Return the exponential of a ``float32``, to 2e-7 of it; a loop of it is done by vectors."""
    x = min(max(x, _LOWEST), _HIGHEST)
    power = np.floor(x * _PER_LN2 + _HALF)
    rest = x - power * _LN2 - power * _LN2_REST
    a, b, c, d, e, f = _TERMS
    series = (((((a * rest + b) * rest + c) * rest + d) * rest + e) * rest + f) * rest * rest + rest + _ONE
    return series * _power_of_two(np.int32(power))


@called
def _bend(h: Array, n: int, rectified: bool) -> None:
    """Put the first ``n`` numbers through the nonlinearity."""
    if rectified:
        for i in range(n):
            h[i] = _NONE if h[i] < _NONE else h[i]
        return
    for i in range(n):
        h[i] = _ONE - _TWO / (exponential(h[i] * _TWO) + _ONE)


@_inlined
def rounded_up(number: int, step: int) -> int:
    """Return a number rounded up to a multiple of a step."""
    return -(-number // step) * step


@called
def product(c, width, a, down, along, b, across, high, wide, depth):  # type: ignore[no-untyped-def]
    """Add to ``high`` rows of ``c`` the products of rows of ``a`` and columns of ``b``."""
    for row in range(0, high, HIGH):
        for column in range(0, wide, WIDE):
            _block(c, a, b, (row * width + column, width, row * down, down, along, column, across, depth))


class Padded(NamedTuple):
    """Weights as products need them: sizes rounded up, the rest zeros; and as they are, for the way back."""

    first: Array
    bias1: Array
    second: Array
    bias2: Array
    third: Array
    bias3: Array
    second_back: Array
    third_back: Array


class Tile(NamedTuple):
    """Memory for the inputs of a few rows, and for what layers make of them."""

    x: Array
    h1: Array
    h2: Array
    outputs: Array
    by_h2: Array
    by_h1: Array
    # With layer norm, what the layers made, standardised, and the factors that did it; else empty.
    norm1: Array
    norm2: Array
    scale1: Array
    scale2: Array


@called
def padded(layers: Layers) -> Padded:
    """Return weights as products need them."""
    width, inputs = layers.first.shape
    outputs = layers.third.shape[0]
    high, wide, out = rounded_up(width, WIDE), rounded_up(inputs, HIGH), rounded_up(outputs, WIDE)
    first, second = np.zeros(wide * high, np.float32), np.zeros(high * high, np.float32)
    third, second_back = np.zeros(high * out, np.float32), np.zeros(high * high, np.float32)
    third_back = np.zeros(outputs * high, np.float32)
    bias1, bias2, bias3 = np.zeros(high, np.float32), np.zeros(high, np.float32), np.zeros(out, np.float32)
    for i in range(width):
        for k in range(inputs):
            first[k * high + i] = layers.first[i, k]
        for k in range(width):
            second[k * high + i] = second_back[i * high + k] = layers.second[i, k]
        for k in range(outputs):
            third[i * out + k] = third_back[k * high + i] = layers.third[k, i]
        bias1[i], bias2[i] = layers.bias1[i], layers.bias2[i]
    for k in range(outputs):
        bias3[k] = layers.bias3[k]
    return Padded(first, bias1, second, bias2, third, bias3, second_back, third_back)


@called
def tile_of(layers: Layers) -> Tile:
    """Return memory for a few rows."""
    width, inputs = layers.first.shape
    high, wide = ROWS * rounded_up(width, WIDE), ROWS * rounded_up(inputs, HIGH)
    out = ROWS * rounded_up(layers.third.shape[0], WIDE)
    normed, rows = (high, ROWS) if layers.layer_norm else (0, 0)
    return Tile(
        np.zeros(wide, np.float32),
        np.empty(high, np.float32),
        np.empty(high, np.float32),
        np.empty(out, np.float32),
        np.empty(high, np.float32),
        np.empty(high, np.float32),
        np.empty(normed, np.float32),
        np.empty(normed, np.float32),
        np.empty(rows, np.float32),
        np.empty(rows, np.float32),
    )


@called
def begin_with(h: Array, bias: Array, rows: int) -> None:
    """Set some rows to the biases."""
    width = len(bias)
    for row in range(rows):
        for i in range(width):
            h[row * width + i] = bias[i]


@_summed
def _standardised(h: Array, width: int, high: int, rows: int, norm: Array, scale: Array) -> None:
    """Replace the first ``width`` of every ``high`` numbers by their layer norm; keep it, and its factors."""
    for row in range(rows):
        # Loops over slices are done by vectors, as no index of theirs can be negative.
        some, kept = h[row * high : row * high + width], norm[row * high : (row + 1) * high]
        mean = squares = _NONE
        for i in range(width):
            mean += some[i]
        mean /= np.float32(width)
        for i in range(width):
            squares += (some[i] - mean) * (some[i] - mean)
        factor = _ONE / np.sqrt(squares / np.float32(width) + _EPSILON)
        for i in range(width):
            kept[i] = some[i] = (some[i] - mean) * factor
        kept[width:] = 0
        scale[row] = factor


@_summed
def _through_norm(by: Array, width: int, high: int, rows: int, norm: Array, scale: Array) -> None:
    """Turn gradients by layer norm's outputs into gradients by its inputs."""
    for row in range(rows):
        some, kept = by[row * high : row * high + width], norm[row * high : row * high + width]
        mean = along = _NONE
        for i in range(width):
            mean += some[i]
            along += some[i] * kept[i]
        mean, along, factor = mean / np.float32(width), along / np.float32(width), scale[row]
        for i in range(width):
            some[i] = (some[i] - mean - kept[i] * along) * factor


@called
def forward_rows(layers: Layers, weights: Padded, observed: NetworkInputs, rows: Array, tile: Tile) -> None:
    """Compute the outputs of at most :data:`ROWS` rows, into the tile."""
    inputs, n = layers.first.shape[1], len(rows)
    high, wide, out = len(weights.bias1), rounded_up(inputs, HIGH), len(weights.bias3)
    x, h1, h2 = tile.x, tile.h1, tile.h2
    some = rounded_up(n, HIGH)
    begin_with(h1, weights.bias1, some)
    for s in range(n):
        for part in range(observed.numbers.shape[1]):
            number = observed.numbers[rows[s], part]
            for i in range(layers.table.shape[1]):
                h1[s * high + i] += layers.table[number, i]
    if len(observed.position):
        for s in range(n):
            number = observed.position[rows[s]]
            for i in range(layers.indicator.shape[1]):
                h1[s * high + i] += layers.indicator[number, i]
    if inputs:
        for s in range(n):
            # Over slices this is done by vectors, and the next row is fetched while one is on its way.
            given, made = observed.x[rows[s]], x[s * wide : s * wide + inputs]
            for k in range(inputs):
                value = (given[k] - observed.mean[k]) * observed.scale[k]
                made[k] = min(max(value, -_FARTHEST), _FARTHEST)
        x[n * wide : some * wide] = 0
        product(h1, high, x, wide, 1, weights.first, high, some, high, inputs)
    width = layers.first.shape[0]
    if layers.layer_norm:
        _standardised(h1, width, high, some, tile.norm1, tile.scale1)
    _bend(h1, some * high, layers.rectified)
    begin_with(h2, weights.bias2, some)
    product(h2, high, h1, high, 1, weights.second, high, some, high, high)
    if layers.layer_norm:
        _standardised(h2, width, high, some, tile.norm2, tile.scale2)
    _bend(h2, some * high, layers.rectified)
    begin_with(tile.outputs, weights.bias3, some)
    product(tile.outputs, out, h2, high, 1, weights.third, out, some, out, high)


@called
def gradient_sums(gradients: Layers) -> Padded:
    """Return zeros to add up gradients in; gradients by tables are added up where they stay."""
    gradients.table[:] = 0
    gradients.indicator[:] = 0
    width, inputs = gradients.first.shape
    outputs = gradients.third.shape[0]
    high, wide, out = rounded_up(width, WIDE), rounded_up(inputs, HIGH), rounded_up(outputs, WIDE)
    none = np.zeros(0, np.float32)
    return Padded(
        np.zeros(wide * high, np.float32),
        np.zeros(high, np.float32),
        np.zeros(high * high, np.float32),
        np.zeros(high, np.float32),
        np.zeros(rounded_up(outputs, HIGH) * high, np.float32),
        np.zeros(out, np.float32),
        none,
        none,
    )


@called
def column_sums(by: Array, bias: Array, rows: int) -> None:
    """Add some rows to the biases."""
    width = len(bias)
    for row in range(rows):
        for i in range(width):
            bias[i] += by[row * width + i]


@called
def _through_bend(by: Array, h: Array, n: int, rectified: bool) -> None:
    if rectified:
        for i in range(n):
            by[i] = _NONE if h[i] <= _NONE else by[i]  # what is no number stays one
        return
    for i in range(n):
        by[i] *= _ONE - h[i] * h[i]


@called
def backward_rows(
    layers: Layers,
    weights: Padded,
    observed: NetworkInputs,
    rows: Array,
    tile: Tile,
    total: Padded,
    gradients: Layers,
) -> None:
    """Add to the sums the gradients of rows that :func:`forward_rows` has computed.

    The tile's ``outputs`` hold the gradients by these; zeros, where there is no such row or output.
    """
    outputs, n, width = layers.third.shape[0], len(rows), layers.first.shape[0]
    high, wide, out = len(weights.bias1), rounded_up(layers.first.shape[1], HIGH), len(weights.bias3)
    by, h1, h2, by_h2, by_h1 = tile.outputs, tile.h1, tile.h2, tile.by_h2, tile.by_h1
    some = rounded_up(n, HIGH)
    column_sums(by, total.bias3, some)
    product(total.third, high, by, 1, out, h2, high, rounded_up(outputs, HIGH), high, some)
    by_h2[: some * high] = 0
    product(by_h2, high, by, out, 1, weights.third_back, high, some, high, outputs)
    _through_bend(by_h2, h2, some * high, layers.rectified)
    if layers.layer_norm:
        _through_norm(by_h2, width, high, some, tile.norm2, tile.scale2)
    column_sums(by_h2, total.bias2, some)
    product(total.second, high, by_h2, 1, high, h1, high, high, high, some)
    by_h1[: some * high] = 0
    product(by_h1, high, by_h2, high, 1, weights.second_back, high, some, high, high)
    _through_bend(by_h1, h1, some * high, layers.rectified)
    if layers.layer_norm:
        _through_norm(by_h1, width, high, some, tile.norm1, tile.scale1)
    column_sums(by_h1, total.bias1, some)
    if wide:
        product(total.first, high, tile.x, 1, wide, by_h1, high, wide, high, some)
    for s in range(n):
        for part in range(observed.numbers.shape[1]):
            number = observed.numbers[rows[s], part]
            for i in range(layers.table.shape[1]):
                gradients.table[number, i] += by_h1[s * high + i]
    if len(observed.position):
        for s in range(n):
            number = observed.position[rows[s]]
            for i in range(layers.indicator.shape[1]):
                gradients.indicator[number, i] += by_h1[s * high + i]


@called
def store_gradients(total: Padded, gradients: Layers) -> None:
    """Write the sums into the gradients; those by tables are there already."""
    width, inputs = gradients.first.shape
    outputs, high = gradients.third.shape[0], len(total.bias1)
    for i in range(width):
        for k in range(inputs):
            gradients.first[i, k] = total.first[k * high + i]
        for k in range(width):
            gradients.second[i, k] = total.second[i * high + k]
        for k in range(outputs):
            gradients.third[k, i] = total.third[k * high + i]
        gradients.bias1[i], gradients.bias2[i] = total.bias1[i], total.bias2[i]
    for k in range(outputs):
        gradients.bias3[k] = total.bias3[k]


def _forward(layers: Layers, observed: NetworkInputs, outputs: Array) -> None:
    """Compute outputs, shape ``(n, outputs)``."""
    weights, tile = padded(layers), tile_of(layers)
    out = len(weights.bias3)
    numbers = np.arange(len(outputs))
    for start in range(0, len(outputs), ROWS):
        rows = numbers[start : start + ROWS]
        forward_rows(layers, weights, observed, rows, tile)
        for s in range(len(rows)):
            for k in range(outputs.shape[1]):
                outputs[start + s, k] = tile.outputs[s * out + k]


def _backward(layers: Layers, observed: NetworkInputs, by_outputs: Array, gradients: Layers) -> None:
    """Compute gradients from those by the outputs; hidden layers are computed again."""
    weights, tile, total = padded(layers), tile_of(layers), gradient_sums(gradients)
    out = len(weights.bias3)
    numbers = np.arange(len(by_outputs))
    for start in range(0, len(by_outputs), ROWS):
        rows = numbers[start : start + ROWS]
        forward_rows(layers, weights, observed, rows, tile)
        tile.outputs[:] = 0
        for s in range(len(rows)):
            for k in range(by_outputs.shape[1]):
                tile.outputs[s * out + k] = by_outputs[start + s, k]
        backward_rows(layers, weights, observed, rows, tile, total, gradients)
    store_gradients(total, gradients)


forward = compiled_loop(_forward, fused=True)
backward = compiled_loop(_backward, fused=True)
