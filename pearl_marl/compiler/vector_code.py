"""Functions for compiled loops that are made of LLVM's instructions, on vectors.

Numba does not keep a block of sums in registers by itself.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import wraps
from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

BYTE, WORD, INDEX = map(ir.IntType, (8, 32, 64))

LANES = 16
"""Numbers of a vector, where nothing else is said: of floats, and of words of 32 bits."""

_intrinsic: Any = intrinsic
_cgutils: Any = cgutils
_tuple: Any = types.BaseTuple


class VectorCode:
    """The code of a function that is being made.

    ``operands`` is what the function is called with: of arrays, pointers to their data; of tuples, lists.
    """

    def __init__(self, builder: Any, operands: list[Any]) -> None:
        self.builder, self.operands = builder, operands

    def plus(self, index: Any, more: int) -> Any:
        """Return an index so many elements further."""
        return self.builder.add(index, INDEX(more))

    def times(self, index: Any, number: int) -> Any:
        """Return an index so many times."""
        return self.builder.mul(index, INDEX(number))

    def _pointer(self, array: Any, index: Any, kind: Any) -> tuple[Any, int]:
        """Return a pointer to a vector, or an element, and its alignment: that of a byte, or of a word."""
        pointer = self.builder.gep(array, [index])
        return self.builder.bitcast(pointer, kind.as_pointer()), 1 if array.type.pointee == BYTE else 4

    def load(self, array: Any, index: Any, kind: Any = None) -> Any:
        """Load a vector, or something of another kind, from an index of an array."""
        kind = kind or ir.VectorType(array.type.pointee, LANES)
        pointer, align = self._pointer(array, index, kind)
        return self.builder.load(pointer, align=align)

    def store(self, value: Any, array: Any, index: Any) -> None:
        """Store a vector, or an element, at an index of an array."""
        pointer, align = self._pointer(array, index, value.type)
        self.builder.store(value, pointer, align=align)

    def shuffled(self, vectors: Sequence[Any], order: list[int]) -> Any:
        """Return elements of two vectors, one after the other, in an order."""
        return self.builder.shuffle_vector(*vectors, ir.Constant(ir.VectorType(WORD, len(order)), order))

    def spread(self, number: Any) -> Any:
        """Return a vector of the same number."""
        empty = ir.Constant(ir.VectorType(number.type, LANES), ir.Undefined)
        return self.shuffled((self.builder.insert_element(empty, number, WORD(0)), empty), [0] * LANES)

    def factor(self, array: Any, index: Any) -> Any:
        """Return a vector of the same element of an array."""
        return self.spread(self.load(array, index, array.type.pointee))

    def plus_product(self, total: Any, numbers: Any, factors: Any) -> Any:
        """Return sums with products added; processors that can do both at once round once."""
        fused = ("contract",)
        return self.builder.fadd(total, self.builder.fmul(factors, numbers, flags=fused), flags=fused)

    def variable(self, first: Any) -> Any:
        """Return a variable, which begins with a value; LLVM keeps it in a register."""
        return _cgutils.alloca_once_value(self.builder, first)

    @contextmanager
    def each(self, count: Any, step: int = 1) -> Iterator[Any]:
        """Make a loop of what is made in this context, with an index from 0 on."""
        with _cgutils.for_range_slice(self.builder, INDEX(0), count, INDEX(step), INDEX) as (index, _):
            yield index


def constant(vector: Any, number: float) -> Any:
    """Return a vector of a kind, of the same number."""
    return ir.Constant(vector, [number] * vector.count)


def function_of(write: Callable[..., Any], result: Any = types.none) -> Any:
    """Return a function for compiled loops, whose code ``write`` makes.

    ``write`` is called with the code, and what the function is called with; it returns a value of the type
    ``result``, if any.
    """

    @wraps(write)
    def typed(_: Any, *kinds: Any) -> Any:
        def generate(context: Any, builder: Any, signature: Any, operands: Any) -> Any:
            def opened(kind: Any, value: Any) -> Any:
                if isinstance(kind, types.Array):
                    return context.make_array(kind)(context, builder, value).data
                if not isinstance(kind, _tuple):
                    return value
                return [opened(own, builder.extract_value(value, k)) for k, own in enumerate(kind)]

            arguments = [opened(*pair) for pair in zip(signature.args, operands, strict=True)]
            made = write(VectorCode(builder, arguments), *arguments)
            return context.get_dummy_value() if made is None else made

        return result(*map(types.unliteral, kinds)), generate

    return _intrinsic(typed)
