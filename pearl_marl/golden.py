"""The vocabulary of a golden step: exact-width integers and branch-free choice.

A *golden step* is plain Python over these names. Run as it stands, on NumPy scalars or on whole
arrays, it is the reference; compiled by Numba it is the CPU device. So whatever stands here has to
mean the same in both, which leaves one rule: **cast after every operation**. Numba widens ``a + b``
to 64 bits where NumPy does not, and the cast brings both back to the same value modulo ``2**bits``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any, TypeAlias

import numpy as np

# The types of a golden step. Calling one casts, which in Numba truncates to that many bits.
u8 = np.uint8
u16 = np.uint16
u32 = np.uint32
u64 = np.uint64
i8 = np.int8
i16 = np.int16
i32 = np.int32
i64 = np.int64

Word: TypeAlias = Any
"""A scalar or an array of one of the types above, or what Numba makes of one."""

GoldenFunction: TypeAlias = Callable[..., Any]


def uniform_below(draw: Word, n: Word) -> Word:
    """Map a 32-bit draw to ``0 .. n - 1`` by multiplying and keeping the upper half.

    Parameters
    ----------
    draw
        A uniform ``u32``.
    n
        The number of outcomes, ``1 .. 2**32 - 1``.

    Returns
    -------
    ``u32`` below ``n``. An outcome's probability is off by at most ``2**-32``, so its relative
    bias is at most ``n / 2**32``: below ``2**-16`` for every ``n <= 65536``.
    """
    return u32(u64(u64(draw) * u64(n)) >> u64(32))


def call_reference(function: GoldenFunction, arguments: Iterable[Word]) -> tuple[Word, ...]:
    """Run a golden function as plain Python over scalars or arrays; always returns a tuple.

    NumPy warns where a scalar wraps around. In a golden step wrapping is the meaning, so the
    warning is switched off here.
    """
    with np.errstate(over="ignore"):
        result = function(*arguments)
    return result if isinstance(result, tuple) else (result,)
