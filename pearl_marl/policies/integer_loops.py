"""Integer networks, compiled for a CPU: a few agents at a time go through all layers, in the first cache.

Inputs of a tile lie side by side, two to a word of 32 bits, as the processor's sums of products of 16 bits
take them (``pmaddwd`` of x86, ``smlal`` of ARM; LLVM finds them by itself where it is not told).
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator
from importlib import import_module
from typing import Any, NamedTuple

import numpy as np
from llvmlite import ir
from numba import njit, types
from numba.core.registry import cpu_target
from numba.extending import intrinsic

from pearl_marl.compiler.loading import compiled_loop
from pearl_marl.policies.device_policy import Array
from pearl_marl.policies.integer_network import ENTRIES, Head, IntegerNetwork, Levels, Patches, Rows, Scaling

TILE = 64
"""Agents that go through all layers at once."""

LANES, VECTORS, HIGH = 16, TILE // 16, 4
"""Sums of a vector; vectors of a tile; outputs whose sums are kept in registers."""

HALF = ENTRIES // 2

_WORD, _INDEX = ir.IntType(32), ir.IntType(64)
_SUMS, _PAIRS = ir.VectorType(_WORD, LANES), ir.VectorType(ir.IntType(16), 2 * LANES)

SCALED, LOOKED_UP, PICKED, PLANES = range(4)
GREATEST, DRAWN, LEVELS = range(3)
CUT, TABLE, BYTES = range(3)
PAIRS, OUTPUTS, SHIFT, LIMIT, ACTIVATION = range(5)


class Prepared(NamedTuple):
    """A network as compiled loops take it. Weights of all layers lie one after the other, in pairs."""

    kind: int  # SCALED, LOOKED_UP, PICKED or PLANES
    size: int  # bytes of an element
    sign: int  # its sign bit, if it has one and less than 64 bits
    width: int  # elements of an observation
    offset: Array  # int64, one an element; of LOOKED_UP and PICKED one a choice: the row of zeros
    multiplier: Array
    input_shift: Array
    limit: int
    factors: Array  # int64, (choices, elements)
    table: Array  # int32, (rows, width)
    picks: Array  # int32, (rows, fields): the action of each row, where a row decides
    indicator: Array  # int32, (agents, width)
    filters: Array  # int32, (planes, 3 rows, 3 columns from last to first, filters)
    filter_bias: Array  # int32
    shape: Array  # int64: rows, columns, planes
    weights: Array  # int32: pairs of weights, a row an output
    bias: Array  # int32
    layers: Array  # int64, (layers, 5): pairs of inputs, outputs rounded up to a multiple of HIGH, and others
    tables: Array  # int32, (layers, 1024)
    bytes: Array  # int8, (layers, 1024): the same from the entry of 0 on, where they fit
    chooses: int  # GREATEST, DRAWN or LEVELS
    counts: Array  # int64
    chance_shift: int
    chances: Array  # int64
    level: Array  # int64, (4, fields): multiplier, offset, low, high
    level_shift: int
    draws: int


def prepared(network: IntegerNetwork, dtype: np.dtype[Any]) -> Prepared:
    """Return a network as compiled loops take it, for elements of a dtype."""
    inputs, head, layers = network.inputs, network.head, network.layers
    none, empty = np.zeros(0, np.int64), np.zeros((0, 0), np.int32)
    offset, multiplier, shift, limit, kind = none, none, none, 0, SCALED
    factors, table, picks, shape = np.zeros((0, 0), np.int64), empty, empty, none
    filters, filter_bias = np.zeros((0, 0, 0, 0), np.int32), np.zeros(0, np.int32)
    match inputs:
        case Scaling():
            offset, multiplier, shift = (array.astype(np.int64) for array in inputs[:3])
            limit = inputs.limit
        case Rows():
            kind, offset, factors = LOOKED_UP, inputs.first.astype(np.int64), inputs.factors.astype(np.int64)
            table = np.array(inputs.table, np.int32, order="C")
            if _row_decides(network):
                kind, picks = PICKED, _picks(table + layers[0].bias.astype(np.int64), head)
        case Patches():
            kind, limit, shape = PLANES, inputs.limit, np.array(inputs.shape, np.int64)
            shift = np.array([inputs.shift], np.int64)
            filters = np.array(inputs.weights.transpose(3, 1, 2, 0)[:, :, ::-1], np.int32, order="C")
            filter_bias = inputs.bias.astype(np.int32)
    weights, bias = [], []
    facts = np.zeros((len(layers), 5), np.int64)
    tables, as_bytes = np.zeros((len(layers), ENTRIES), np.int32), np.zeros((len(layers), ENTRIES), np.int8)
    for k, layer in enumerate(layers):
        outputs, width = layer.weights.shape
        pairs, up = -(-width // 2), -(-outputs // HIGH) * HIGH
        padded = np.zeros((up, 2 * pairs), np.int16)
        padded[:outputs, :width] = layer.weights
        weights.append(padded.view(np.int32).ravel())
        bias.append(np.concatenate([layer.bias.astype(np.int32), np.zeros(up - outputs, np.int32)]))
        activation = CUT
        if len(layer.activation):
            tables[k] = layer.activation
            activation = TABLE
            if _looks_up_bytes() and abs(tables[k]).max() <= np.iinfo(np.int8).max:
                as_bytes[k], activation = np.roll(tables[k], -HALF), BYTES
        facts[k] = pairs, up, layer.shift, layer.limit, activation
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
    signed = dtype.kind == "i" and dtype.itemsize < 8
    return Prepared(
        kind,
        dtype.itemsize,
        1 << 8 * dtype.itemsize - 1 if signed else 0,
        network.spec.observation_size,
        offset,
        multiplier,
        shift,
        limit,
        factors,
        table,
        picks,
        np.array(network.indicator, np.int32, order="C"),
        filters,
        filter_bias,
        shape,
        np.concatenate(weights),
        np.concatenate(bias),
        facts,
        tables,
        as_bytes,
        chooses,
        counts,
        chance_shift,
        chances,
        level,
        level_shift,
        network.draws,
    )


def _row_decides(network: IntegerNetwork) -> bool:
    """Return whether a row of the table is all that an action depends on."""
    inputs, head = network.inputs, network.head
    return (
        isinstance(inputs, Rows)
        and len(inputs.first) == 1 == len(network.layers)
        and not len(network.indicator)
        and not network.spec.mask_fields
        and isinstance(head, Head)
        and not len(head.weights)
    )


def _picks(logits: Array, head: Head | Levels) -> Array:
    """Return the action of each row of logits."""
    assert isinstance(head, Head)
    ends = np.cumsum(head.counts)
    fields = [logits[:, end - count : end].argmax(1) for end, count in zip(ends, head.counts, strict=True)]
    return np.stack(fields, 1).astype(np.int32)


def _data(context: Any, builder: Any, of: Any, array: Any) -> Any:
    # By name: nobody who only imports this package should wait for Numba's module about arrays.
    return import_module("numba.np.arrayobj").make_array(of)(context, builder, array).data


@functools.cache
def _features() -> frozenset[str]:
    """Return what the processor can do that Numba compiles for."""
    _, _, features = cpu_target.target_context.codegen().magic_tuple()
    return frozenset(features.split(","))


def _instruction() -> tuple[str, int] | None:
    """Return LLVM's name for this processor's sums of pairs of products, and how many sums it makes."""
    if "+avx512bw" in _features():
        return "llvm.x86.avx512.pmaddw.d.512", 16
    if "+avx2" in _features():
        return "llvm.x86.avx2.pmadd.wd", 8
    return None


def _looks_up_bytes() -> bool:
    """Return whether the processor looks up 64 bytes at once in a table of 128."""
    return {"+avx512bw", "+avx512vbmi"} <= _features()


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


def _spread(builder: Any, word: Any) -> Any:
    """Return a vector of the same word."""
    empty, first = ir.Constant(_SUMS, ir.Undefined), ir.Constant(ir.VectorType(_WORD, LANES), [0] * LANES)
    return builder.shuffle_vector(builder.insert_element(empty, word, _WORD(0)), empty, first)


_intrinsic: Any = intrinsic


@_intrinsic  # type: ignore[untyped-decorator]
def _add_products(_: Any, sums: Any, weights: Any, inputs: Any, biases: Any, at: Any) -> Any:
    """Make the sums of HIGH outputs: biases and the products of their weights with a tile's inputs.

    ``at`` is the first of the sums, the first of the weights, how many pairs of inputs there are, the first
    of the biases, and 1 where the products are to be added to the sums as they are instead.
    """

    def generate(context: Any, builder: Any, signature: Any, operands: Any) -> Any:
        arrays = zip(signature.args[:4], operands[:4], strict=True)
        out, left, right, own = (_data(context, builder, of, array) for of, array in arrays)
        first_sum, first_weight, pairs, first_bias, adds = (
            builder.extract_value(operands[4], k) for k in range(5)
        )
        adds = builder.trunc(adds, ir.IntType(1))

        def vector(of: Any, index: Any) -> Any:
            return builder.bitcast(builder.gep(of, [index]), _SUMS.as_pointer())

        def plus(index: Any, constant: int) -> Any:
            return builder.add(index, _INDEX(constant))

        places = [
            [vector(out, plus(first_sum, row * TILE + v * LANES)) for v in range(VECTORS)]
            for row in range(HIGH)
        ]
        begun = [
            _spread(builder, builder.load(builder.gep(own, [plus(first_bias, row)]))) for row in range(HIGH)
        ]
        before = [
            [builder.select(adds, builder.load(place, align=4), start) for place in row]
            for row, start in zip(places, begun, strict=True)
        ]
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
        summed = []
        for row in range(HIGH):
            pair = builder.load(builder.gep(left, [builder.add(starts[row], k)]))
            factor = builder.bitcast(_spread(builder, pair), _PAIRS)
            summed.append(
                [builder.add(totals[row][v], _products(builder, given[v], factor)) for v in range(VECTORS)]
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

    return types.void(sums, weights, inputs, biases, at), generate


def _in_pairs(builder: Any, sums: Any, at: Any, ends: tuple[Any, Any]) -> Iterator[Any]:
    """Yield the sums of two outputs, shifted and cut, in pairs; ``at`` is the first, and the shift."""
    by = _spread(builder, builder.trunc(at[1], _WORD))
    for v in range(VECTORS):
        halves = []
        for row in range(2):
            place = builder.gep(sums, [builder.add(at[0], _INDEX(row * TILE + v * LANES))])
            word = builder.ashr(builder.load(builder.bitcast(place, _SUMS.as_pointer()), align=4), by)
            for order, end in zip("<>", ends, strict=True):
                word = builder.select(builder.icmp_signed(order, word, end), end, word)
            halves.append(word)
        low = builder.and_(halves[0], ir.Constant(_SUMS, [0xFFFF] * LANES))
        high = builder.shl(halves[1], ir.Constant(_SUMS, [16] * LANES))
        yield builder.bitcast(builder.or_(low, high), _PAIRS)


def _store_pairs(builder: Any, pairs: Any, x: Any, first: Any) -> None:
    for v, pair in enumerate(pairs):
        place = builder.gep(x, [builder.add(first, _INDEX(v * LANES))])
        builder.store(pair, builder.bitcast(place, _PAIRS.as_pointer()), align=4)


@_intrinsic  # type: ignore[untyped-decorator]
def _cut(_: Any, sums: Any, x: Any, at: Any) -> Any:
    """Cut the sums of two outputs at 0 and a limit, and put them in pairs.

    ``at`` is the first of the sums, the shift, the first of the pairs, and the limit.
    """

    def generate(context: Any, builder: Any, signature: Any, operands: Any) -> Any:
        arrays = zip(signature.args[:2], operands[:2], strict=True)
        own, to = (_data(context, builder, of, array) for of, array in arrays)
        first, shift, first_pair, limit = (builder.extract_value(operands[2], k) for k in range(4))
        ends = ir.Constant(_SUMS, [0] * LANES), _spread(builder, builder.trunc(limit, _WORD))
        _store_pairs(builder, _in_pairs(builder, own, (first, shift), ends), to, first_pair)
        return context.get_dummy_value()

    return types.void(sums, x, at), generate


@_intrinsic  # type: ignore[untyped-decorator]
def _look_up(_: Any, sums: Any, table: Any, x: Any, at: Any) -> Any:
    """Look up what the sums of two outputs become, in a table of bytes, and put them in pairs.

    ``at`` is the first of the sums, the shift, the first of the pairs, and the first byte of the table.
    """

    def generate(context: Any, builder: Any, signature: Any, operands: Any) -> Any:
        if not _looks_up_bytes():
            return context.get_dummy_value()
        arrays = zip(signature.args[:3], operands[:3], strict=True)
        own, entries, to = (_data(context, builder, of, array) for of, array in arrays)
        first, shift, first_pair, first_entry = (builder.extract_value(operands[3], k) for k in range(4))
        some = ir.VectorType(ir.IntType(8), 4 * LANES)
        name = "llvm.x86.avx512.vpermi2var.qi.512"
        permute = builder.module.globals.get(name) or ir.Function(
            builder.module, ir.FunctionType(some, [some] * 3), name
        )
        parts = []
        for k in range(0, ENTRIES, 4 * LANES):
            place = builder.gep(entries, [builder.add(first_entry, _INDEX(k))])
            parts.append(builder.load(builder.bitcast(place, some.as_pointer()), align=1))

        def halves(number: int) -> Any:
            return ir.Constant(_PAIRS, [number] * 2 * LANES)

        def mixed(even: Any, odd: Any) -> Any:
            """Return the lower bytes of one vector, and the upper ones of another."""
            return builder.or_(builder.and_(even, halves(0xFF)), builder.and_(odd, halves(-256)))

        ends = (ir.Constant(_SUMS, [end] * LANES) for end in (-HALF, HALF - 1))
        pairs = list(_in_pairs(builder, own, (first, shift), tuple(ends)))
        done: list[Any] = []
        for even, odd in zip(pairs[::2], pairs[1::2], strict=True):
            # The instruction takes the lowest 7 bits of an index.
            low = builder.bitcast(mixed(even, builder.shl(odd, halves(8))), some)
            high = mixed(builder.lshr(even, halves(7)), builder.shl(odd, halves(1)))
            high = builder.bitcast(high, some)
            found = [builder.call(permute, [a, low, b]) for a, b in zip(parts[::2], parts[1::2], strict=True)]
            for bit in range(3):
                flag = builder.and_(high, ir.Constant(some, [1 << bit] * 4 * LANES))
                chosen = builder.icmp_unsigned("!=", flag, ir.Constant(some, [0] * 4 * LANES))
                found = [builder.select(chosen, b, a) for a, b in zip(found[::2], found[1::2], strict=True)]
            both = builder.bitcast(found[0], _PAIRS)
            done += [builder.ashr(builder.shl(both, halves(8)), halves(8)), builder.ashr(both, halves(8))]
        _store_pairs(builder, done, to, first_pair)
        return context.get_dummy_value()

    return types.void(sums, table, x, at), generate


_FOR_LOOPS: Any = {"error_model": "numpy", "no_cpython_wrapper": True, "no_cfunc_wrapper": True}
allocating: Callable[..., Any] = njit(**_FOR_LOOPS)
called: Callable[..., Any] = njit(**_FOR_LOOPS, **dict[str, Any](_nrt=False))
"""For functions that allocate nothing: they count no references, so they compile sooner."""


class Room(NamedTuple):
    """What a tile is on its way through the layers."""

    taken: Array  # int64, (elements, TILE)
    flags: Array  # uint8: an agent's planes
    filtered: Array  # int32: what filters find in them
    x: Array  # int32, (pairs, TILE)
    sums: Array  # int32, (outputs, TILE)
    all_x: Array  # int32: the same in one line, as are the next two; NumPy's reshape takes long in a loop
    all_sums: Array
    all_bytes: Array
    best: Array  # int32, (2, TILE): an action, and its logit
    rows: Array  # int64, (TILE,): rows of a table


@allocating
def _lines(rows: int) -> Array:
    """Return rows of a tile that begin where cache lines do."""
    room = np.zeros((rows + 1) * TILE, np.int32)
    skipped = -(room.ctypes.data >> 2) & 15
    return room[skipped : skipped + rows * TILE]


@allocating
def _room_for(net: Prepared) -> Room:
    """Return room for a tile."""
    pairs, outputs, planes = 1, 1, net.kind == PLANES
    for layer in range(len(net.layers)):
        outputs = max(outputs, net.layers[layer, OUTPUTS])
        pairs = max(pairs, net.layers[layer, PAIRS], outputs // 2)
    found = len(net.filter_bias) * (net.shape[0] - 2) * (net.shape[1] - 2) if planes else 0
    x, sums = _lines(pairs), _lines(outputs)
    return Room(
        np.zeros((net.width, 1 if planes else TILE), np.int64),
        np.zeros((net.width + 7) // 8 * 8 if planes else 0, np.uint8),
        np.zeros(found + (found & 1), np.int32),
        x.reshape((pairs, TILE)),
        sums.reshape((outputs, TILE)),
        x,
        sums,
        net.bytes.reshape(-1),
        np.zeros((2, TILE), np.int32),
        np.zeros(TILE, np.int64),
    )


@called
def _transpose(elements: Array, width: int, sign: int, first: int, n: int, taken: Array) -> None:
    # Of unsigned indices none counts from the end: a loop that has to look is not vectorised.
    for k in range(width):
        own = elements[first * width + k :]
        for s in range(n):
            word = np.int64(own[np.uint64(s) * np.uint64(width)])
            taken[k, s] = word - ((word & sign) << 1)


@called
def _take(net: Prepared, elements: Array, first: int, n: int, taken: Array) -> None:
    """Take the elements of some agents from their bytes."""
    if net.size == 1:
        _transpose(elements, net.width, net.sign, first, n, taken)
    elif net.size == 2:
        _transpose(elements.view(np.uint16), net.width, net.sign, first, n, taken)
    elif net.size == 4:
        _transpose(elements.view(np.uint32), net.width, net.sign, first, n, taken)
    else:
        _transpose(elements.view(np.int64), net.width, net.sign, first, n, taken)


@called
def _scale(net: Prepared, taken: Array, x: Array) -> None:
    """Put a tile's inputs in pairs."""
    count = len(net.offset)
    for k in range(count):
        offset, multiplier, shift, limit = net.offset[k], net.multiplier[k], net.input_shift[k], net.limit
        for s in range(TILE):
            scaled = (taken[k, s] - offset) * multiplier >> shift
            scaled = min(max(scaled, -limit), limit)
            if k & 1:
                x[k >> 1, s] |= np.int32(scaled) << np.int32(16)
            else:
                x[k >> 1, s] = np.int32(scaled) & np.int32(0xFFFF)


