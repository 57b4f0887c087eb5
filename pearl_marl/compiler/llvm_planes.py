""":func:`pearl_marl.planes.interleave` for kernels of a CPU.

LLVM turns a loop over bits into a 64-bit shift for each of them. Widening a vector of bits to bytes takes an
instruction or two.
"""

from __future__ import annotations

import types as python_types
from typing import Any

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from pearl_marl.compiler.llvm_words import BYTES, arrays
from pearl_marl.planes import interleave

BITS = 64


@intrinsic(prefer_literal=True)
def _interleave(_: Any, first: Any, second: Any, count: Any, row: Any) -> Any:
    bits = count.literal_value

    def generate(context: Any, builder: Any, signature: Any, operands: Any) -> Any:
        planes = [
            _bytes(builder, context.cast(builder, board, of, types.uint64))
            for board, of in zip(operands[:2], signature.args[:2], strict=True)
        ]
        data = builder.bitcast(arrays().make_array(row)(context, builder, operands[3]).data, BYTES)
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


REPLACEMENTS: dict[python_types.FunctionType, Any] = {interleave: _interleave}  # type: ignore[dict-item]
"""What kernels call, by the function that an environment names."""
