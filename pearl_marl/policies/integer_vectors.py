"""Integer networks by the processor's own instructions: sums of products, and what becomes of them.

A *tile* has a row for each number of a layer and a column for each agent, of words of 32 bits. A word of
inputs is a group of them, which one instruction multiplies by as many weights and adds up: two numbers of 16
bits (*pairs*: ``pmaddwd`` of x86, ``smlal`` of ARM), or four of 8 bits (*quads*: ``vpdpbusd`` of AVX-512
VNNI), of which inputs have no sign.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, TypeAlias

from llvmlite import ir
from numba.core.registry import cpu_target

from pearl_marl.compiler.vector_code import INDEX, LANES, WORD, VectorCode, constant, function_of
from pearl_marl.policies.integer_network import HALF

TILE = 64
"""Agents that go through all layers at once."""

VECTORS, HIGH = TILE // LANES, 4
"""Vectors of a tile's row; outputs whose sums are kept in registers."""

_WORDS = ir.VectorType(WORD, LANES)
_PAIRS, _BYTES = ir.VectorType(ir.IntType(16), 2 * LANES), ir.VectorType(ir.IntType(8), 4 * LANES)


@functools.cache
def _features() -> frozenset[str]:
    """Return what the processor can do that Numba compiles for."""
    _, _, features = cpu_target.target_context.codegen().magic_tuple()
    return frozenset(features.split(","))


def takes_quads() -> bool:
    """Return whether the processor multiplies quads, and looks up 64 bytes at once in a table of 128."""
    return {"+avx512bw", "+avx512vbmi", "+avx512vnni"} <= _features()


def takes_gathers() -> bool:
    """Return whether the processor looks up the words of a vector in a table."""
    return "+avx2" in _features()


def _call(builder: Any, name: str, result: Any, *operands: Any) -> Any:
    """Call an instruction of the processor by LLVM's name for it."""
    kind = ir.FunctionType(result, [operand.type for operand in operands])
    function = builder.module.globals.get(name) or ir.Function(builder.module, kind, name)
    return builder.call(function, operands)


def _spread(code: VectorCode, number: Any) -> Any:
    """Return a vector of words that are all the same number of 64 bits."""
    return code.spread(code.builder.trunc(number, WORD))


def _word(code: VectorCode, row: Any, v: int) -> Any:
    """Return the index of a vector in a row of a tile."""
    return code.plus(code.times(row, TILE), v * LANES)


