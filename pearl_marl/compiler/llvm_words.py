"""Operations on words of one width for kernels of a CPU, as LLVM has them: ``uint8_add(a, b)`` and so on.

Numba computes with 64 bits, and leaves it to LLVM to find out that 8 would do. It does not always, and a loop
with 64-bit words in it steps an eighth of the slots at a time. So these compute in their own width, to which
they cast what they are given.

What a loop reads and writes are addresses rather than arrays, whose owners Numba would count: such loops
compile in less time. ``uint8_column(array, start, index)`` is the address of a word, ``index`` words behind
byte ``start`` of an array; ``uint8_row(column, index, count)`` makes an array of some words again. Scratch
space is had by ``allocate(count)``, begins at ``line(space)``, and is given back by ``release(space)``.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterable
from functools import partial
from importlib import import_module
from types import SimpleNamespace
from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from pearl_marl.remaking import remade

LINE = 64
"""Bytes of a cache line, where scratch space begins."""

BYTES = ir.IntType(8).as_pointer()

_Address: Any = types.CPointer
_Tuple: Any = types.Tuple

Maker = Callable[..., Any]


def _compared(sign: str) -> Maker:
    def flag(builder: Any, signed: bool, a: Any, b: Any) -> Any:
        return builder.zext(_order(builder, signed)(sign, a, b), ir.IntType(8))

    return flag


def _extreme(sign: str) -> Maker:
    return lambda builder, signed, a, b: builder.select(_order(builder, signed)(sign, a, b), a, b)


def _order(builder: Any, signed: bool) -> Maker:
    order: Maker = builder.icmp_signed if signed else builder.icmp_unsigned
    return order


def _divide(builder: Any, signed: bool, a: Any, b: Any) -> Any:
    if not signed:
        return builder.udiv(a, b)
    # Rounded down; what is divided by is positive.
    below = builder.icmp_signed("<", builder.srem(a, b), a.type(0))
    return builder.sub(builder.sdiv(a, b), builder.zext(below, a.type))


def _modulo(builder: Any, signed: bool, a: Any, b: Any) -> Any:
    if not signed:
        return builder.urem(a, b)
    rest = builder.srem(a, b)
    return builder.select(builder.icmp_signed("<", rest, a.type(0)), builder.add(rest, b), rest)


COMPARISONS: dict[str, Maker] = {
    "equal": _compared("=="),
    "differ": _compared("!="),
    "less": _compared("<"),
    "at_least": _compared(">="),
}
"""Operations on two words whose result is a flag in a byte."""

ARITHMETIC: dict[str, Maker] = {
    "add": lambda builder, signed, a, b: builder.add(a, b),
    "sub": lambda builder, signed, a, b: builder.sub(a, b),
    "mul": lambda builder, signed, a, b: builder.mul(a, b),
    "and": lambda builder, signed, a, b: builder.and_(a, b),
    "or": lambda builder, signed, a, b: builder.or_(a, b),
    "xor": lambda builder, signed, a, b: builder.xor(a, b),
    "left": lambda builder, signed, a, b: builder.shl(a, b),
    "right": lambda builder, signed, a, b: (builder.ashr if signed else builder.lshr)(a, b),
    "minimum": _extreme("<"),
    "maximum": _extreme(">"),
    "divide": _divide,
    "modulo": _modulo,
}
"""Operations on two words whose result is one."""

TYPES = [types.Integer.from_bitwidth(bits, signed) for bits in (8, 16, 32, 64) for signed in (False, True)]


class Word:
    """A word of a function that is being written: LLVM's value, and Numba's type."""

    def __init__(self, builder: Any, value: Any, type_: Any) -> None:
        self.builder, self.value, self.type = builder, value, type_

    def to(self, type_: Any) -> Word:
        """Return the word in another type."""
        value, bits = self.value, type_.bitwidth
        if bits < self.type.bitwidth:
            value = self.builder.trunc(value, ir.IntType(bits))
        elif bits > self.type.bitwidth:
            extended = self.builder.sext if self.type.signed else self.builder.zext
            value = extended(value, ir.IntType(bits))
        return Word(self.builder, value, type_)

    def _with(self, make: Maker, other: Word) -> Word:
        assert self.type == other.type, "whoever uses operators casts both words"
        return Word(self.builder, make(self.builder, self.type.signed, self.value, other.value), self.type)

    def __mul__(self, other: Word) -> Word:
        return self._with(ARITHMETIC["mul"], other)

    def __and__(self, other: Word) -> Word:
        return self._with(ARITHMETIC["and"], other)

    def __xor__(self, other: Word) -> Word:
        return self._with(ARITHMETIC["xor"], other)

    def __rshift__(self, other: Word) -> Word:
        return self._with(ARITHMETIC["right"], other)

    def __floordiv__(self, other: Word) -> Word:
        return self._with(_divide, other)

    def __mod__(self, other: Word) -> Word:
        return self._with(_modulo, other)


class _Table:
    """A table of a function that is being written, in memory."""

    def __init__(self, builder: Any, entries: Any) -> None:
        self._builder, self._type = builder, getattr(types, str(entries.dtype))
        word = ir.IntType(self._type.bitwidth)
        constant = ir.Constant(ir.ArrayType(word, len(entries)), [word(int(entry)) for entry in entries])
        name = builder.module.get_unique_name("table")
        self._place = ir.GlobalVariable(builder.module, constant.type, name)
        self._place.global_constant, self._place.linkage = True, "internal"
        self._place.initializer = constant

    def __getitem__(self, index: Word) -> Word:
        at = self._builder.gep(self._place, [index.value.type(0), index.value])
        return Word(self._builder, self._builder.load(at), self._type)


def _vocabulary(builder: Any) -> dict[str, Any]:
    """Return what the names of types and operations stand for in a function that is being written."""

    def cast(type_: Any, word: Word | int) -> Word:
        if isinstance(word, Word):
            return word.to(type_)
        return Word(builder, ir.IntType(type_.bitwidth)(word), type_)

    def operation(make: Maker, type_: Any, result: Any, a: Word | int, b: Word | int) -> Word:
        value = make(builder, type_.signed, cast(type_, a).value, cast(type_, b).value)
        return Word(builder, value, result)

    def choose(type_: Any, flag: Word, a: Word | int, b: Word | int) -> Word:
        chosen = builder.trunc(flag.value, ir.IntType(1))
        return Word(builder, builder.select(chosen, cast(type_, a).value, cast(type_, b).value), type_)

    named: dict[str, Any] = {str(t): partial(cast, t) for t in TYPES}
    named["numpy"] = SimpleNamespace(**named)
    for t in TYPES:
        named |= {f"{t}_{name}": partial(operation, make, t, t) for name, make in ARITHMETIC.items()}
        named |= {
            f"{t}_{name}": partial(operation, make, t, types.uint8) for name, make in COMPARISONS.items()
        }
        named[f"{t}_choose"] = partial(choose, t)
    return named


def _written(function: Any, builder: Any, words: Iterable[tuple[Any, Any]]) -> tuple[Word, ...]:
    """Write a function's operations, given the values and types of its arguments; return its results."""
    vocabulary = _vocabulary(builder)

    def meaning(value: Any) -> Any:
        if isinstance(value, np.ndarray):
            return _Table(builder, value)
        return vocabulary.get(getattr(value, "__name__", ""), value)

    results = remade(function, meaning)(*(Word(builder, value, type_) for value, type_ in words))
    return results if isinstance(results, tuple) else (results,)