@called
def _see_planes(net: Prepared, elements: Array, first: int, n: int, room: Room) -> None:
    """Put what filters find in a tile's planes in pairs. Most elements are 0, and cost nothing."""
    rows, columns, planes = net.shape[0], net.shape[1], net.shape[2]
    high, wide, filters = rows - 2, columns - 2, len(net.filter_bias)
    shift, flags, filtered, weights = net.input_shift[0], room.flags, room.filtered, net.filters.reshape(-1)
    words = flags.view(np.uint64)
    for s in range(n):
        if net.size == 1:
            start = (first + s) * net.width
            for k in range(net.width):
                flags[k] = elements[np.uint64(start + k)]
        else:
            _take(net, elements, first + s, 1, room.taken)
            for k in range(net.width):
                flags[k] = room.taken[k, 0] != 0
        for at in range(high * wide):
            for f in range(filters):
                filtered[np.uint64(at * filters + f)] = net.filter_bias[f]
        for w in range(len(words)):
            if not words[w]:
                continue
            for k in range(w * 8, w * 8 + 8):
                if not flags[k]:
                    continue
                plane, row, column = k % planes, k // planes // columns, k // planes % columns
                left = max(0, column - 2)
                length = (min(wide - 1, column) - left + 1) * filters
                for i in range(max(0, row - high + 1), min(3, row + 1)):
                    at = ((row - i) * wide + left) * filters
                    of = ((plane * 3 + i) * 3 + 2 - column + left) * filters
                    for f in range(length):
                        filtered[np.uint64(at + f)] += weights[np.uint64(of + f)]
        for k in range(0, high * wide * filters, 2):
            low = min(max(filtered[k] >> shift, 0), net.limit)
            more = min(max(filtered[k + 1] >> shift, 0), net.limit)
            room.x[k >> 1, s] = np.int32(low) | np.int32(more) << np.int32(16)


