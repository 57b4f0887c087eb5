"""The functions of :mod:`pearl_marl.planes` for kernels of a CPU.

LLVM turns a loop over bits into a 64-bit shift for each of them. Widening a vector of bits to bytes takes an
instruction or two. Few places of a plane are taken: a loop over those is shorter than one over the board.
"""

from __future__ import annotations

import types as python_types
from typing import Any

import numba
import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from pearl_marl.compiler.llvm_words import BYTES
from pearl_marl.planes import interleave, mark, mark_moving

BITS = 64


@intrinsic(prefer_literal=True)
def _interleave(_: Any, first: Any, second: Any, count: Any, row: Any) -> Any:
    bits = count.literal_value

    def generate(context: Any, builder: Any, signature: Any, operands: Any) -> Any:
        planes = [
            _bytes(builder, context.cast(builder, board, of, types.uint64))
            for board, of in zip(operands[:2], signature.args[:2], strict=True)
        ]
        data = builder.bitcast(context.make_array(row)(context, builder, operands[3]).data, BYTES)
        start = 0
        while start < 2 * bits:
            size = min(BITS, 1 << (2 * bits - start).bit_length() - 1)
            order = [place // 2 + BITS * (place % 2) for place in range(start, start + size)]
            part = builder.shuffle_vector(*planes, ir.Constant(ir.VectorType(ir.IntType(32), size), order))
            at = builder.gep(data, [ir.IntType(64)(start)])
            builder.store(part, builder.bitcast(at, part.type.as_pointer()), align=1)
            start += size
        return context.get_dummy_value()

    return types.none(first, second, count, row), generate


def _bytes(builder: Any, board: Any) -> Any:
    """Return a byte for each bit."""
    bits = builder.bitcast(board, ir.VectorType(ir.IntType(1), BITS))
    return builder.zext(bits, ir.VectorType(ir.IntType(8), BITS))


_inlined = numba.njit(forceinline=True)


@_inlined
def _number(planes: Any, bit: Any) -> Any:
    number = 0
    for k in range(len(planes)):
        number += 1 << k if np.uint64(planes[k]) & bit else 0
    return number


@_inlined
def _set(y: Any, x: Any, cells: Any, channel: Any, row: Any) -> None:
    if y < cells.lines and 0 <= x < cells.columns:
        row[cells.first + (y * cells.columns + x) * cells.channels + channel] = 1


@_inlined
def _mark(places: Any, line: Any, column: Any, beside: Any, cells: Any, channel: Any, row: Any) -> None:
    left = np.uint64(places)
    while left:
        bit = left & (~left + np.uint64(1))
        left ^= bit
        _set(_number(line, bit), _number(column, bit) + beside, cells, channel, row)


@_inlined
def _mark_moving(
    places: Any, second: Any, rightward: Any, line: Any, column: Any, cells: Any, channels: Any, row: Any
) -> None:
    left = np.uint64(places)
    while left:
        bit = left & (~left + np.uint64(1))
        left ^= bit
        y, x = _number(line, bit), _number(column, bit)
        _set(y, x, cells, channels[1] if np.uint64(second) & bit else channels[0], row)
        _set(y, x - 1 if np.uint64(rightward) & bit else x + 1, cells, channels[2], row)


REPLACEMENTS: dict[python_types.FunctionType, Any] = {
    interleave: _interleave,  # type: ignore[dict-item]
    mark: _mark,  # type: ignore[dict-item]
    mark_moving: _mark_moving,  # type: ignore[dict-item]
}
"""What kernels call, by the function that an environment names."""