def inlined(function: Callable[..., Any]) -> Any:
    """Return a function of operations on words for kernels to call, in which there are no branches.

    It is run once, on words that write down what is done to them. Numba takes many times as long for it,
    and would have LLVM optimize it once by itself and once more where it is called.
    """

    def define(_: Any, *given: Any) -> Any:
        nowhere = ir.Function(ir.Module(), ir.FunctionType(ir.VoidType(), []), "nowhere")
        anything = [(ir.IntType(type_.bitwidth)(0), type_) for type_ in given]
        results = _written(function, ir.IRBuilder(nowhere.append_basic_block()), anything)
        returned = [word.type for word in results]

        def generate(context: Any, builder: Any, signature: Any, operands: Any) -> Any:
            words = _written(function, builder, zip(operands, signature.args, strict=True))
            values = [word.value for word in words]
            if len(values) == 1:
                return values[0]
            return context.make_tuple(builder, signature.return_type, values)

        return (returned[0] if len(returned) == 1 else _Tuple(returned))(*given), generate

    # Numba asks for the names of the arguments.
    own = inspect.signature(function).parameters.values()
    whole = [inspect.Parameter("_", inspect.Parameter.POSITIONAL_OR_KEYWORD), *own]
    define.__signature__ = inspect.Signature(whole)  # type: ignore[attr-defined]
    define.__name__ = function.__name__
    return intrinsic(define)


