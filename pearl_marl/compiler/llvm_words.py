"""Operations on words of one width for kernels of a CPU, as LLVM has them: ``uint8_add(a, b)`` and so on.

Numba computes with 64 bits, and leaves it to LLVM to find out that 8 would do. It does not always, and a loop
with 64-bit words in it steps an eighth of the slots at a time. So these compute in their own width, to which
they cast their operands.
"""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

from llvmlite import ir
from numba import types

BYTES = ir.IntType(8).as_pointer()

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


def operations() -> dict[str, Any]:
    """Return what stands for each operation in the golden functions of a kernel: an object with its name."""
    names = [f"{t}_{name}" for t in INTEGERS for name in (*ARITHMETIC, *COMPARISONS, "choose")]
    return {name: SimpleNamespace(__name__=name) for name in names}