@called
def _activate(net: Prepared, layer: int, room: Room) -> None:
    """Put what a layer's sums become in pairs."""
    x, sums = room.x, room.sums
    shift, outputs = np.int32(net.layers[layer, SHIFT]), net.layers[layer, OUTPUTS]
    how, flat, pairs = net.layers[layer, ACTIVATION], room.all_sums, room.all_x
    if how == BYTES:
        for j in range(0, outputs, 2):
            at = j * TILE, np.int64(shift), (j >> 1) * TILE, layer * ENTRIES
            _look_up(flat, room.all_bytes, pairs, at)
    elif how == TABLE:
        own = net.tables[layer]
        for j in range(0, outputs, 2):
            for s in range(TILE):
                low = own[min(max(sums[j, s] >> shift, np.int32(-HALF)), np.int32(HALF - 1)) + np.int32(HALF)]
                high = own[
                    min(max(sums[j + 1, s] >> shift, np.int32(-HALF)), np.int32(HALF - 1)) + np.int32(HALF)
                ]
                x[j >> 1, s] = (low & np.int32(0xFFFF)) | (high << np.int32(16))
    else:
        for j in range(0, outputs, 2):
            _cut(flat, pairs, (j * TILE, np.int64(shift), (j >> 1) * TILE, net.layers[layer, LIMIT]))