def _named(name: str) -> Any:
    return SimpleNamespace(__name__=name)


def _choice(name: str) -> Any:
    operation = _named(name)

    def choose(flag: Any, a: Any, b: Any) -> Any:
        return operation(flag, a, b)

    choose.__name__ = name
    return inlined(choose)


def _arrays() -> Any:
    """Return Numba's module about arrays, which nobody who only imports this package should wait for."""
    return import_module("numba.np.arrayobj")


def _first(context: Any, builder: Any, of: Any, whole: Any) -> Any:
    """Return the address of an array's first byte, or of what an address points to."""
    data = whole if isinstance(of, types.CPointer) else _arrays().make_array(of)(context, builder, whole).data
    return builder.bitcast(data, BYTES)


def _column(element: Any) -> Any:
    made = _Address(element)

    @intrinsic
    def column(_: Any, array: Any, start: Any, index: Any) -> Any:
        def generate(context: Any, builder: Any, signature: Any, operands: Any) -> Any:
            whole, *numbers = operands
            given = zip(numbers, signature.args[1:], strict=True)
            byte, word = (context.cast(builder, x, t, types.intp) for x, t in given)
            at = builder.gep(_first(context, builder, array, whole), [byte])
            return builder.gep(builder.bitcast(at, context.get_value_type(made)), [word])

        return made(array, start, index), generate

    return column


def _row(element: Any) -> Any:
    made = types.Array(element, 1, "C")

    @intrinsic
    def row(_: Any, first: Any, index: Any, count: Any) -> Any:
        def generate(context: Any, builder: Any, signature: Any, operands: Any) -> Any:
            pointer, *numbers = operands
            given = zip(numbers, signature.args[1:], strict=True)
            word, length = (context.cast(builder, x, t, types.intp) for x, t in given)
            arrayobj = _arrays()
            view = arrayobj.make_array(made)(context, builder)
            size = context.get_constant(types.intp, element.bitwidth // 8)
            # It owns nothing: whoever calls the kernel holds the array.
            arrayobj.populate_array(
                view,
                data=builder.gep(pointer, [word]),
                shape=[length],
                strides=[size],
                itemsize=size,
                meminfo=None,
            )
            return view._getvalue()

        return made(first, index, count), generate

    return row


@intrinsic
def _allocate(_: Any, count: Any) -> Any:
    def generate(context: Any, builder: Any, signature: Any, operands: Any) -> Any:
        return context.nrt.allocate(builder, context.cast(builder, operands[0], count, types.intp))

    return _Address(types.uint8)(count), generate


@intrinsic
def _line(_: Any, whole: Any) -> Any:
    def generate(context: Any, builder: Any, signature: Any, operands: Any) -> Any:
        word = context.get_value_type(types.intp)
        at = builder.ptrtoint(operands[0], word)
        # An offset rather than a rounded address, which LLVM could no longer tell from others.
        return builder.gep(operands[0], [builder.and_(builder.neg(at), word(LINE - 1))])

    return whole(whole), generate


@intrinsic
def _release(_: Any, whole: Any) -> Any:
    def generate(context: Any, builder: Any, signature: Any, operands: Any) -> Any:
        context.nrt.free(builder, operands[0])
        return context.get_dummy_value()

    return types.none(whole), generate


def operations() -> dict[str, Any]:
    """Return all operations by their names, for a kernel's source to call."""
    named = {"allocate": _allocate, "line": _line, "release": _release}
    for element in (types.float32, types.float64, *TYPES):
        named |= {f"{element}_column": _column(element), f"{element}_row": _row(element)}
    for t in TYPES:
        # Names are all that functions need which are ``inlined``.
        named |= {f"{t}_{name}": _named(f"{t}_{name}") for name in (*ARITHMETIC, *COMPARISONS)}
        named[f"{t}_choose"] = _choice(f"{t}_choose")
    return named
