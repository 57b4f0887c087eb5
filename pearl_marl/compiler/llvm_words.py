"""Operations on words of one width for kernels of a CPU, as LLVM has them: ``uint8_add(a, b)`` and so on.

Numba computes with 64 bits, and leaves it to LLVM to find out that 8 would do. It does not always, and a loop
with 64-bit words in it steps an eighth of the slots at a time. So these compute in their own width, to which
they cast what they are given. ``uint8_column(array, start, count)`` is a view of an array's bytes from
``start`` on, and ``uint8_scratch(count)`` an array that holds anything: compiling them costs a tenth of
what a slice with a ``view``, and ``np.empty``, do.
"""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from typing import Any

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

LINE = 64
"""Bytes of a cache line, where scratch space begins."""

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
}
"""Operations on two words whose result is one."""


def _operation(make: Maker, word: Any, result: Any) -> Any:
    @intrinsic
    def operation(_: Any, a: Any, b: Any) -> Any:
        def generate(context: Any, builder: Any, signature: Any, operands: Any) -> Any:
            words = (context.cast(builder, x, t, word) for x, t in zip(operands, signature.args, strict=True))
            return make(builder, word.signed, *words)

        return result(a, b), generate

    return operation


def _choice(word: Any) -> Any:
    @intrinsic
    def choose(_: Any, flag: Any, a: Any, b: Any) -> Any:
        def generate(context: Any, builder: Any, signature: Any, operands: Any) -> Any:
            flag, *values = operands
            given = zip(values, signature.args[1:], strict=True)
            return builder.select(
                builder.trunc(flag, ir.IntType(1)), *(context.cast(builder, x, t, word) for x, t in given)
            )

        return word(flag, a, b), generate

    return choose


def _arrays() -> Any:
    """Return Numba's module about arrays, which nobody who only imports this package should wait for."""
    return import_module("numba.np.arrayobj")


def _column(element: Any) -> Any:
    made = types.Array(element, 1, "C")

    @intrinsic
    def column(_: Any, array: Any, start: Any, count: Any) -> Any:
        def generate(context: Any, builder: Any, signature: Any, operands: Any) -> Any:
            arrayobj = _arrays()
            whole, *numbers = operands
            given = zip(numbers, signature.args[1:], strict=True)
            first, length = (context.cast(builder, x, t, types.intp) for x, t in given)
            data = arrayobj.make_array(array)(context, builder, whole).data
            at = builder.gep(builder.bitcast(data, ir.IntType(8).as_pointer()), [first])
            view = arrayobj.make_array(made)(context, builder)
            size = context.get_constant(types.intp, element.bitwidth // 8)
            # It owns nothing: whoever calls the kernel holds the array.
            arrayobj.populate_array(
                view,
                data=builder.bitcast(at, view.data.type),
                shape=[length],
                strides=[size],
                itemsize=size,
                meminfo=None,
            )
            return view._getvalue()

        return made(array, start, count), generate

    return column


def _scratch(element: Any) -> Any:
    made = types.Array(element, 1, "C")

    @intrinsic
    def scratch(_: Any, count: Any) -> Any:
        def generate(context: Any, builder: Any, signature: Any, operands: Any) -> Any:
            arrayobj = _arrays()
            length = context.cast(builder, operands[0], count, types.intp)
            size = context.get_constant(types.intp, element.bitwidth // 8)
            info = context.nrt.meminfo_alloc_aligned(
                builder, builder.mul(length, size), context.get_constant(types.uint32, LINE)
            )
            view = arrayobj.make_array(made)(context, builder)
            arrayobj.populate_array(
                view,
                data=builder.bitcast(context.nrt.meminfo_data(builder, info), view.data.type),
                shape=[length],
                strides=[size],
                itemsize=size,
                meminfo=info,
            )
            return view._getvalue()

        return made(count), generate

    return scratch


def operations() -> dict[str, Any]:
    """Return all operations by their names, for a kernel's source to call."""
    named = {f"{element}_column": _column(element) for element in (types.float32, types.float64)}
    for word in (
        types.Integer.from_bitwidth(bits, signed) for bits in (8, 16, 32, 64) for signed in (False, True)
    ):
        named |= {f"{word}_{name}": _operation(make, word, word) for name, make in ARITHMETIC.items()}
        named |= {f"{word}_{name}": _operation(make, word, types.uint8) for name, make in COMPARISONS.items()}
        named |= {f"{word}_choose": _choice(word), f"{word}_column": _column(word)}
        named[f"{word}_scratch"] = _scratch(word)
    return named
