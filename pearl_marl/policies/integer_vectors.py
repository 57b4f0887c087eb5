"""Integer networks by the processor's own instructions: sums of products, and what becomes of them.

A *tile* has a row for each number of a layer and a column for each agent, of words of 32 bits. A word of
inputs is a group of them, which one instruction multiplies by as many weights and adds up: two numbers of 16
bits (*pairs*: ``pmaddwd`` of x86, ``smlal`` of ARM), or four of 8 bits (*quads*: ``vpdpbusd`` of AVX-512
VNNI), of which inputs have no sign.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from importlib import import_module
from typing import Any, TypeAlias

from llvmlite import ir
from numba import types
from numba.core.registry import cpu_target
from numba.extending import intrinsic

from pearl_marl.policies.integer_network import ENTRIES

TILE = 64
"""Agents that go through all layers at once."""

LANES, VECTORS, HIGH = 16, TILE // 16, 4
"""Words of a vector; vectors of a tile's row; outputs whose sums are kept in registers."""

HALF = ENTRIES // 2

_WORD, _INDEX = ir.IntType(32), ir.IntType(64)
_WORDS = ir.VectorType(_WORD, LANES)
_PAIRS, _BYTES = ir.VectorType(ir.IntType(16), 2 * LANES), ir.VectorType(ir.IntType(8), 4 * LANES)

_intrinsic: Any = intrinsic


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


def _constant(vector: Any, number: int) -> Any:
    return ir.Constant(vector, [number] * vector.count)


def _shuffled(builder: Any, vectors: Sequence[Any], order: list[int]) -> Any:
    """Return elements of two vectors, one after the other, in an order."""
    return builder.shuffle_vector(*vectors, ir.Constant(ir.VectorType(_WORD, len(order)), order))


def _spread(builder: Any, word: Any) -> Any:
    """Return a vector of the same word."""
    empty = ir.Constant(_WORDS, ir.Undefined)
    return _shuffled(builder, (builder.insert_element(empty, word, _WORD(0)), empty), [0] * LANES)


class _VectorCode:
    """The code of a function that is being made, with its arrays as pointers to their data."""

    def __init__(self, context: Any, builder: Any, kinds: Any, operands: Any) -> None:
        self.builder, self._numbers = builder, operands[1]
        self.arrays = [
            context.make_array(kind)(context, builder, builder.extract_value(operands[0], k)).data
            for k, kind in enumerate(kinds)
        ]

    def numbers(self) -> list[Any]:
        """Return the numbers that the function is called with."""
        return [self.builder.extract_value(self._numbers, k) for k in range(len(self._numbers.type))]

    def spread(self, number: int) -> Any:
        """Return a vector of one of these numbers."""
        return _spread(self.builder, self.builder.trunc(self.numbers()[number], _WORD))

    def plus(self, index: Any, more: int) -> Any:
        """Return an index so many elements further."""
        return self.builder.add(index, _INDEX(more))

    def word(self, row: Any, v: int) -> Any:
        """Return the index of a vector in a row of a tile."""
        return self.plus(self.builder.mul(row, _INDEX(TILE)), v * LANES)

    def load(self, array: Any, index: Any, kind: Any = _WORDS) -> Any:
        """Load a vector, or an element, from an index of an array."""
        place = self.builder.bitcast(self.builder.gep(array, [index]), kind.as_pointer())
        return self.builder.load(place, align=1)

    def store(self, value: Any, array: Any, index: Any) -> None:
        """Store a vector, or an element, at an index of an array."""
        place = self.builder.bitcast(self.builder.gep(array, [index]), value.type.as_pointer())
        self.builder.store(value, place, align=1)

    def variable(self, kind: Any) -> Any:
        """Return a variable; LLVM keeps it in a register."""
        return import_module("numba.core.cgutils").alloca_once(self.builder, kind)

    @contextmanager
    def each(self, count: Any, step: int = 1) -> Iterator[Any]:
        """Make a loop of what is made in this context, with an index from 0 on."""
        slices = import_module("numba.core.cgutils").for_range_slice
        with slices(self.builder, _INDEX(0), count, _INDEX(step), _INDEX) as (index, _):
            yield index


