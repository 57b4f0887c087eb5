"""Functions of kernels, written as LLVM's instructions by ordinary Python.

A function is given a :class:`Code`, and runs once. It computes with values that write down what is done to
them. Loops, branches and variables come from the ``Code``: ``for i in code.range(m)`` writes one loop, ``with
code.when(flag)`` one branch; an ``if`` of Python decides what is written. Numba takes many times as long for
such a function, since it finds out types, owners and errors for each line.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Hashable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils as _cgutils
from numba.extending import intrinsic

from pearl_marl.base import object_code
from pearl_marl.compiler.llvm_loops import Writer
from pearl_marl.compiler.llvm_words import ARITHMETIC, BYTES, COMPARISONS, FLOATS, INTEGERS, NUMBERS, Maker
from pearl_marl.golden.rebinding import rebound

cgutils: Any = _cgutils
"""Numba's, which has no types."""

LINE = 64
"""Bytes of a cache line."""

LONG = 200
"""Instructions from which on a function is compiled by itself: its work takes far longer than a call."""

VERY_LONG = 5_000
"""Instructions from which on LLVM does less for one: without loops code is made in no time rather than well,
and with loops passes are left out that change little."""

FAILED = ir.IntType(8)
"""What such a function returns: 1 where there is no memory left, and else 0."""


def _operator(name: str) -> Callable[[Value, Value | float], Value]:
    return lambda self, other: self._with(name, other)


def _comparison(name: str) -> Callable[[Value, Value | int], Value]:
    return lambda self, other: self.code.operation(COMPARISONS[name], self.type, types.uint8, self, other)


class Value:
    """A word that instructions compute: LLVM's value, and Numba's type.

    ``again`` makes the value again where a loop has been cut; it returns None if that is not possible. Where
    there is none, the value is kept. What ``loads`` is counted when it is used.
    """

    def __init__(
        self,
        code: Code,
        value: Any,
        type_: Any,
        again: Callable[[], Any] | None = None,
        loads: bool = False,
    ) -> None:
        self.code, self.type = code, type_
        self._value, self._again, self._uncounted = value, again, loads
        self._loop = code.loops[-1] if code.loops else None
        self._part_number = self._loop.part_number if self._loop else 0
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
        if (
            loop is not None
            and self._part_number < loop.part_number
            and not isinstance(self._value, ir.Constant)
        ):
            value = None if self._again is None else self._again()
            if value is None:
                if self._kept is None:
                    self._kept = loop.keep(self._value, self._part_number)
                value = loop.kept(self._kept, self._value.type)
            if loop is not self.code.loops[-1]:  # within another loop: that value is not there behind it
                return value
            self._value, self._part_number = value, loop.part_number
        return self._value

    def __bool__(self) -> bool:
        raise TypeError("no `if` can decide on a word of a kernel: branches are written by `code.when`")

    def to(self, type_: Any) -> Value:
        """Return the word in another type."""
        if type_ == self.type:
            return self
        if self._again is None:
            return Value(self.code, self._as(type_, self.value), type_)

        def again() -> Any:
            return self._as(type_, self.value)

        return Value(self.code, self._as(type_, self.uncounted()), type_, again, self._uncounted)

    def _as(self, type_: Any, value: Any) -> Any:
        own, bits, to = self.type, type_.bitwidth, _llvm(type_)
        if type_ in FLOATS:
            return (self.code.sitofp if own.signed else self.code.uitofp)(value, to)
        if bits < own.bitwidth:
            return self.code.trunc(value, to)
        if bits > own.bitwidth:
            return (self.code.sext if own.signed else self.code.zext)(value, to)
        return value

    def _with(self, name: str, other: Value | float) -> Value:
        if not isinstance(other, Value):
            other = self.code.word(self.type, other)
        assert self.type == other.type, "both words are cast to one type first"
        if self.type in FLOATS:
            assert name == "mul"
            self.code.count(operations=1)
            return Value(self.code, self.code.fmul(self.value, other.value), self.type)
        return self.code.operation(ARITHMETIC[name], self.type, self.type, self, other)

    __add__ = _operator("add")
    __sub__ = _operator("sub")
    __mul__ = __rmul__ = _operator("mul")
    __and__ = _operator("and")
    __or__ = _operator("or")
    __xor__ = _operator("xor")
    __lshift__ = _operator("left")
    __rshift__ = _operator("right")
    __floordiv__ = _operator("divide")
    __mod__ = _operator("modulo")
    __lt__ = _comparison("less")
    __ge__ = _comparison("at_least")
    equals = _comparison("equal")
    """Return 1 where two words are equal, else 0."""
    differs = _comparison("differ")
    """Return 0 where two words are equal, else 1."""