@called
def _find_rows(net: Prepared, choice: int, room: Room) -> None:
    """Find the row of the table that each agent of a tile chooses."""
    rows, taken = room.rows, room.taken
    for s in range(TILE):
        rows[s] = net.offset[choice]
    for e in range(net.width):
        factor = net.factors[choice, e]
        for s in range(TILE):
            rows[s] += factor * taken[e, s]


@called
def _pick(net: Prepared, first: int, n: int, room: Room, words: Array, logits: Array) -> None:
    """Choose the actions of a tile by its rows alone."""
    own = words[first : first + n]
    for k in range(words.shape[1]):
        for s in range(n):
            own[s, k] = net.picks[np.uint64(room.rows[s]), k]
    if len(logits):
        for s in range(n):
            for j in range(logits.shape[1]):
                logits[first + s, j] = net.table[room.rows[s], j] + net.bias[j]


@called
def _begin(net: Prepared, n: int, first_agent: int, room: Room) -> None:
    """Begin the first sums with biases, and with what rows of tables add to them."""
    sums = room.sums
    for j in range(net.layers[0, OUTPUTS]):
        for s in range(TILE):
            sums[j, s] = net.bias[j]
    if net.kind == LOOKED_UP:
        for k in range(len(net.offset)):
            _find_rows(net, k, room)
            for s in range(n):
                for j in range(net.table.shape[1]):
                    sums[j, s] += net.table[room.rows[s], j]
    agents = len(net.indicator)
    if agents:
        for s in range(n):
            for j in range(net.indicator.shape[1]):
                sums[j, s] += net.indicator[(first_agent + s) % agents, j]


