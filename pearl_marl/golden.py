"""The vocabulary of golden functions: plain Python over integers that never overflow.

A word is an integer in the sense of mathematics: ``a + b`` is the sum, however large, and a comparison is 0
or 1. Calling one of the types below is the one place where a value wraps around, modulo ``2**bits``. Of NumPy
there are ``where``, ``minimum``, ``maximum`` and ``clip``. ``docs/golden_steps.md`` has the rest.
"""

from __future__ import annotations

import types
from collections.abc import Callable, Iterable, Sequence
from typing import Any, TypeAlias

import numpy as np

from pearl_marl.integers import VOCABULARY, Integers
from pearl_marl.remaking import remade

u8 = np.uint8
u16 = np.uint16
u32 = np.uint32
u64 = np.uint64
i8 = np.int8
i16 = np.int16
i32 = np.int32
i64 = np.int64

Word: TypeAlias = Any
"""An integer of one slot; whoever runs a golden function decides what stands for it."""

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
    # Outside of golden functions it is called with NumPy's words, which do overflow: hence the casts.
    return u32((u64(draw) * u64(n)) >> u64(32))


OUTCOMES = 1 << 16
"""How many outcomes one draw decides at most: each is off by less than ``2**-16`` of its probability."""


def draws_of(outcomes: Iterable[int]) -> list[int]:
    """Return which draw makes each of several decisions, given how many outcomes each has."""
    draw, together, result = 0, 1, []
    for n in outcomes:
        together *= n
        if together > OUTCOMES:
            draw, together = draw + 1, n
        result.append(draw)
    return result


def digits(draws: Iterable[Word], outcomes: Sequence[int]) -> list[Word]:
    """Return several decisions, each below its number of outcomes, of the draws that :func:`draws_of` tells.

    The upper half of a product is one; its lower half serves as the next draw.
    """
    left, result = list(draws), []
    for n, k in zip(outcomes, draws_of(outcomes), strict=True):
        product = left[k] * n
        left[k] = u32(product)
        result.append(product >> 32)
    return result


def another(rank: Word, taken: Sequence[Word]) -> Word:
    """Return the number of this rank among those that are not taken; ``taken`` is in order."""
    for number in taken:
        rank = rank + (rank >= number)
    return rank


def inserted(numbers: Sequence[Word], number: Word) -> list[Word]:
    """Put a number into its place among others, which are in order."""
    result = []
    for other in numbers:
        result.append(np.minimum(other, number))
        number = np.maximum(other, number)
    return [*result, number]


def reference(function: GoldenFunction, *agent: int) -> Callable[..., tuple[Any, ...]]:
    """Return what runs a golden function itself on numbers or whole arrays, and always returns a tuple.

    ``agent`` is what :attr:`pearl_marl.spec.EnvSpec.views` has for it, the last argument of a function that
    tells what one agent of a world sees.
    Results are NumPy's integers or arrays of 64 bits; where those do not hold one, Python's integers.
    """
    again = remade(function, VOCABULARY.meaning) if isinstance(function, types.FunctionType) else function

    def run(*arguments: Any) -> tuple[Any, ...]:
        result = again(*map(Integers.of, arguments), *agent)
        words = result if isinstance(result, tuple) else (result,)
        return tuple(Integers.of(word).wide() for word in words)

    return run


def call_reference(function: GoldenFunction, arguments: Iterable[Any], *agent: int) -> tuple[Any, ...]:
    """Call :func:`reference` of a golden function once."""
    return reference(function, *agent)(*arguments)
