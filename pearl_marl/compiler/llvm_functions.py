"""Functions of kernels that are written straight into the kernel that calls them, as LLVM's instructions.

A function has no branches, so it can be run once on words that write down what is done to them. Its loops are
written once, too: ``range`` gives the index as a word, and what lasts from turn to turn is in memory.
Numba takes many times as long for such a function, since it finds out types, owners and errors for each
line, and has LLVM optimize it by itself before it does so where it is called.
"""

from __future__ import annotations

import dis
import inspect
import itertools
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial
from types import SimpleNamespace
from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils as _cgutils
from numba.extending import intrinsic

from pearl_marl import object_code
from pearl_marl.compiler.llvm_loops import Writer
from pearl_marl.compiler.llvm_words import (
    ARITHMETIC,
    BYTES,
    COMPARISONS,
    FLOATS,
    INTEGERS,
    NUMBERS,
    Maker,
    arrays,
)
from pearl_marl.remaking import remade

cgutils: Any = _cgutils
"""Numba's, which has no types."""

LINE = 64
"""Bytes of a cache line."""

LONG = 200
"""Instructions from which on a function is compiled by itself: its work takes far longer than a call."""

FAILED = ir.IntType(8)
"""What such a function returns: 1 where there is no memory left, and else 0."""

_Tuple: Any = types.Tuple


class Word:
    """A word of a function that is being written: LLVM's value, and Numba's type.

    ``again`` makes the value again where a loop has been cut; it returns None if that is not possible. Where
    there is none, the value is kept. What ``loads`` is counted when somebody uses it.
    """

    def __init__(
        self,
        builder: Writer,
        value: Any,
        type_: Any,
        again: Callable[[], Any] | None = None,
        loads: bool = False,
    ) -> None:
        self.builder, self.type = builder, type_
        self._value, self._again, self._uncounted = value, again, loads
        self._loop = builder.loops[-1] if builder.loops else None
        self._part = self._loop.part if self._loop else 0
        self._kept: int | None = None
        self.counts = False
        """Whether it is a loop's index itself."""

    @property
    def value(self) -> Any:
        """LLVM's value, in the part of a loop that is being written."""
        value = self.uncounted()
        if self._uncounted and self._loop is not None:
            self._loop.accesses += 1
            self._uncounted = False
        return value

    def uncounted(self) -> Any:
        """Return the value for a cast, which does not count what it loads."""
        loop = self._loop
        if loop is not None and self._part < loop.part and not isinstance(self._value, ir.Constant):
            value = None if self._again is None else self._again()
            if value is None:
                if self._kept is None:
                    self._kept = loop.keep(self._value, self._part)
                value = loop.kept(self._kept, self._value.type)
            if loop is not self.builder.loops[-1]:  # within another loop: that value is not there behind it
                return value
            self._value, self._part = value, loop.part
        return self._value

    def __bool__(self) -> bool:
        raise TypeError("there are no branches in functions that are inlined")

    def to(self, type_: Any) -> Word:
        """Return the word in another type."""
        if type_ == self.type:
            return self
        if self._again is None:
            return Word(self.builder, self._as(type_, self.value), type_)

        def again() -> Any:
            return self._as(type_, self.value)

        return Word(self.builder, self._as(type_, self.uncounted()), type_, again, self._uncounted)

    def _as(self, type_: Any, value: Any) -> Any:
        own, bits, to = self.type, type_.bitwidth, _llvm(type_)
        if type_ in FLOATS:
            return (self.builder.sitofp if own.signed else self.builder.uitofp)(value, to)
        if bits < own.bitwidth:
            return self.builder.trunc(value, to)
        if bits > own.bitwidth:
            return (self.builder.sext if own.signed else self.builder.zext)(value, to)
        return value

    def _with(self, name: str, other: Word | int) -> Word:
        self.builder.count(operations=1)
        if isinstance(other, int):
            other = Word(self.builder, _llvm(self.type)(other), self.type)
        assert self.type == other.type, "whoever uses operators casts both words"
        if self.type in FLOATS:
            assert name == "mul"
            return Word(self.builder, self.builder.fmul(self.value, other.value), self.type)
        value = ARITHMETIC[name](self.builder, self.type.signed, self.value, other.value)
        return Word(self.builder, value, self.type)

    def __add__(self, other: Word | int) -> Word:
        return self._with("add", other)

    def __mul__(self, other: Word | int) -> Word:
        return self._with("mul", other)

    __rmul__ = __mul__

    def __and__(self, other: Word | int) -> Word:
        return self._with("and", other)

    def __xor__(self, other: Word | int) -> Word:
        return self._with("xor", other)

    def __rshift__(self, other: Word | int) -> Word:
        return self._with("right", other)

    def __floordiv__(self, other: Word | int) -> Word:
        return self._with("divide", other)

    def __mod__(self, other: Word | int) -> Word:
        return self._with("modulo", other)