@called
def _add_up(net: Prepared, elements: Array, first: int, n: int, room: Room) -> None:
    """Compute the last sums of the ``n`` agents from ``first`` on, at most :data:`TILE`."""
    if net.kind == PLANES:
        _see_planes(net, elements, first, n, room)
    else:
        _take(net, elements, first, n, room.taken)
    if net.kind == SCALED:
        _scale(net, room.taken, room.x)
    begun = net.kind == LOOKED_UP or len(net.indicator) > 0
    if begun:
        _begin(net, n, first, room)
    weight, bias = 0, 0
    for layer in range(len(net.layers)):
        pairs, outputs = net.layers[layer, PAIRS], net.layers[layer, OUTPUTS]
        for j in range(0, outputs, HIGH):
            at = (j * TILE, weight + j * pairs, pairs, bias + j, np.int64(begun))
            _add_products(room.all_sums, net.weights, room.all_x, net.bias, at)
        begun = False
        if layer + 1 < len(net.layers):
            _activate(net, layer, room)
        weight += pairs * outputs
        bias += outputs


@called
def _take_greatest(sums: Array, start: int, count: int, best: Array) -> None:
    """Find the greatest logit of each agent of a tile, the first of equals."""
    for s in range(TILE):
        best[0, s], best[1, s] = 0, sums[start, s]
    for j in range(1, count):
        for s in range(TILE):
            value = sums[start + j, s]
            best[0, s] = j if value > best[1, s] else best[0, s]
            best[1, s] = max(value, best[1, s])