def _made(write: Callable[[_VectorCode], None]) -> Any:
    """Return a function of a tuple of arrays and a tuple of numbers, whose code ``write`` makes."""

    @_intrinsic  # type: ignore[untyped-decorator]
    def function(_: Any, arrays: Any, numbers: Any) -> Any:
        def generate(context: Any, builder: Any, signature: Any, operands: Any) -> Any:
            write(_VectorCode(context, builder, tuple(signature.args[0]), operands))
            return context.get_dummy_value()

        return types.void(arrays, numbers), generate

    return function


def _plus_pairs(builder: Any, total: Any, inputs: Any, weights: Any) -> Any:
    """Add products of pairs to vectors of sums."""
    if "+avx512vnni" in _features():
        return _call(builder, "llvm.x86.avx512.vpdpwssd.512", _WORDS, total, inputs, weights)
    inputs, weights = (builder.bitcast(words, _PAIRS) for words in (inputs, weights))
    if "+avx512bw" in _features():
        return builder.add(total, _call(builder, "llvm.x86.avx512.pmaddw.d.512", _WORDS, inputs, weights))
    if "+avx2" in _features():
        halves = []
        for first in (0, LANES):
            own = [
                _shuffled(builder, (pairs, pairs), list(range(first, first + LANES)))
                for pairs in (inputs, weights)
            ]
            halves.append(_call(builder, "llvm.x86.avx2.pmadd.wd", ir.VectorType(_WORD, LANES // 2), *own))
        return builder.add(total, _shuffled(builder, halves, list(range(LANES))))
    for first in (0, 1):
        every_other = list(range(first, 2 * LANES, 2))
        own = [
            builder.sext(_shuffled(builder, (pairs, pairs), every_other), _WORDS)
            for pairs in (inputs, weights)
        ]
        total = builder.add(total, builder.mul(*own))
    return total


def _plus_quads(builder: Any, total: Any, inputs: Any, weights: Any) -> Any:
    """Add products of quads to vectors of sums."""
    return _call(builder, "llvm.x86.avx512.vpdpbusd.512", _WORDS, total, inputs, weights)


Finish: TypeAlias = Callable[[Any, int, list[list[Any]]], None]
"""What is done with the sums of :data:`HIGH` outputs: called with the first of them, the number of the first
vector of a row, and vectors of each."""


def _layer(plus: Callable[..., Any], begin: Callable[[_VectorCode], Finish]) -> Any:
    """Return a function that makes a layer's sums by ``plus``, and does with them what ``begin`` returns."""
    needs_quads = plus is _plus_quads or begin in (_cut_to_quads, _look_up)

    def write(code: _VectorCode) -> None:
        if (needs_quads and not takes_quads()) or (begin is _gather and not takes_gathers()):
            return
        builder, (inputs, _, sums, weights, biases, *_) = code.builder, code.arrays
        first_weight, groups, first_bias, outputs, adds, *_ = code.numbers()
        finish = begin(code)
        # Sums, and inputs of a group, have to fit the registers: AVX2 has half as many, of half the size.
        width = VECTORS if "+avx512f" in _features() else 1

        def add_up(first: Any, v: int) -> None:
            rows = [code.plus(first, row) for row in range(HIGH)]
            totals = [[code.variable(_WORDS) for _ in range(width)] for _ in rows]
            with builder.if_else(builder.trunc(adds, ir.IntType(1))) as (there, biased):
                with there:
                    for row, own in zip(rows, totals, strict=True):
                        for k, total in enumerate(own):
                            builder.store(code.load(sums, code.word(row, v + k)), total)
                with biased:
                    for row, own in zip(rows, totals, strict=True):
                        bias = code.load(biases, builder.add(first_bias, row), _WORD)
                        for total in own:
                            builder.store(_spread(builder, bias), total)
            starts = [builder.add(first_weight, builder.mul(groups, row)) for row in rows]
            with code.each(groups) as group:
                some = [code.load(inputs, code.word(group, v + k)) for k in range(width)]
                for own, start in zip(totals, starts, strict=True):
                    factor = _spread(builder, code.load(weights, builder.add(start, group), _WORD))
                    for total, vector in zip(own, some, strict=True):
                        builder.store(plus(builder, builder.load(total), vector, factor), total)
            finish(first, v, [[builder.load(total) for total in own] for own in totals])

        with code.each(outputs, HIGH) as first:
            for v in range(0, VECTORS, width):
                add_up(first, v)

    return _made(write)


def _keep(code: _VectorCode) -> Finish:
    """Store sums as they are."""

    def finish(first: Any, v: int, totals: list[list[Any]]) -> None:
        for row, own in enumerate(totals):
            for k, total in enumerate(own):
                code.store(total, code.arrays[2], code.word(code.plus(first, row), v + k))

    return finish


def _within(builder: Any, vector: Any, low: Any, high: Any) -> Any:
    """Return a vector of integers with a sign, cut at both ends."""
    for order, end in (("<", low), (">", high)):
        vector = builder.select(builder.icmp_signed(order, vector, end), end, vector)
    return vector


def _to_pairs(code: _VectorCode, make: Callable[[Any], Any]) -> Finish:
    """Shift sums, have words of 16 bits made of them, and pairs of these."""
    builder, shift = code.builder, code.spread(5)

    def finish(first: Any, v: int, totals: list[list[Any]]) -> None:
        for k in range(len(totals[0])):
            words = [make(builder.ashr(own[k], shift)) for own in totals]
            for row in range(0, HIGH, 2):
                low = builder.and_(words[row], _constant(_WORDS, 0xFFFF))
                pair = builder.or_(low, builder.shl(words[row + 1], _constant(_WORDS, 16)))
                group = builder.sdiv(code.plus(first, row), _INDEX(2))
                code.store(pair, code.arrays[1], code.word(group, v + k))

    return finish


def _cut_to_pairs(code: _VectorCode) -> Finish:
    """Cut sums at 0 and a limit of 16 bits."""
    limit = code.spread(6)
    return _to_pairs(code, lambda word: _within(code.builder, word, _constant(_WORDS, 0), limit))


def _gather(code: _VectorCode) -> Finish:
    """Look up what sums become in a table of words."""
    builder, half, pointer = code.builder, ir.VectorType(_WORD, LANES // 2), ir.IntType(8).as_pointer()
    zero = code.plus(code.numbers()[6], HALF)  # the entry of 0
    table = builder.bitcast(builder.gep(code.arrays[6], [zero]), pointer)
    every, size = _constant(half, -1), ir.Constant(ir.IntType(8), 4)

    def look_up(word: Any) -> Any:
        word = _within(builder, word, _constant(_WORDS, -HALF), _constant(_WORDS, HALF - 1))
        found = []
        for first in (0, LANES // 2):
            entries = _shuffled(builder, (word, word), list(range(first, first + LANES // 2)))
            name = "llvm.x86.avx2.gather.d.d.256"
            found.append(_call(builder, name, half, _constant(half, 0), table, entries, every, size))
        return _shuffled(builder, found, list(range(LANES)))

    return _to_pairs(code, look_up)


def _to_quads(code: _VectorCode, low: int, high: Any, make: Callable[[list[list[Any]]], list[Any]]) -> Finish:
    """Shift sums, cut them at both ends, and make quads of them.

    ``make`` gets two vectors of 16-bit words for each vector of quads: four agents' of one output and four of
    the next, in turns.
    """
    builder, shift = code.builder, code.spread(5)
    pack = "llvm.x86.avx512.packssdw.512"  # which cuts at the ends of 16 bits

    def finish(first: Any, v: int, totals: list[list[Any]]) -> None:
        halves = []
        for k in range(len(totals[0])):
            words = [builder.ashr(own[k], shift) for own in totals]
            packed = [_call(builder, pack, _PAIRS, *words[row : row + 2]) for row in (0, 2)]
            halves.append([_within(builder, half, _constant(_PAIRS, low), high) for half in packed])
        group = builder.sdiv(first, _INDEX(HIGH))
        for k, quads in enumerate(make(halves)):
            code.store(quads, code.arrays[1], code.word(group, v + k))

    return finish


def _cut_to_quads(code: _VectorCode) -> Finish:
    """Cut sums at 0 and a limit of 8 bits."""
    builder, limit = code.builder, code.spread(6)
    limit = builder.bitcast(builder.or_(limit, builder.shl(limit, _constant(_WORDS, 16))), _PAIRS)
    order = [16 * lane + 4 * row + k for lane in range(4) for k in range(4) for row in range(HIGH)]

    def make(halves: list[list[Any]]) -> list[Any]:
        packed = [_call(builder, "llvm.x86.avx512.packuswb.512", _BYTES, *own) for own in halves]
        return [_shuffled(builder, (quads, quads), order) for quads in packed]

    return _to_quads(code, 0, limit, make)


def _look_up(code: _VectorCode) -> Finish:
    """Look up what sums become in a table of bytes, the entry of 0 first."""
    builder, table = code.builder, code.numbers()[6]
    places = [(row, lane, k) for lane in range(4) for k in range(4) for row in range(HIGH)]
    order = [64 * (row >> 1) + 16 * lane + 8 * (row & 1) + 2 * k for row, lane, k in places]

    def make(halves: list[list[Any]]) -> list[Any]:
        # The instruction takes the lowest 7 bits of an index. The other 3 choose among 8 results.
        lower = [_shuffled(builder, [builder.bitcast(half, _BYTES) for half in own], order) for own in halves]
        doubled = [
            [builder.bitcast(builder.shl(half, _constant(_PAIRS, 1)), _BYTES) for half in own]
            for own in halves
        ]
        upper = [_shuffled(builder, own, [k + 1 for k in order]) for own in doubled]

        def found(first: int, bits: int) -> list[Any]:
            """Look up what has its entry among those from the ``first`` on that so many bits can count."""
            if bits < 0:
                ends = [
                    code.load(code.arrays[5], code.plus(table, first + k), _BYTES) for k in (0, 4 * LANES)
                ]
                name = "llvm.x86.avx512.vpermi2var.qi.512"
                return [_call(builder, name, _BYTES, ends[0], low, ends[1]) for low in lower]
            left, right = found(first, bits - 1), found(first + (8 * LANES << bits), bits - 1)
            results = []
            for high, a, b in zip(upper, left, right, strict=True):
                flag = builder.and_(high, _constant(_BYTES, 1 << bits))
                chosen = builder.icmp_unsigned("!=", flag, _constant(_BYTES, 0))
                results.append(builder.select(chosen, b, a))
            return results

        return found(0, 2)

    return _to_quads(code, -HALF, _constant(_PAIRS, HALF - 1), make)


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


def _write_take(code: _VectorCode) -> None:
    builder, (elements, taken), (first, n, width, size, signed, row) = (
        code.builder,
        code.arrays,
        code.numbers(),
    )
    own = builder.gep(elements, [builder.mul(builder.mul(first, width), size)])
    signed = builder.trunc(signed, ir.IntType(1))
    for bits in (8, 16, 32, 64):
        kind = ir.IntType(bits)
        words, this_size = (
            builder.bitcast(own, kind.as_pointer()),
            builder.icmp_signed("==", size, _INDEX(bits // 8)),
        )
        for has_sign, extend in ((signed, builder.sext), (builder.not_(signed), builder.zext)):
            with builder.if_then(builder.and_(this_size, has_sign)), code.each(width) as k, code.each(n) as s:
                word = code.load(words, builder.add(builder.mul(s, width), k), kind)
                code.store(extend(word, _INDEX), taken, builder.add(builder.mul(k, row), s))


take = _made(_write_take)
"""Take the elements of some agents from their bytes, a row an element.

Called with ``(elements, taken)``, and with the first agent, how many there are, the elements of each, the
bytes of an element, 1 where it has a sign, and the length of a row.
"""


def _write_greatest(code: _VectorCode) -> None:
    builder, (sums, best, greatest), (start, count) = code.builder, code.arrays, code.numbers()
    for v in range(VECTORS):
        chosen, most = code.variable(_WORDS), code.variable(_WORDS)
        builder.store(_constant(_WORDS, 0), chosen)
        builder.store(code.load(sums, code.word(start, v)), most)
        with code.each(count) as k:
            value, before = code.load(sums, code.word(builder.add(start, k), v)), builder.load(most)
            more = builder.icmp_signed(">", value, before)
            number = _spread(builder, builder.trunc(k, _WORD))
            builder.store(builder.select(more, number, builder.load(chosen)), chosen)
            builder.store(builder.select(more, value, before), most)
        for variable, array in ((chosen, best), (most, greatest)):
            code.store(builder.load(variable), array, _INDEX(v * LANES))


take_greatest = _made(_write_greatest)
"""Find the greatest sum of each agent of a tile in some rows, the first of equals.

Called with ``(sums, best, greatest)``, which become its row and the sum, and with the first row and how many
there are.
"""