class Column:
    """Words side by side in memory, of a function that is being written: LLVM's address of the first."""

    def __init__(self, builder: Any, first: Any, type_: Any) -> None:
        self.builder, self.first, self.type = builder, first, type_
        self._stores = 0

    @classmethod
    def of(cls, builder: Any, table: Any) -> Column:
        """Return a table of constants."""
        type_ = getattr(types, str(table.dtype))
        word = _llvm(type_)
        constant = ir.Constant(ir.ArrayType(word, len(table)), [word(int(entry)) for entry in table])
        place = ir.GlobalVariable(builder.module, constant.type, builder.module.get_unique_name("table"))
        place.global_constant, place.linkage, place.initializer = True, "internal", constant
        return cls(builder, builder.bitcast(place, word.as_pointer()), type_)

    def __getitem__(self, index: Word | int) -> Word:
        stores = self._stores

        def again() -> Any:
            return self.builder.load(self.at(index)) if stores == self._stores else None

        return Word(self.builder, self.builder.load(self.at(index)), self.type, again, loads=True)

    def __setitem__(self, index: Word | int, word: Word | int) -> None:
        place = self.written(index)
        value = word.to(self.type).value if isinstance(word, Word) else _llvm(self.type)(word)
        self.builder.store(value, place)

    def written(self, index: Word | int) -> Any:
        """Return the address of words that are written next."""
        scattered = isinstance(index, Word) and not index.counts
        self.builder.count(accesses=1, scattered=scattered)
        self._stores += 1
        return self.at(index)

    def at(self, index: Word | int) -> Any:
        """Return the address of a word."""
        return self.builder.gep(self.first, [_number(index)])

    def from_byte(self, type_: Any, start: Word | int, index: Word | int) -> Column:
        """Return words of a type, from the one that is ``index`` words behind byte ``start``."""
        byte = self.builder.gep(self.builder.bitcast(self.first, BYTES), [_number(start)])
        first = self.builder.bitcast(byte, _llvm(type_).as_pointer())
        return Column(self.builder, self.builder.gep(first, [_number(index)]), type_)


def _llvm(type_: Any) -> Any:
    if type_ in FLOATS:
        return ir.FloatType() if type_ == types.float32 else ir.DoubleType()
    return ir.IntType(1 if type_ == types.boolean else type_.bitwidth)


def _number(word: Word | int) -> Any:
    return word.to(types.int64).value if isinstance(word, Word) else ir.IntType(64)(word)