def _plus_pairs(code: VectorCode, total: Any, inputs: Any, weights: Any) -> Any:
    """Add products of pairs to vectors of sums."""
    builder = code.builder
    if "+avx512vnni" in _features():
        return _call(builder, "llvm.x86.avx512.vpdpwssd.512", _WORDS, total, inputs, weights)
    inputs, weights = (builder.bitcast(words, _PAIRS) for words in (inputs, weights))
    if "+avx512bw" in _features():
        return builder.add(total, _call(builder, "llvm.x86.avx512.pmaddw.d.512", _WORDS, inputs, weights))
    if "+avx2" in _features():
        halves = []
        for first in (0, LANES):
            own = [
                code.shuffled((pairs, pairs), list(range(first, first + LANES)))
                for pairs in (inputs, weights)
            ]
            halves.append(_call(builder, "llvm.x86.avx2.pmadd.wd", ir.VectorType(WORD, LANES // 2), *own))
        return builder.add(total, code.shuffled(halves, list(range(LANES))))
    for first in (0, 1):
        every_other = list(range(first, 2 * LANES, 2))
        own = [
            builder.sext(code.shuffled((pairs, pairs), every_other), _WORDS) for pairs in (inputs, weights)
        ]
        total = builder.add(total, builder.mul(*own))
    return total


def _plus_quads(code: VectorCode, total: Any, inputs: Any, weights: Any) -> Any:
    """Add products of quads to vectors of sums."""
    return _call(code.builder, "llvm.x86.avx512.vpdpbusd.512", _WORDS, total, inputs, weights)


Finish: TypeAlias = Callable[[Any, int, list[list[Any]]], None]
"""What is done with the sums of :data:`HIGH` outputs: called with the first of them, the number of the first
vector of a row, and vectors of each."""


def _layer(plus: Callable[..., Any], begin: Callable[[VectorCode], Finish]) -> Any:
    """Return a function that makes a layer's sums by ``plus``, and does with them what ``begin`` returns."""
    needs_quads = plus is _plus_quads or begin in (_cut_to_quads, _look_up)

    @function_of
    def layer(code: VectorCode, arrays: Any, numbers: Any) -> None:
        if (needs_quads and not takes_quads()) or (begin is _gather and not takes_gathers()):
            return
        builder, (inputs, _, sums, weights, biases, *_) = code.builder, arrays
        first_weight, groups, first_bias, outputs, adds, *_ = numbers
        finish = begin(code)
        # Sums, and inputs of a group, have to fit the registers: AVX2 has half as many, of half the size.
        width = VECTORS if "+avx512f" in _features() else 1

        def add_up(first: Any, v: int) -> None:
            rows = [code.plus(first, row) for row in range(HIGH)]
            totals = [[code.variable(constant(_WORDS, 0)) for _ in range(width)] for _ in rows]
            with builder.if_else(builder.trunc(adds, ir.IntType(1))) as (there, biased):
                with there:
                    for row, own in zip(rows, totals, strict=True):
                        for k, total in enumerate(own):
                            builder.store(code.load(sums, _word(code, row, v + k)), total)
                with biased:
                    for row, own in zip(rows, totals, strict=True):
                        bias = code.factor(biases, builder.add(first_bias, row))
                        for total in own:
                            builder.store(bias, total)
            starts = [builder.add(first_weight, builder.mul(groups, row)) for row in rows]
            with code.each(groups) as group:
                some = [code.load(inputs, _word(code, group, v + k)) for k in range(width)]
                for own, start in zip(totals, starts, strict=True):
                    factor = code.factor(weights, builder.add(start, group))
                    for total, vector in zip(own, some, strict=True):
                        builder.store(plus(code, builder.load(total), vector, factor), total)
            finish(first, v, [[builder.load(total) for total in own] for own in totals])

        with code.each(outputs, HIGH) as first:
            for v in range(0, VECTORS, width):
                add_up(first, v)

    return layer


def _keep(code: VectorCode) -> Finish:
    """Store sums as they are."""

    def finish(first: Any, v: int, totals: list[list[Any]]) -> None:
        for row, own in enumerate(totals):
            for k, total in enumerate(own):
                code.store(total, code.operands[0][2], _word(code, code.plus(first, row), v + k))

    return finish


def _within(builder: Any, vector: Any, low: Any, high: Any) -> Any:
    """Return a vector of integers with a sign, cut at both ends."""
    for order, end in (("<", low), (">", high)):
        vector = builder.select(builder.icmp_signed(order, vector, end), end, vector)
    return vector


def _to_pairs(code: VectorCode, make: Callable[[Any], Any]) -> Finish:
    """Shift sums, have words of 16 bits made of them, and pairs of these."""
    builder, ((_, made, *_), numbers) = code.builder, code.operands
    shift = _spread(code, numbers[5])

    def finish(first: Any, v: int, totals: list[list[Any]]) -> None:
        for k in range(len(totals[0])):
            words = [make(builder.ashr(own[k], shift)) for own in totals]
            for row in range(0, HIGH, 2):
                low = builder.and_(words[row], constant(_WORDS, 0xFFFF))
                pair = builder.or_(low, builder.shl(words[row + 1], constant(_WORDS, 16)))
                group = builder.sdiv(code.plus(first, row), INDEX(2))
                code.store(pair, made, _word(code, group, v + k))

    return finish


def _cut_to_pairs(code: VectorCode) -> Finish:
    """Cut sums at 0 and a limit of 16 bits."""
    limit = _spread(code, code.operands[1][6])
    return _to_pairs(code, lambda word: _within(code.builder, word, constant(_WORDS, 0), limit))


def _gather(code: VectorCode) -> Finish:
    """Look up what sums become in a table of words."""
    builder, half, pointer = code.builder, ir.VectorType(WORD, LANES // 2), ir.IntType(8).as_pointer()
    arrays, numbers = code.operands
    zero = code.plus(numbers[6], HALF)  # the entry of 0
    table = builder.bitcast(builder.gep(arrays[6], [zero]), pointer)
    every, size = constant(half, -1), ir.Constant(ir.IntType(8), 4)

    def look_up(word: Any) -> Any:
        word = _within(builder, word, constant(_WORDS, -HALF), constant(_WORDS, HALF - 1))
        found = []
        for first in (0, LANES // 2):
            entries = code.shuffled((word, word), list(range(first, first + LANES // 2)))
            name = "llvm.x86.avx2.gather.d.d.256"
            found.append(_call(builder, name, half, constant(half, 0), table, entries, every, size))
        return code.shuffled(found, list(range(LANES)))

    return _to_pairs(code, look_up)


def _to_quads(code: VectorCode, low: int, high: Any, make: Callable[[list[list[Any]]], list[Any]]) -> Finish:
    """Shift sums, cut them at both ends, and make quads of them.

    ``make`` gets two vectors of 16-bit words for each vector of quads: four agents' of one output and four of
    the next, in turns.
    """
    builder, ((_, made, *_), numbers) = code.builder, code.operands
    shift = _spread(code, numbers[5])
    pack = "llvm.x86.avx512.packssdw.512"  # which cuts at the ends of 16 bits

    def finish(first: Any, v: int, totals: list[list[Any]]) -> None:
        halves = []
        for k in range(len(totals[0])):
            words = [builder.ashr(own[k], shift) for own in totals]
            packed = [_call(builder, pack, _PAIRS, *words[row : row + 2]) for row in (0, 2)]
            halves.append([_within(builder, half, constant(_PAIRS, low), high) for half in packed])
        group = builder.sdiv(first, INDEX(HIGH))
        for k, quads in enumerate(make(halves)):
            code.store(quads, made, _word(code, group, v + k))

    return finish


def _cut_to_quads(code: VectorCode) -> Finish:
    """Cut sums at 0 and a limit of 8 bits."""
    builder, limit = code.builder, _spread(code, code.operands[1][6])
    limit = builder.bitcast(builder.or_(limit, builder.shl(limit, constant(_WORDS, 16))), _PAIRS)
    order = [16 * lane + 4 * row + k for lane in range(4) for k in range(4) for row in range(HIGH)]

    def make(halves: list[list[Any]]) -> list[Any]:
        packed = [_call(builder, "llvm.x86.avx512.packuswb.512", _BYTES, *own) for own in halves]
        return [code.shuffled((quads, quads), order) for quads in packed]

    return _to_quads(code, 0, limit, make)


def _look_up(code: VectorCode) -> Finish:
    """Look up what sums become in a table of bytes, the entry of 0 first."""
    builder, ((*_, table, _), (*_, start)) = code.builder, code.operands
    places = [(row, lane, k) for lane in range(4) for k in range(4) for row in range(HIGH)]
    order = [64 * (row >> 1) + 16 * lane + 8 * (row & 1) + 2 * k for row, lane, k in places]

    def make(halves: list[list[Any]]) -> list[Any]:
        # The instruction takes the lowest 7 bits of an index. The other 3 choose among 8 results.
        lower = [code.shuffled([builder.bitcast(half, _BYTES) for half in own], order) for own in halves]
        doubled = [
            [builder.bitcast(builder.shl(half, constant(_PAIRS, 1)), _BYTES) for half in own]
            for own in halves
        ]
        upper = [code.shuffled(own, [k + 1 for k in order]) for own in doubled]

        def found(first: int, bits: int) -> list[Any]:
            """Look up what has its entry among those from the ``first`` on that so many bits can count."""
            if bits < 0:
                ends = [code.load(table, code.plus(start, first + k), _BYTES) for k in (0, 4 * LANES)]
                name = "llvm.x86.avx512.vpermi2var.qi.512"
                return [_call(builder, name, _BYTES, ends[0], low, ends[1]) for low in lower]
            left, right = found(first, bits - 1), found(first + (8 * LANES << bits), bits - 1)
            results = []
            for high, a, b in zip(upper, left, right, strict=True):
                flag = builder.and_(high, constant(_BYTES, 1 << bits))
                chosen = builder.icmp_unsigned("!=", flag, constant(_BYTES, 0))
                results.append(builder.select(chosen, b, a))
            return results

        return found(0, 2)

    return _to_quads(code, -HALF, constant(_PAIRS, HALF - 1), make)


pairs_to_sums, quads_to_sums = _layer(_plus_pairs, _keep), _layer(_plus_quads, _keep)
pairs_to_pairs, pairs_gathered = _layer(_plus_pairs, _cut_to_pairs), _layer(_plus_pairs, _gather)
quads_to_quads = _layer(_plus_quads, _cut_to_quads)
pairs_looked_up, quads_looked_up = _layer(_plus_pairs, _look_up), _layer(_plus_quads, _look_up)
"""Do a layer of a tile: sums of biases and products, and what becomes of them.

Called with ``(inputs, made, sums, weights, biases, bytes, words)``, where ``made`` are the groups that are
made of sums, and the last two are tables; and with numbers: the first of the weights, the groups of inputs,
the first of the biases, how many outputs there are, a multiple of :data:`HIGH`, 1 where the products are
added to the sums that are there instead of to biases, the shift, and the limit or the first entry of the
table.
"""


@function_of
def take(code: VectorCode, arrays: Any, numbers: Any) -> None:
    """Take the elements of some agents from their bytes, a row an element.

    Called with ``(elements, taken)``, and with the first agent, how many there are, the elements of each, the
    bytes of an element, 1 where it has a sign, and the length of a row.
    """
    builder, (elements, taken), (first, n, width, size, signed, row) = code.builder, arrays, numbers
    own = builder.gep(elements, [builder.mul(builder.mul(first, width), size)])
    signed = builder.trunc(signed, ir.IntType(1))
    for bits in (8, 16, 32, 64):
        kind = ir.IntType(bits)
        this_size = builder.icmp_signed("==", size, INDEX(bits // 8))
        for has_sign, extend in ((signed, builder.sext), (builder.not_(signed), builder.zext)):
            with builder.if_then(builder.and_(this_size, has_sign)), code.each(width) as k, code.each(n) as s:
                word = code.load(own, builder.mul(builder.add(builder.mul(s, width), k), size), kind)
                code.store(extend(word, INDEX), taken, builder.add(builder.mul(k, row), s))


@function_of
def take_greatest(code: VectorCode, arrays: Any, numbers: Any) -> None:
    """Find the greatest sum of each agent of a tile in some rows, the first of equals.

    Called with ``(sums, best, greatest)``, which become its row and the sum, and with the first row and how
    many there are.
    """
    builder, (sums, best, greatest), (start, count) = code.builder, arrays, numbers
    for v in range(VECTORS):
        chosen = code.variable(constant(_WORDS, 0))
        most = code.variable(code.load(sums, _word(code, start, v)))
        with code.each(count) as k:
            value = code.load(sums, _word(code, builder.add(start, k), v))
            before = builder.load(most)
            more = builder.icmp_signed(">", value, before)
            builder.store(builder.select(more, _spread(code, k), builder.load(chosen)), chosen)
            builder.store(builder.select(more, value, before), most)
        for variable, array in ((chosen, best), (most, greatest)):
            code.store(builder.load(variable), array, INDEX(v * LANES))
