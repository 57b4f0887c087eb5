"""Operations on words of one width as plain Python, for kernels of a GPU: those of ``llvm_words``.

numba-cuda compiles them, and its simulator runs them.
"""

from __future__ import annotations

import operator
from collections.abc import Callable
from typing import Any

import numpy as np

FLAG = np.uint8

ARITHMETIC: dict[str, Callable[..., Any]] = {
    "add": operator.add,
    "sub": operator.sub,
    "mul": operator.mul,
    "and": operator.and_,
    "or": operator.or_,
    "xor": operator.xor,
    "left": operator.lshift,
    "right": operator.rshift,
    "minimum": min,
    "maximum": max,
}
COMPARISONS = {"equal": operator.eq, "differ": operator.ne, "less": operator.lt, "at_least": operator.ge}


def _operation(word: Any, make: Callable[..., Any], result: Any) -> Any:
    # Cast before as well as after: Numba makes floats of a signed and an unsigned word of 64 bits.
    return lambda a, b: result(make(word(a), word(b)))


def _choice(word: Any) -> Any:
    return lambda flag, a, b: word(a) if flag else word(b)


def operations() -> dict[str, Any]:
    """Return all operations by their names, for a kernel's source to call."""
    made: dict[str, Any] = {}
    for word in (np.int8, np.uint8, np.int16, np.uint16, np.int32, np.uint32, np.int64, np.uint64):
        name = word.__name__
        made |= {f"{name}_{key}": _operation(word, make, word) for key, make in ARITHMETIC.items()}
        made |= {f"{name}_{key}": _operation(word, make, FLAG) for key, make in COMPARISONS.items()}
        made[f"{name}_choose"] = _choice(word)
    return made
