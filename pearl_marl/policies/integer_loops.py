"""Integer networks, compiled for a CPU: a few agents at a time go through all layers, in the first cache.

Inputs of a tile lie side by side, two to a word of 32 bits, as the processor's sums of products of 16 bits
take them (``pmaddwd`` of x86, ``smlal`` of ARM; LLVM finds them by itself where it is not told).
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from importlib import import_module
from typing import Any, NamedTuple

import llvmlite.binding as llvm
import numpy as np
from llvmlite import ir
from numba import njit, types
from numba.extending import intrinsic

from pearl_marl.compiler.loading import compiled_loop
from pearl_marl.policies.device_policy import Array
from pearl_marl.policies.integer_network import ENTRIES, IntegerNetwork, Levels, Patches, Rows, Scaling

TILE = 64
"""Agents that go through all layers at once."""

LANES, VECTORS, HIGH = 16, TILE // 16, 4
"""Sums of a vector; vectors of a tile; outputs whose sums are kept in registers."""

HALF = ENTRIES // 2

_WORD, _INDEX = ir.IntType(32), ir.IntType(64)
_SUMS, _PAIRS = ir.VectorType(_WORD, LANES), ir.VectorType(ir.IntType(16), 2 * LANES)

SCALED, LOOKED_UP, PLANES = range(3)
GREATEST, DRAWN, LEVELS = range(3)


class Prepared(NamedTuple):
    """A network as compiled loops take it. Weights of all layers lie one after the other, in pairs."""

    kind: int  # SCALED, LOOKED_UP or PLANES
    offset: Array  # int64, one an element; of LOOKED_UP one a choice: the row of zeros
    multiplier: Array
    input_shift: Array
    limit: int
    factors: Array  # int64, (choices, elements)
    table: Array  # int32, (rows, width)
    indicator: Array  # int32, (agents, width)
    filters: Array  # int32, (9 * planes, filters): weights of an element of a patch
    filter_bias: Array  # int32
    shape: Array  # int64: rows, columns, planes
    weights: Array  # int32: pairs of weights, a row an output
    bias: Array  # int32
    sizes: Array  # int64, (layers, 2): pairs of inputs, outputs rounded up to a multiple of HIGH
    shifts: Array  # int64
    limits: Array  # int64
    tables: Array  # int32, (layers, 1024)
    tabled: Array  # bool: whether a layer's sums are looked up
    chooses: int  # GREATEST, DRAWN or LEVELS
    counts: Array  # int64
    chance_shift: int
    chances: Array  # int64
    level: Array  # int64, (4, fields): multiplier, offset, low, high
    level_shift: int
    draws: int


def prepared(network: IntegerNetwork) -> Prepared:
    """Return a network as compiled loops take it."""
    inputs, head, layers = network.inputs, network.head, network.layers
    none = np.zeros(0, np.int64)
    offset, multiplier, shift, limit, kind = none, none, none, 0, SCALED
    factors = np.zeros((0, 0), np.int64)
    table, filters, filter_bias, shape = (
        np.zeros((0, 0), np.int32),
        np.zeros((0, 0), np.int32),
        np.zeros(0, np.int32),
        none,
    )
    match inputs:
        case Scaling():
            offset, multiplier, shift = (array.astype(np.int64) for array in inputs[:3])
            limit = inputs.limit
        case Rows():
            kind, offset, factors = LOOKED_UP, inputs.first.astype(np.int64), inputs.factors.astype(np.int64)
            table = inputs.table.astype(np.int32)
        case Patches():
            kind, limit, shape = PLANES, inputs.limit, np.array(inputs.shape, np.int64)
            shift = np.array([inputs.shift], np.int64)
            filters = np.ascontiguousarray(inputs.weights.reshape(len(inputs.bias), -1).T.astype(np.int32))
            filter_bias = inputs.bias.astype(np.int32)
    weights, bias, sizes = [], [], []
    for layer in layers:
        outputs, width = layer.weights.shape
        pairs, up = -(-width // 2), -(-outputs // HIGH) * HIGH
        padded = np.zeros((up, 2 * pairs), np.int16)
        padded[:outputs, :width] = layer.weights
        weights.append(padded.view(np.int32).ravel())
        bias.append(np.concatenate([layer.bias.astype(np.int32), np.zeros(up - outputs, np.int32)]))
        sizes.append((pairs, up))
    tables = np.zeros((len(layers), ENTRIES), np.int32)
    for k, layer in enumerate(layers):
        if len(layer.activation):
            tables[k] = layer.activation
    if isinstance(head, Levels):
        chooses, counts, chances, chance_shift = LEVELS, none, none, 0
        level, level_shift = (
            np.array([head.multiplier, head.offset, head.low, head.high], np.int64),
            head.shift,
        )
    else:
        chooses, counts = (DRAWN if len(head.weights) else GREATEST), np.array(head.counts, np.int64)
        chances, chance_shift = head.weights.astype(np.int64), head.shift
        level, level_shift = np.zeros((4, 0), np.int64), 0
    return Prepared(
        kind,
        offset,
        multiplier,
        shift,
        limit,
        np.ascontiguousarray(factors),
        np.ascontiguousarray(table),
        np.ascontiguousarray(network.indicator, np.int32),
        filters,
        filter_bias,
        shape,
        np.concatenate(weights),
        np.concatenate(bias),
        np.array(sizes, np.int64),
        np.array([layer.shift for layer in layers], np.int64),
        np.array([layer.limit for layer in layers], np.int64),
        tables,
        np.array([len(layer.activation) > 0 for layer in layers]),
        chooses,
        counts,
        chance_shift,
        chances,
        level,
        level_shift,
        network.draws,
    )


def _data(context: Any, builder: Any, of: Any, array: Any) -> Any:
    # By name: nobody who only imports this package should wait for Numba's module about arrays.
    return import_module("numba.np.arrayobj").make_array(of)(context, builder, array).data


@functools.cache
def _instruction() -> tuple[str, int] | None:
    """Return LLVM's name for this processor's sums of pairs of products, and how many sums it makes."""
    features = llvm.get_host_cpu_features()
    if features.get("avx512bw"):
        return "llvm.x86.avx512.pmaddw.d.512", 16
    if features.get("avx2"):
        return "llvm.x86.avx2.pmadd.wd", 8
    return None


def _products(builder: Any, left: Any, right: Any) -> Any:
    """Return the sums of products of pairs, of vectors of pairs."""
    if (known := _instruction()) is not None:
        name, lanes = known
        pairs, sums = ir.VectorType(ir.IntType(16), 2 * lanes), ir.VectorType(_WORD, lanes)
        function = builder.module.globals.get(name) or ir.Function(
            builder.module, ir.FunctionType(sums, [pairs, pairs]), name
        )
        if lanes == LANES:
            return builder.call(function, [left, right])
        halves = [builder.call(function, [_half(builder, left, k), _half(builder, right, k)]) for k in (0, 1)]
        return builder.shuffle_vector(*halves, ir.Constant(ir.VectorType(_WORD, LANES), list(range(LANES))))

    def every_other(vector: Any, first: int) -> Any:
        chosen = ir.Constant(ir.VectorType(_WORD, LANES), list(range(first, 2 * LANES, 2)))
        return builder.sext(builder.shuffle_vector(vector, ir.Constant(_PAIRS, ir.Undefined), chosen), _SUMS)

    even, odd = (builder.mul(every_other(left, k), every_other(right, k)) for k in (0, 1))
    return builder.add(even, odd)


def _half(builder: Any, vector: Any, which: int) -> Any:
    chosen = ir.Constant(ir.VectorType(_WORD, LANES), list(range(which * LANES, (which + 1) * LANES)))
    return builder.shuffle_vector(vector, ir.Constant(_PAIRS, ir.Undefined), chosen)


_intrinsic: Any = intrinsic


@_intrinsic  # type: ignore[untyped-decorator]
def _add_products(_: Any, sums: Any, weights: Any, inputs: Any, at: Any) -> Any:
    """Add to the sums of HIGH outputs the products of their weights with a tile's inputs.

    ``at`` is the first of the sums, the first of the weights, and how many pairs of inputs there are.
    """

    def generate(context: Any, builder: Any, signature: Any, operands: Any) -> Any:
        arrays = zip(signature.args[:3], operands[:3], strict=True)
        out, left, right = (_data(context, builder, of, array) for of, array in arrays)
        first_sum, first_weight, pairs = (builder.extract_value(operands[3], k) for k in range(3))

        def vector(of: Any, index: Any) -> Any:
            return builder.bitcast(builder.gep(of, [index]), _SUMS.as_pointer())

        def plus(index: Any, constant: int) -> Any:
            return builder.add(index, _INDEX(constant))

        places = [
            [vector(out, plus(first_sum, row * TILE + v * LANES)) for v in range(VECTORS)]
            for row in range(HIGH)
        ]
        before = [[builder.load(place, align=4) for place in row] for row in places]
        starts = [builder.add(first_weight, builder.mul(pairs, _INDEX(row))) for row in range(HIGH)]
        outside = builder.block
        again, after = builder.append_basic_block("pair"), builder.append_basic_block("summed")
        builder.cbranch(builder.icmp_signed(">", pairs, _INDEX(0)), again, after)
        builder.position_at_end(again)
        k = builder.phi(_INDEX)
        k.add_incoming(_INDEX(0), outside)
        totals = [[builder.phi(_SUMS) for _ in row] for row in places]
        start = builder.mul(k, _INDEX(TILE))
        given = [
            builder.bitcast(builder.load(vector(right, plus(start, v * LANES)), align=4), _PAIRS)
            for v in range(VECTORS)
        ]
        empty, first = ir.Constant(_SUMS, ir.Undefined), ir.Constant(ir.VectorType(_WORD, LANES), [0] * LANES)
        summed = []
        for row in range(HIGH):
            pair = builder.load(builder.gep(left, [builder.add(starts[row], k)]))
            spread = builder.shuffle_vector(builder.insert_element(empty, pair, _WORD(0)), empty, first)
            spread = builder.bitcast(spread, _PAIRS)
            summed.append(
                [builder.add(totals[row][v], _products(builder, given[v], spread)) for v in range(VECTORS)]
            )
        for row in range(HIGH):
            for v in range(VECTORS):
                totals[row][v].add_incoming(before[row][v], outside)
                totals[row][v].add_incoming(summed[row][v], again)
        following = plus(k, 1)
        k.add_incoming(following, again)
        builder.cbranch(builder.icmp_signed("<", following, pairs), again, after)
        builder.position_at_end(after)
        # Phis come first in a block, so that stores have to wait.
        results = [[builder.phi(_SUMS) for _ in row] for row in places]
        for row in range(HIGH):
            for v in range(VECTORS):
                results[row][v].add_incoming(before[row][v], outside)
                results[row][v].add_incoming(summed[row][v], again)
        for row in range(HIGH):
            for v in range(VECTORS):
                builder.store(results[row][v], places[row][v], align=4)
        return context.get_dummy_value()

    return types.void(sums, weights, inputs, at), generate


_FOR_LOOPS: Any = {"error_model": "numpy", "no_cpython_wrapper": True, "no_cfunc_wrapper": True}
called: Callable[..., Any] = njit(**_FOR_LOOPS)


class Room(NamedTuple):
    """What a tile is on its way through the layers."""

    x: Array  # int32, (pairs, TILE)
    sums: Array  # int32, (outputs, TILE)


@called
def room_for(net: Prepared) -> Room:
    """Return room for a tile."""
    pairs, outputs = 1, 1
    for layer in range(len(net.sizes)):
        outputs = max(outputs, net.sizes[layer, 1])
        pairs = max(pairs, net.sizes[layer, 0], outputs // 2)
    return Room(np.zeros((pairs, TILE), np.int32), np.zeros((outputs, TILE), np.int32))


@called
def _scale(net: Prepared, elements: Array, first: int, n: int, x: Array) -> None:
    """Put a tile's inputs in pairs."""
    count = len(net.offset)
    for k in range(0, count, 2):
        for s in range(n):
            low = (elements[first + s, k] - net.offset[k]) * net.multiplier[k] >> net.input_shift[k]
            low = min(max(low, -net.limit), net.limit)
            x[k >> 1, s] = np.int32(low & 0xFFFF)
        if k + 1 < count:
            for s in range(n):
                high = (elements[first + s, k + 1] - net.offset[k + 1]) * net.multiplier[
                    k + 1
                ] >> net.input_shift[k + 1]
                high = min(max(high, -net.limit), net.limit)
                x[k >> 1, s] |= np.int32(high) << np.int32(16)