@called
def _choose(
    net: Prepared, room: Room, first: int, n: int, masks: Array, draws: Array, words: Array, logits: Array
) -> None:
    """Choose the actions of a tile by its last sums; ``masks`` and ``logits`` may have no rows."""
    sums = room.sums
    if net.chooses == LEVELS:
        for k in range(net.level.shape[1]):
            for s in range(n):
                word = (np.int64(sums[k, s]) * net.level[0, k] + net.level[1, k]) >> net.level_shift
                words[first + s, k] = min(max(word, net.level[2, k]), net.level[3, k])
        return
    masked, start = len(masks) > 0, 0
    for field in range(len(net.counts)):
        count = net.counts[field]
        if not masked:
            _take_greatest(sums, start, count, room.best)
        for s in range(n):
            if masked:
                best, greatest, found = 0, np.int32(0), False
                for j in range(count):
                    allowed = masks[first + s, j] != 0
                    if allowed and (not found or sums[start + j, s] > greatest):
                        best, greatest, found = j, sums[start + j, s], True
            else:
                best, greatest, found = room.best[0, s], room.best[1, s], True
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


def _act(net, elements, masks, draws, words, logits):  # type: ignore[no-untyped-def]
    room = _room_for(net)
    for start in range(0, len(words), TILE):
        some = min(TILE, len(words) - start)
        if net.kind == PICKED:
            _take(net, elements, start, some, room.taken)
            _find_rows(net, 0, room)
            _pick(net, start, some, room, words, logits)
        else:
            _add_up(net, elements, start, some, room)
            _choose(net, room, start, some, masks, draws, words, logits)


compiled_act = compiled_loop(_act)
"""Return what chooses an action for each agent: ``act(net, elements, masks, draws, words, logits)``.

``elements`` are the bytes of the elements of ``n`` agents of whole worlds; ``masks``, ``int8`` of shape
``(n, n_actions)`` or of no rows; ``draws``, ``uint32`` of shape ``(n, net.draws)``. The words of actions are
written to ``words``, ``int64`` of shape ``(n, fields)``, and logits to ``logits``, ``int32`` of shape
``(n, outputs)`` or of no rows.
"""
