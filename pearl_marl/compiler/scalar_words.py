"""Operations on words of one width as plain Python, for kernels of a GPU: those of ``llvm_words``.

numba-cuda compiles them, and its simulator runs them.
"""

from __future__ import annotations

from typing import Any

import numpy as np

FLAG = np.uint8


def _operations(word: Any) -> list[Any]:
    # Cast before as well as after: Numba makes floats of a signed and an unsigned word of 64 bits.
    def add(a, b):  # type: ignore[no-untyped-def]
        return word(word(a) + word(b))

    def sub(a, b):  # type: ignore[no-untyped-def]
        return word(word(a) - word(b))

    def mul(a, b):  # type: ignore[no-untyped-def]
        return word(word(a) * word(b))

    def and_(a, b):  # type: ignore[no-untyped-def]
        return word(word(a) & word(b))

    def or_(a, b):  # type: ignore[no-untyped-def]
        return word(word(a) | word(b))

    def xor(a, b):  # type: ignore[no-untyped-def]
        return word(word(a) ^ word(b))

    def left(a, b):  # type: ignore[no-untyped-def]
        return word(word(a) << word(b))

    def right(a, b):  # type: ignore[no-untyped-def]
        return word(word(a) >> word(b))

    def minimum(a, b):  # type: ignore[no-untyped-def]
        return min(word(a), word(b))

    def maximum(a, b):  # type: ignore[no-untyped-def]
        return max(word(a), word(b))

    def equal(a, b):  # type: ignore[no-untyped-def]
        return FLAG(word(a) == word(b))

    def differ(a, b):  # type: ignore[no-untyped-def]
        return FLAG(word(a) != word(b))

    def less(a, b):  # type: ignore[no-untyped-def]
        return FLAG(word(a) < word(b))

    def at_least(a, b):  # type: ignore[no-untyped-def]
        return FLAG(word(a) >= word(b))

    def choose(flag, a, b):  # type: ignore[no-untyped-def]
        return word(a) if flag else word(b)

    return [
        *(add, sub, mul, and_, or_, xor, left, right, minimum, maximum),
        *(equal, differ, less, at_least, choose),
    ]


def operations() -> dict[str, Any]:
    """Return all operations by their names, for a kernel's source to call."""
    return {
        f"{word.__name__}_{function.__name__.rstrip('_')}": function
        for word in (np.int8, np.uint8, np.int16, np.uint16, np.int32, np.uint32, np.int64, np.uint64)
        for function in _operations(word)
    }