@called
def _see_planes(net: Prepared, elements: Array, first: int, n: int, x: Array, filtered: Array) -> None:
    """Put what filters find in a tile's planes in pairs. Most elements are 0, and cost nothing."""
    rows, columns, planes = net.shape[0], net.shape[1], net.shape[2]
    high, wide, filters = rows - 2, columns - 2, len(net.filter_bias)
    shift = net.input_shift[0]
    for s in range(n):
        for at in range(high * wide):
            for f in range(filters):
                filtered[at * filters + f] = net.filter_bias[f]
        for row in range(rows):
            for column in range(columns):
                for plane in range(planes):
                    if elements[first + s, (row * columns + column) * planes + plane]:
                        for i in range(max(0, row - high + 1), min(3, row + 1)):
                            for j in range(max(0, column - wide + 1), min(3, column + 1)):
                                at = ((row - i) * wide + column - j) * filters
                                of = (i * 3 + j) * planes + plane
                                for f in range(filters):
                                    filtered[at + f] += net.filters[of, f]
        for k in range(0, high * wide * filters, 2):
            low = min(max(filtered[k] >> shift, 0), net.limit)
            more = min(max(filtered[k + 1] >> shift, 0), net.limit) if k + 1 < len(filtered) else 0
            x[k >> 1, s] = np.int32(low) | np.int32(more) << np.int32(16)


