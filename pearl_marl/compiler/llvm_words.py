"""Operations on words of one width for kernels of a CPU, as LLVM has them: ``uint8_add(a, b)`` and so on.

Numba computes with 64 bits, and leaves it to LLVM to find out that 8 would do. It does not always, and a loop
with 64-bit words in it steps an eighth of the slots at a time. So these compute in their own width, to which
they cast what they are given.

What a loop reads and writes are addresses rather than arrays, whose owners Numba would count: such loops
compile in less time. ``uint8_column(array, start, index)`` is the address of a word, ``index`` words behind
byte ``start`` of an array; ``uint8_row(column, index, count)`` makes an array of some words again. Scratch
space, which begins a cache line, comes from ``allocate(count)`` and goes back by ``release(space)``.
``address(number)`` is the address of a byte.
"""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from types import SimpleNamespace
from typing import Any

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

LINE = 64
"""Bytes of a cache line, where scratch space begins."""

BYTES = ir.IntType(8).as_pointer()

_Address: Any = types.CPointer

Maker = Callable[..., Any]


def _borrow(builder: Any, a: Any, b: Any, sign: str) -> Any:
    """Return whether ``a < b``, or not, as the borrow of their difference.

    SIMD units compare into a bit a word, and to make a byte of each takes longer.
    """
    less = builder.and_(builder.not_(a), b)
    less = builder.or_(less, builder.and_(builder.or_(builder.not_(a), b), builder.sub(a, b)))
    less = builder.trunc(builder.lshr(less, less.type(31)), ir.IntType(8))
    return less if sign == "<" else builder.xor(less, less.type(1))


def _compared(sign: str) -> Maker:
    def flag(builder: Any, signed: bool, a: Any, b: Any) -> Any:
        if not signed and a.type.width == 32 and sign in ("<", ">="):
            return _borrow(builder, a, b, sign)
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

INTEGERS = [types.Integer.from_bitwidth(bits, signed) for bits in (8, 16, 32, 64) for signed in (False, True)]
FLOATS = [types.float32, types.float64]
NUMBERS: list[Any] = [*INTEGERS, *FLOATS]


def arrays() -> Any:
    """Return Numba's module about arrays, which nobody who only imports this package should wait for."""
    return import_module("numba.np.arrayobj")


def _first(context: Any, builder: Any, of: Any, whole: Any) -> Any:
    """Return the address of an array's first byte, or of what an address points to."""
    data = whole if isinstance(of, types.CPointer) else arrays().make_array(of)(context, builder, whole).data
    return builder.bitcast(data, BYTES)


def _column(element: Any) -> Any:
    made = _Address(element)

    def column(_: Any, array: Any, start: Any, index: Any) -> Any:
        def generate(context: Any, builder: Any, signature: Any, operands: Any) -> Any:
            whole, *numbers = operands
            given = zip(numbers, signature.args[1:], strict=True)
            byte, word = (context.cast(builder, x, t, types.intp) for x, t in given)
            at = builder.gep(_first(context, builder, array, whole), [byte])
            return builder.gep(builder.bitcast(at, context.get_value_type(made)), [word])

        return made(array, start, index), generate

    column.__name__ = f"{element}_column"  # by which functions that are inlined know it
    return intrinsic(column)


def _row(element: Any) -> Any:
    made = types.Array(element, 1, "C")

    @intrinsic
    def row(_: Any, first: Any, index: Any, count: Any) -> Any:
        def generate(context: Any, builder: Any, signature: Any, operands: Any) -> Any:
            pointer, *numbers = operands
            given = zip(numbers, signature.args[1:], strict=True)
            word, length = (context.cast(builder, x, t, types.intp) for x, t in given)
            arrayobj = arrays()
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
def _address(_: Any, number: Any) -> Any:
    def generate(context: Any, builder: Any, signature: Any, operands: Any) -> Any:
        return builder.inttoptr(operands[0], BYTES)

    return _Address(types.uint8)(number), generate


@intrinsic
def _allocate(_: Any, count: Any) -> Any:
    def generate(context: Any, builder: Any, signature: Any, operands: Any) -> Any:
        word = context.get_value_type(types.intp)
        length = builder.add(context.cast(builder, operands[0], count, types.intp), word(LINE))
        whole = context.nrt.allocate(builder, length)
        # As an offset and not as a rounded address, it is still known to be apart from all other words.
        offset = builder.sub(word(LINE), builder.and_(builder.ptrtoint(whole, word), word(LINE - 1)))
        first = builder.gep(whole, [offset])
        builder.store(whole, _kept(builder, first))
        return first

    return _Address(types.uint8)(count), generate


@intrinsic
def _release(_: Any, first: Any) -> Any:
    def generate(context: Any, builder: Any, signature: Any, operands: Any) -> Any:
        context.nrt.free(builder, builder.load(_kept(builder, *operands)))
        return context.get_dummy_value()

    return types.none(first), generate


def _kept(builder: Any, first: Any) -> Any:
    """Return where the address is kept that was allocated: before the first line, of which some is left."""
    return builder.gep(builder.bitcast(first, BYTES.as_pointer()), [ir.IntType(32)(-1)])


def operations() -> dict[str, Any]:
    """Return all operations by their names, for a kernel's source to call."""
    named = {"address": _address, "allocate": _allocate, "release": _release}
    for t in NUMBERS:
        named |= {f"{t}_column": _column(t), f"{t}_row": _row(t)}
        named |= {f"{t}_{name}": _named(f"{t}_{name}") for name in ("choose", "flags", "copy", "prefetch")}
    for t in INTEGERS:
        named |= {f"{t}_{name}": _named(f"{t}_{name}") for name in (*ARITHMETIC, *COMPARISONS)}
    return named


def _named(name: str) -> Any:
    """Return what only functions that are inlined call: they have the operation for its name."""
    return SimpleNamespace(__name__=name)