class WordArray:
    """Words side by side in memory: LLVM's address of the first, and their type."""

    def __init__(self, code: Code, first: Any, type_: Any, skipped: int = 0) -> None:
        self.code, self.first, self.type = code, first, type_
        self._stores, self._skipped = 0, skipped
        self._behind: dict[int, WordArray] = {}

    def __getitem__(self, index: Value | int) -> Value:
        stores = self._stores

        def again() -> Any:
            return self.code.load(self.at(index)) if stores == self._stores else None

        return Value(self.code, self.code.load(self.at(index)), self.type, again, loads=True)

    def __setitem__(self, index: Value | int, word: Value | int) -> None:
        place = self.written(index)
        value = word.to(self.type).value if isinstance(word, Value) else _llvm(self.type)(word)
        self.code.store(value, place)

    def written(self, index: Value | int) -> Any:
        """Return the address of words that are written next."""
        scattered = isinstance(index, Value) and not index.counts
        self.code.count(accesses=1, scattered=scattered)
        self._stores += 1
        return self.at(index)

    def at(self, index: Value | int) -> Any:
        """Return the address of a word."""
        first = self.first if not self._skipped else self.code.gep(self.first, [_number(self._skipped)])
        return self.code.gep(first, [_number(index)])

    def behind(self, count: int) -> WordArray:
        """Return the words behind so many, always the same column: it knows what was stored there.

        Unlike a view it makes no address by itself: what one part of a loop has made, the next does not know.
        """
        if count not in self._behind:
            self._behind[count] = WordArray(self.code, self.first, self.type, count)
        return self._behind[count]

    def view(self, type_: Any, byte: Value | int = 0, index: Value | int = 0) -> WordArray:
        """Return the words of a type that begin ``index`` words behind a byte."""
        start = self.code.gep(self.code.bitcast(self.first, BYTES), [_number(byte)])
        first = self.code.bitcast(start, _llvm(type_).as_pointer())
        return WordArray(self.code, self.code.gep(first, [_number(index)]), type_)

    def write_flags(self, index: Value | int, word: Value, count: int) -> None:
        """Write the lowest bits of a word, a number each."""
        code, place = self.code, self.written(index)
        # As a vector: LLVM does not find out by itself that a bit each of a word are numbers side by side.
        value = code.trunc(word.value, ir.IntType(count)) if count < word.type.bitwidth else word.value
        numbers = ir.VectorType(_llvm(self.type), count)
        chosen = code.select(
            code.bitcast(value, ir.VectorType(ir.IntType(1), count)),
            ir.Constant(numbers, [1] * count),
            ir.Constant(numbers, [0] * count),
        )
        code.store(chosen, code.bitcast(place, numbers.as_pointer()), self.type.bitwidth // 8)

    def copy(self, source: WordArray, index: Value, count: int) -> None:
        """Copy words that have the same index in another column."""
        # Of a constant length: LLVM makes moves of it as wide as they come, where a loop has a scalar tail.
        size = ir.IntType(64)(count)
        cgutils.raw_memcpy(self.code, self.written(index), source.at(index), size, self.type.bitwidth // 8)

    def prefetch(self, index: Value, count: int) -> None:
        """Ask for the cache lines of words that will be written: so the cache misses of many overlap."""
        code, i32, size = self.code, ir.IntType(32), count * self.type.bitwidth // 8
        takes = ir.FunctionType(ir.VoidType(), [BYTES, i32, i32, i32])
        request = code.module.declare_intrinsic("llvm.prefetch", [BYTES], takes)
        # There may be no such words, behind the last ones: then the request does nothing.
        first = code.bitcast(code.gep(self.at(0), [_number(index)], inbounds=False), BYTES)
        for byte in (*range(0, size, LINE), size - 1):
            address = code.gep(first, [ir.IntType(64)(byte)], inbounds=False)
            code.call(request, [address, i32(1), i32(3), i32(1)])  # to write, to keep, data


class Frame:
    """The words and columns that a function works on, by name: ``frame.rewards``."""

    def __init__(self, **named: Value | WordArray) -> None:
        self.named = named
        self.used: set[str] = set()

    def __getattr__(self, name: str) -> Any:
        self.used.add(name)
        return self.named[name]

    def with_(self, **more: Value | WordArray) -> Frame:
        """Return a frame that has more, or others in the place of some."""
        frame = Frame(**{**self.named, **more})
        frame.used = self.used
        return frame


class Compiled(NamedTuple):
    """A function that is compiled by itself: its symbol, and the names of what it takes."""

    symbol: str
    names: list[str]


class Code(Writer):
    """Writes a function, value by value.

    ``memory`` has ``allocate`` and ``free``; ``context`` is Numba's, where the function is part of one of
    Numba's. ``compiled`` keeps which functions are compiled by themselves, for all kernels that call them.
    """

    def __init__(
        self, builder: Any, memory: Any, compiled: dict[Any, Compiled | None], context: Any = None
    ) -> None:
        super().__init__(builder, memory)
        self._compiled, self._context = compiled, context

    def argument(self, value: Any, type_: Any) -> Any:
        """Return what an argument of Numba's is here: a list for a tuple, and for an array its words."""
        if isinstance(type_, types.BaseTuple):
            own: Any = type_
            return [self.argument(self.extract_value(value, k), t) for k, t in enumerate(own)]
        if isinstance(type_, types.Array):
            assert type_.layout == "C", "words are side by side"
            array = self._context.make_array(type_)(self._context, self, value)
            return WordArray(self, array.data, type_.dtype)
        if type_ == types.boolean:
            return Value(self, self.zext(value, ir.IntType(8)), types.uint8)
        return Value(self, value, type_)

    def word(self, type_: Any, number: Value | float) -> Value:
        """Return a number, or a word, in a type."""
        return number.to(type_) if isinstance(number, Value) else Value(self, _llvm(type_)(number), type_)

    def operation(self, make: Maker, type_: Any, result: Any, a: Value | int, b: Value | int) -> Value:
        """Return what an operation makes of two words that are cast to a type."""
        self.count(operations=1)
        value = make(self, type_.signed, self.word(type_, a).value, self.word(type_, b).value)
        return Value(self, value, result)

    def choose(self, type_: Any, flag: Value, a: Value | float, b: Value | float) -> Value:
        """Return one of two words, by the lowest bit of a flag."""
        self.count(operations=1)
        byte, bit = flag.value, ir.IntType(1)
        # A comparison has made a byte of a bit; the bit itself saves LLVM much of its work.
        compared = getattr(byte, "opname", None) == "zext" and byte.operands[0].type == bit
        chosen = byte.operands[0] if compared else self.trunc(byte, bit)
        return Value(self, self.select(chosen, self.word(type_, a).value, self.word(type_, b).value), type_)

    def table(self, table: Any) -> WordArray:
        """Return the entries of an array, which are constants."""
        type_ = getattr(types, str(table.dtype))
        word = _llvm(type_)
        constant = ir.Constant(ir.ArrayType(word, len(table)), [word(int(entry)) for entry in table])
        place = ir.GlobalVariable(self.module, constant.type, self.module.get_unique_name("table"))
        place.global_constant, place.linkage, place.initializer = True, "internal", constant
        # A constant and no instruction, as any part of a loop may read the table.
        return WordArray(self, place.bitcast(word.as_pointer()), type_)

    def variable(self, start: Value) -> WordArray:
        """Return room for one word, which begins as another: what a branch or a turn of a loop changes."""
        room = WordArray(self, cgutils.alloca_once(self, start.value.type), start.type)
        room[0] = start
        return room

    def range(self, *bounds: Value | int) -> Iterator[Value]:
        """Write a loop: yields its index, once."""
        start, stop = map(_number, bounds if len(bounds) == 2 else (0, *bounds))
        if isinstance(bounds[-1], int):
            # LLVM would write out every turn of a loop around others; so it is not told how many there are.
            stop = self.asm(ir.FunctionType(stop.type, [stop.type]), "", "=r,0", [stop], False)
        loop = self.loop(start, stop)
        index = Value(self, loop.index, types.int64, lambda: loop.index)
        index.counts = True
        yield index
        loop.close()

    def when(self, flag: Value) -> Any:
        """Write a branch, as a context manager, which is taken unless a word is 0."""
        return self.if_then(self._is_set(flag))

    def either(self, flag: Value) -> Any:
        """Write two branches, likewise: yields what to enter for each."""
        return self.if_else(self._is_set(flag))

    def _is_set(self, flag: Value) -> Any:
        if self.loops:
            self.loops[-1].whole = True
        value = flag.value
        return self.icmp_unsigned("!=", value, value.type(0))

    def address(self, number: Value) -> WordArray:
        """Return the bytes at an address."""
        return WordArray(self, self.inttoptr(number.value, BYTES), types.uint8)

    @contextmanager
    def scratch(
        self, shared: dict[str, tuple[Any, int]], alone: dict[str, tuple[Any, int]]
    ) -> Iterator[Frame]:
        """Allocate columns, each of a type and so many words, and free them at the end.

        Those that are ``shared`` lie in one piece of memory, one after the other, each on a cache line of its
        own.
        """
        starts, size = {}, 0
        for name, (type_, count) in shared.items():
            starts[name] = size
            size += -(-count * type_.bitwidth // 8 // LINE) * LINE
        piece, room = self._piece(size)
        pieces, columns = [piece], {name: room.view(t, starts[name]) for name, (t, _) in shared.items()}
        for name, (type_, count) in alone.items():
            piece, words = self._piece(count * type_.bitwidth // 8)
            pieces.append(piece)
            columns[name] = words.view(type_)
        yield Frame(**columns)
        for piece in pieces:
            self.memory.free(self, piece)

    def _piece(self, size: int) -> tuple[Any, WordArray]:
        """Allocate bytes; return the address to free, and the bytes from the first cache line on."""
        number = ir.IntType(64)
        piece = self.memory.allocate(self, number(size + LINE))
        # As an offset and not as a rounded address, it is still known to be apart from all other words.
        offset = self.sub(number(LINE), self.and_(self.ptrtoint(piece, number), number(LINE - 1)))
        return piece, WordArray(self, self.gep(piece, [offset]), types.uint8)

    def call_compiled(
        self, function: Any, words: Sequence[Value], row: WordArray, index: Value, count: int
    ) -> None:
        """Call a function that Numba compiles, with words and an array of so many others from an index on."""
        array_type, number = types.Array(row.type, 1, "C"), ir.IntType(64)
        array = self._context.make_array(array_type)(self._context, self)
        size = number(row.type.bitwidth // 8)
        # It owns nothing: the caller of the kernel holds the array.
        self._context.populate_array(
            array, data=row.at(index), shape=[number(count)], strides=[size], itemsize=size, meminfo=None
        )
        self.loops[-1].whole = True
        type_ = types.Dispatcher(function)
        taken = *(word.type for word in words), array_type
        signature = self._context.typing_context.resolve_function_type(type_, taken, {})
        write = self._context.get_function(type_, signature)
        write(self, [*(word.value for word in words), array._getvalue()])

    def inline(self, function: Any, *arguments: Value | WordArray) -> Any:
        """Write a function that is plain Python over NumPy's words, and return its results."""
        named: dict[str, Any] = {str(t): partial(self.word, t) for t in NUMBERS}
        named["numpy"] = SimpleNamespace(**named)
        for t in INTEGERS:
            named |= {f"{t}_{name}": partial(self.operation, make, t, t) for name, make in ARITHMETIC.items()}
            named |= {
                f"{t}_{name}": partial(self.operation, make, t, types.uint8)
                for name, make in COMPARISONS.items()
            }
            named[f"{t}_choose"] = partial(self.choose, t)

        def meaning(value: Any) -> Any:
            if isinstance(value, np.ndarray):
                return self.table(value)
            return named.get(getattr(value, "__name__", ""), value)

        return rebound(function, meaning, names={"range": self.range})(*arguments)

    def run(self, function: Callable[..., None], frame: Frame, *more: Hashable) -> None:
        """Write ``function(code, frame, *more)``; where that is long, compile it once, and write its call."""
        known = function.__qualname__, *more
        if known not in self._compiled:
            self._compiled[known] = self._alone(function, frame, *more)
        compiled = self._compiled[known]
        if compiled is None:
            function(self, frame, *more)
            return
        values = [_operand(frame.named[name]) for name in compiled.names]
        takes = ir.FunctionType(FAILED, [value.type for value in values])
        called = cgutils.get_or_insert_function(self.module, takes, compiled.symbol)
        failed = self.icmp_unsigned("!=", self.call(called, values), FAILED(0))
        frame.used.update(compiled.names)
        with cgutils.if_unlikely(self, failed):
            self.memory.fail(self)

    def _alone(self, function: Callable[..., None], frame: Frame, *more: Hashable) -> Compiled | None:
        """Write a function by itself, and compile it if it is long."""
        names = sorted(frame.named)
        taken = [_operand(frame.named[name]).type for name in names]
        alone = ir.Function(ir.Module(), ir.FunctionType(FAILED, taken), "alone")
        code = Code(ir.IRBuilder(alone.append_basic_block()), _Heap, self._compiled)
        own = Frame(
            **{
                name: type(frame.named[name])(code, argument, frame.named[name].type)
                for name, argument in zip(names, alone.args, strict=True)
            }
        )
        function(code, own, *more)
        code.ret(FAILED(0))
        length = sum(len(block.instructions) for block in alone.blocks)
        if length < LONG:
            return None
        used = [
            (name, argument) for name, argument in zip(names, alone.args, strict=True) if name in own.used
        ]
        for _, argument in used:
            if isinstance(argument.type, ir.PointerType):
                # Words are in one array or in another; so LLVM need not find out at each loop.
                argument.add_attribute("noalias")
        alone.args = tuple(argument for _, argument in used)
        # Functions are made of graphs that are simplified already. So the passes of LLVM's first level, which
        # make SIMD code of loops, do for a very long one; and a function without loops, which starts an
        # episode, gains by no pass, and a very long one would take seconds to be compiled well.
        loops = len(alone.blocks) > 1
        passes = 1 if length >= VERY_LONG else 3
        effort = 0 if length >= VERY_LONG and not loops else 3
        symbol = object_code.compiled(str(alone.module), alone.name, passes if loops else 0, effort)
        return Compiled(symbol, [name for name, _ in used])


def _llvm(type_: Any) -> Any:
    if type_ in FLOATS:
        return ir.FloatType() if type_ == types.float32 else ir.DoubleType()
    return ir.IntType(1 if type_ == types.boolean else type_.bitwidth)


def _number(word: Value | int) -> Any:
    return word.to(types.int64).value if isinstance(word, Value) else ir.IntType(64)(word)


def _operand(value: Value | WordArray) -> Any:
    return value.first if isinstance(value, WordArray) else value.value


class _Heap:
    """Memory of a function that is compiled by itself, which returns 1 where there is none left."""

    @staticmethod
    def allocate(code: Code, size: Any) -> Any:
        """Return room for so many bytes."""
        malloc = cgutils.get_or_insert_function(code.module, ir.FunctionType(BYTES, [size.type]), "malloc")
        malloc.return_value.add_attribute("noalias")
        room = code.call(malloc, [size])
        with cgutils.if_unlikely(code, code.icmp_unsigned("==", room, BYTES(None))):
            _Heap.fail(code)
        return room

    @staticmethod
    def free(code: Code, room: Any) -> None:
        """Give it back."""
        takes = ir.FunctionType(ir.VoidType(), [BYTES])
        code.call(cgutils.get_or_insert_function(code.module, takes, "free"), [room])

    @staticmethod
    def fail(code: Code) -> None:
        """Return, since there is no memory left."""
        code.ret(FAILED(1))


class _Numbas:
    """Memory of a function that is part of one of Numba's."""

    def __init__(self, context: Any) -> None:
        self._context = context
        self.allocate, self.free = context.nrt.allocate, context.nrt.free

    def fail(self, code: Code) -> None:
        """Raise, since there is no memory left."""
        told = ("no room for a kernel's scratch space",)
        self._context.call_conv.return_user_exc(code, MemoryError, told)


def written(
    function: Callable[[Code, dict[str, Any]], Value | None],
    names: Sequence[str],
    compiled: dict[Any, Compiled | None],
) -> Any:
    """Return a function for Numba's to call, which another one writes.

    That is given its arguments by name: words, columns for arrays, and lists for tuples. What it returns is a
    ``uint8``, or else 1 is returned.
    """

    def define(_: Any, *taken: Any) -> Any:
        def generate(context: Any, outside: Any, signature: Any, operands: Any) -> Any:
            code = Code(outside, _Numbas(context), compiled, context)
            arguments = map(code.argument, operands, taken)
            result = function(code, dict(zip(names, arguments, strict=True)))
            returned = code.word(types.uint8, 1 if result is None else result).value
            outside.position_at_end(code.block)
            return returned

        return types.uint8(*taken), generate

    # Numba asks for the names of the arguments.
    kind = inspect.Parameter.POSITIONAL_OR_KEYWORD
    whole = [inspect.Parameter(name, kind) for name in ("_", *names)]
    define.__signature__ = inspect.Signature(whole)  # type: ignore[attr-defined]
    return intrinsic(define)