@called
def _activate(net: Prepared, layer: int, sums: Array, x: Array) -> None:
    """Put what a layer's sums become in pairs."""
    shift, outputs = np.int32(net.shifts[layer]), net.sizes[layer, 1]
    if net.tabled[layer]:
        table = net.tables[layer]
        for j in range(0, outputs, 2):
            for s in range(TILE):
                low = table[
                    min(max(sums[j, s] >> shift, np.int32(-HALF)), np.int32(HALF - 1)) + np.int32(HALF)
                ]
                high = table[
                    min(max(sums[j + 1, s] >> shift, np.int32(-HALF)), np.int32(HALF - 1)) + np.int32(HALF)
                ]
                x[j >> 1, s] = (low & np.int32(0xFFFF)) | (high << np.int32(16))
    else:
        limit, none = np.int32(net.limits[layer]), np.int32(0)
        for j in range(0, outputs, 2):
            for s in range(TILE):
                low = min(max(sums[j, s] >> shift, none), limit)
                high = min(max(sums[j + 1, s] >> shift, none), limit)
                x[j >> 1, s] = low | (high << np.int32(16))


@called
def add_up(
    net: Prepared, elements: Array, first: int, n: int, first_agent: int, room: Room, filtered: Array
) -> None:
    """Compute the last sums of the ``n`` agents from ``first`` on, at most :data:`TILE`."""
    x, sums = room.x, room.sums
    if net.kind == SCALED:
        _scale(net, elements, first, n, x)
    elif net.kind == PLANES:
        _see_planes(net, elements, first, n, x, filtered)
    weight, bias = 0, 0
    for layer in range(len(net.sizes)):
        pairs, outputs = net.sizes[layer, 0], net.sizes[layer, 1]
        for j in range(outputs):
            for s in range(TILE):
                sums[j, s] = net.bias[bias + j]
        if layer == 0:
            if net.kind == LOOKED_UP:
                for s in range(n):
                    for k in range(len(net.offset)):
                        row = net.offset[k]
                        for e in range(net.factors.shape[1]):
                            row += net.factors[k, e] * np.int64(elements[first + s, e])
                        for j in range(net.table.shape[1]):
                            sums[j, s] += net.table[row, j]
            agents = len(net.indicator)
            if agents:
                for s in range(n):
                    for j in range(net.indicator.shape[1]):
                        sums[j, s] += net.indicator[(first_agent + s) % agents, j]
        for j in range(0, outputs, HIGH):
            _add_products(sums.reshape(-1), net.weights, x.reshape(-1), (j * TILE, weight + j * pairs, pairs))
        if layer + 1 < len(net.sizes):
            _activate(net, layer, sums, x)
        weight += pairs * outputs
        bias += outputs