def _vocabulary(builder: Writer) -> dict[str, Any]:
    """Return what the names of types and operations stand for in a function that is being written."""

    def cast(type_: Any, word: Word | float) -> Word:
        return word.to(type_) if isinstance(word, Word) else Word(builder, _llvm(type_)(word), type_)

    def operation(make: Maker, type_: Any, result: Any, a: Word | int, b: Word | int) -> Word:
        builder.count(operations=1)
        value = make(builder, type_.signed, cast(type_, a).value, cast(type_, b).value)
        return Word(builder, value, result)

    def choose(type_: Any, flag: Word, a: Word | int, b: Word | int) -> Word:
        builder.count(operations=1)
        chosen = builder.trunc(flag.value, ir.IntType(1))
        return Word(builder, builder.select(chosen, cast(type_, a).value, cast(type_, b).value), type_)

    def column(type_: Any, of: Column, start: Word | int, index: Word | int) -> Column:
        return of.from_byte(type_, start, index)

    def flags(type_: Any, to: Column, index: Word | int, word: Word, count: int) -> None:
        place = to.written(index)
        # As a vector: LLVM does not find out by itself that a bit each of a word are numbers side by side.
        value = builder.trunc(word.value, ir.IntType(count)) if count < word.type.bitwidth else word.value
        numbers = ir.VectorType(_llvm(type_), count)
        chosen = builder.select(
            builder.bitcast(value, ir.VectorType(ir.IntType(1), count)),
            ir.Constant(numbers, [1] * count),
            ir.Constant(numbers, [0] * count),
        )
        builder.store(chosen, builder.bitcast(place, numbers.as_pointer()), type_.bitwidth // 8)

    def copy(type_: Any, to: Column, of: Column, index: Word, count: int) -> None:
        # Of a constant length: LLVM makes moves of it as wide as they come, where a loop has a scalar tail.
        cgutils.raw_memcpy(
            builder, to.written(index), of.at(index), ir.IntType(64)(count), type_.bitwidth // 8
        )

    def prefetch(type_: Any, to: Column, index: Word, count: int) -> None:
        # Words that will be written, of all slots before the first is: so the cache misses overlap.
        i32, size = ir.IntType(32), count * type_.bitwidth // 8
        takes = ir.FunctionType(ir.VoidType(), [BYTES, i32, i32, i32])
        request = builder.module.declare_intrinsic("llvm.prefetch", [BYTES], takes)
        first = builder.bitcast(to.at(index), BYTES)
        for byte in (*range(0, size, LINE), size - 1):
            address = builder.gep(first, [ir.IntType(64)(byte)])
            builder.call(request, [address, i32(1), i32(3), i32(1)])  # to write, to keep, data

    def turns(*bounds: Word | int) -> Iterator[Word]:
        start, stop = map(_number, bounds if len(bounds) == 2 else (0, *bounds))
        if isinstance(bounds[-1], int):
            # LLVM would write out every turn of a loop around others; so it is not told how many there are.
            stop = builder.asm(ir.FunctionType(stop.type, [stop.type]), "", "=r,0", [stop], False)
        loop = builder.loop(start, stop)
        index = Word(builder, loop.index, types.int64, lambda: loop.index)
        index.counts = True
        yield index
        loop.close()

    named: dict[str, Any] = {str(t): partial(cast, t) for t in NUMBERS}
    named |= {"numpy": SimpleNamespace(**named), "range": turns}
    for t in INTEGERS:
        named |= {f"{t}_{name}": partial(operation, make, t, t) for name, make in ARITHMETIC.items()}
        named |= {
            f"{t}_{name}": partial(operation, make, t, types.uint8) for name, make in COMPARISONS.items()
        }
    for t in NUMBERS:
        named |= {f"{t}_choose": partial(choose, t), f"{t}_column": partial(column, t)}
        named |= {
            f"{t}_flags": partial(flags, t),
            f"{t}_copy": partial(copy, t),
            f"{t}_prefetch": partial(prefetch, t),
        }
    return named


def _given(builder: Writer, value: Any, type_: Any) -> Word | Column:
    """Return what an argument is in a function that is being written: of an array, its words."""
    if isinstance(type_, (types.CPointer, types.Array)):
        assert getattr(type_, "layout", "C") == "C", "words are side by side"
        return Column(builder, value, type_.dtype)
    if type_ == types.boolean:
        return Word(builder, builder.zext(value, ir.IntType(8)), types.uint8)
    return Word(builder, value, type_)


def _written(function: Any, builder: Writer, arguments: Iterable[Word | Column]) -> tuple[Word, ...]:
    """Write a function's instructions, and return its results."""
    vocabulary = _vocabulary(builder)

    def meaning(value: Any) -> Any:
        if isinstance(value, np.ndarray):
            return Column.of(builder, value)
        return vocabulary.get(getattr(value, "__name__", ""), value)

    def with_range(function: Any) -> Any:
        function.__globals__["range"] = vocabulary["range"]
        return function

    results = remade(function, meaning, with_range)(*arguments)
    return results if isinstance(results, tuple) else () if results is None else (results,)


class _Heap:
    """Memory of a function that is compiled by itself, which returns 1 where there is none left."""

    @staticmethod
    def allocate(builder: Writer, size: Any) -> Any:
        """Return room for so many bytes."""
        malloc = cgutils.get_or_insert_function(builder.module, ir.FunctionType(BYTES, [size.type]), "malloc")
        malloc.return_value.add_attribute("noalias")
        room = builder.call(malloc, [size])
        with cgutils.if_unlikely(builder, builder.icmp_unsigned("==", room, BYTES(None))):
            builder.ret(FAILED(1))
        return room

    @staticmethod
    def free(builder: Writer, room: Any) -> None:
        """Give it back."""
        takes = ir.FunctionType(ir.VoidType(), [BYTES])
        builder.call(cgutils.get_or_insert_function(builder.module, takes, "free"), [room])


def _call(symbol: str, takes: Sequence[Any]) -> Callable[..., Any]:
    """Return what writes the call of a function that is compiled by itself."""

    def generate(context: Any, builder: Any, signature: Any, operands: Any) -> Any:
        values = []
        for value, type_, taken in zip(operands, signature.args, takes, strict=True):
            if isinstance(type_, types.Array):
                value = builder.bitcast(arrays().make_array(type_)(context, builder, value).data, taken)
            values.append(value)
        called = cgutils.get_or_insert_function(builder.module, ir.FunctionType(FAILED, takes), symbol)
        failed = builder.icmp_unsigned("!=", builder.call(called, values), FAILED(0))
        with cgutils.if_unlikely(builder, failed):
            context.call_conv.return_user_exc(builder, MemoryError, ("no room for a kernel's scratch space",))
        return context.get_dummy_value()

    return generate


def inlined(function: Callable[..., Any]) -> Any:
    """Return a function for kernels to call, and for other functions that are inlined.

    Where it is long and returns nothing, it is compiled by itself instead, once for all kernels.
    """

    def define(_: Any, *given: Any) -> Any:
        # Written by itself first, to find out how long it is, and the types of its results if it has any.
        plain = [_llvm(t.dtype).as_pointer() if hasattr(t, "dtype") else _llvm(t) for t in given]
        alone = ir.Function(ir.Module(), ir.FunctionType(FAILED, plain), "alone")
        builder = Writer(ir.IRBuilder(alone.append_basic_block()), _Heap)
        for argument in alone.args:
            if isinstance(argument.type, ir.PointerType):
                # Words are in one array or in another; so LLVM need not find out at each loop.
                argument.add_attribute("noalias")
        arguments = [_given(builder, *each) for each in zip(alone.args, given, strict=True)]
        returned = [word.type for word in _written(function, builder, arguments)] if returns else []
        if not returns:
            _written(function, builder, arguments)
            builder.ret(FAILED(0))
            if sum(len(block.instructions) for block in alone.blocks) >= LONG:
                return types.none(*given), _call(object_code.compiled(str(alone.module), alone.name), plain)

        def generate(context: Any, outside: Any, signature: Any, operands: Any) -> Any:
            builder = Writer(outside, context.nrt)
            arguments = []
            for value, type_ in zip(operands, signature.args, strict=True):
                if isinstance(type_, types.Array):
                    array = arrays().make_array(type_)(context, builder, value)
                    arguments.append(_given(builder, array.data, type_))
                else:
                    arguments.append(_given(builder, value, type_))
            values = [word.value for word in _written(function, builder, arguments)]
            outside.position_at_end(builder.block)
            if len(values) == 1:
                return values[0]
            if not values:
                return context.get_dummy_value()
            return context.make_tuple(outside, signature.return_type, values)

        if not returned:
            return types.none(*given), generate
        return (returned[0] if len(returned) == 1 else _Tuple(returned))(*given), generate

    code = list(dis.get_instructions(function))
    returns = any(
        (is_.opname == "RETURN_CONST" and is_.argval is not None)
        or (is_.opname == "RETURN_VALUE" and (before.opname, before.argval) != ("LOAD_CONST", None))
        for before, is_ in itertools.pairwise([code[0], *code])
    )
    # Numba asks for the names of the arguments.
    own = inspect.signature(function).parameters.values()
    whole = [inspect.Parameter("_", inspect.Parameter.POSITIONAL_OR_KEYWORD), *own]
    define.__signature__ = inspect.Signature(whole)  # type: ignore[attr-defined]
    define.__name__ = function.__name__
    result: Any = intrinsic(define)
    result.py_func = function  # what it is made again from, in functions that call it
    return result