@called
def choose_words(
    net: Prepared, sums: Array, first: int, n: int, masks: Array, draws: Array, words: Array, logits: Array
) -> None:
    """Choose the actions of a tile by its last sums; ``masks`` and ``logits`` may have no rows."""
    if net.chooses == LEVELS:
        for k in range(net.level.shape[1]):
            for s in range(n):
                word = (np.int64(sums[k, s]) * net.level[0, k] + net.level[1, k]) >> net.level_shift
                words[first + s, k] = min(max(word, net.level[2, k]), net.level[3, k])
        return
    masked, start = len(masks) > 0, 0
    for field in range(len(net.counts)):
        count = net.counts[field]
        for s in range(n):
            best, greatest, found = 0, np.int32(0), False
            for j in range(count):
                allowed = not masked or masks[first + s, j] != 0
                if allowed and (not found or sums[start + j, s] > greatest):
                    best, greatest, found = j, sums[start + j, s], True
            if net.chooses == DRAWN and found:
                total = 0
                for j in range(count):
                    if not masked or masks[first + s, j]:
                        distance = (np.int64(greatest) - sums[start + j, s]) >> net.chance_shift
                        total += net.chances[min(distance, ENTRIES - 1)]
                number = np.int64((np.uint64(draws[first + s, field]) * np.uint64(total)) >> np.uint64(32))
                for j in range(count):
                    if not masked or masks[first + s, j]:
                        distance = (np.int64(greatest) - sums[start + j, s]) >> net.chance_shift
                        number -= net.chances[min(distance, ENTRIES - 1)]
                        if number < 0:
                            best = j
                            break
            words[first + s, field] = best
        start += count
    if len(logits):
        for s in range(n):
            for j in range(logits.shape[1]):
                logits[first + s, j] = sums[j, s]


@called
def filtered_size(net: Prepared) -> int:
    """Return how many numbers filters find in an agent's planes."""
    return len(net.filter_bias) * (net.shape[0] - 2) * (net.shape[1] - 2) if net.kind == PLANES else 0


def _act(net, elements, masks, draws, words, logits):  # type: ignore[no-untyped-def]
    room, filtered = room_for(net), np.zeros(max(1, filtered_size(net)), np.int32)
    for start in range(0, len(words), TILE):
        some = min(TILE, len(words) - start)
        add_up(net, elements, start, some, start, room, filtered)
        choose_words(net, room.sums, start, some, masks, draws, words, logits)


compiled_act = compiled_loop(_act)
"""Return what chooses an action for each agent: ``act(net, elements, masks, draws, words, logits)``.

``elements`` are integers of shape ``(n, elements)``, of whole worlds; ``masks``, ``int8`` of shape
``(n, n_actions)`` or of no rows; ``draws``, ``uint32`` of shape ``(n, net.draws)``. The words of actions are
written to ``words``, ``int64`` of shape ``(n, fields)``, and logits to ``logits``, ``int32`` of shape
``(n, outputs)`` or of no rows.
"""
