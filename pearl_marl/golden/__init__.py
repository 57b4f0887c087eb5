"""The vocabulary of golden functions: plain Python over integers that never overflow.

A word is an integer in the sense of mathematics: ``a + b`` is the sum, however large, and a comparison is 0
or 1. Calling one of the types below is the one place where a value wraps around, modulo ``2**bits``.
``docs/golden_steps.md`` has the rest.
"""

from __future__ import annotations

import functools
import itertools
import operator
import types
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any, TypeAlias

import numpy as np

from pearl_marl.errors import ArgumentError
from pearl_marl.golden.reals.names import BUILTINS, FUNCTIONS
from pearl_marl.golden.reals.numbers import Real, constant
from pearl_marl.golden.rebinding import Vocabulary, rebound

u8 = np.uint8
u16 = np.uint16
u32 = np.uint32
u64 = np.uint64
i8 = np.int8
i16 = np.int16
i32 = np.int32
i64 = np.int64

Word: TypeAlias = Any
"""An integer of one slot: a Python ``int`` in the reference, a symbol where hardware and kernels are made."""

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
"""How many outcomes the digits of one draw have at most."""


def inserted(numbers: Sequence[Word], number: Word) -> list[Word]:
    """Put a number into its place among others, which are in order."""
    result = []
    for other in numbers:
        result.append(min(other, number))
        number = max(other, number)
    return [*result, number]


def another(draws: Draws, n: int, taken: Sequence[Word]) -> tuple[Word, list[Word]]:
    """Draw a number below ``n`` that is not taken; return it, and all that are taken then, in order."""
    number = draws.digit(n - len(taken))
    for other in taken:
        number += number >= other
    return number, inserted(taken, number)


class Draws:
    """Random numbers that a golden function asks for.

    Each request takes the next uniform ``u32`` of the step, or of the reset. So that a step always takes as
    many, ask where it is certain that the statement runs, not under an ``if`` on a word; a draw that is not
    needed costs nothing.
    """

    def __init__(self, words: Iterable[Word], fraction: int | None = None) -> None:
        self._words, self._fraction = iter(words), fraction
        self._left: Word = 0
        self._outcomes = OUTCOMES

    def bits(self, count: int = 32) -> Word:
        """Return a uniform number of so many bits, 1 to 32."""
        if not isinstance(count, int) or not 1 <= count <= 32:
            raise ArgumentError(f"draws.bits({count!r}): a draw has 1 to 32 bits")
        try:
            word = next(self._words)
        except StopIteration:
            raise ArgumentError(f"a golden function asks for more than {MOST_DRAWS} draws") from None
        _asked(word)
        return word >> (32 - count)

    def below(self, n: Word) -> Word:
        """Return a number from 0 to ``n - 1``, ``n`` up to ``2**32 - 1``.

        An outcome's probability is off by at most ``2**-32``. Where ``n`` is a word and 0, the number is 0.
        """
        draw = self.bits()
        if hasattr(draw, "asked") and not hasattr(n, "asked") and n < 1:  # of the reference, all are numbers
            raise ArgumentError(f"draws.below({n}) asks for a number from 0 to {n - 1}; it takes 1 or more")
        return draw * n >> 32

    def chance(self, numerator: float, denominator: float = 1) -> Word:
        """Return 1 with a probability, such as ``chance(0.3)`` or ``chance(1, 3)``.

        It is rounded to a multiple of ``2**-32``.
        """
        if hasattr(numerator, "asked") or hasattr(denominator, "asked"):
            raise ArgumentError(
                "draws.chance() takes numbers, and a word is none yet; draws.below(n) < word is such a chance"
            )
        share = numerator / denominator
        if not 0 <= share <= 1:
            raise ArgumentError(f"draws.chance({numerator!r}, {denominator!r}): a probability is 0 to 1")
        return self.bits() < round(share * 2**32)

    def uniform(self, low: float, high: float) -> Real:
        """Return a real number from ``low`` to below ``high``; for environments whose state has reals."""
        if not (isinstance(low, _NUMBERS) and isinstance(high, _NUMBERS)):
            raise ArgumentError(
                f"draws.uniform({low!r}, {high!r}) takes two numbers; scale what draws.uniform(0, 1) returns"
            )
        if self._fraction is None:
            raise ArgumentError("draws.uniform() makes a real, and the state has none, such as Real[-1, 1]")
        first, end = constant(low, self._fraction), constant(high, self._fraction)
        if first >= end:
            raise ArgumentError(f"draws.uniform({low!r}, {high!r}): the first is the least")
        return Real(first + (self.bits() * (end - first) >> 32), self._fraction)

    def choice(self, options: Sequence[Any]) -> Any:
        """Return one of several, all equally likely."""
        return _entry(options, self.below(len(options)))

    def permutation(self, n: int) -> list[Word]:
        """Return the numbers from 0 to ``n - 1`` in any order, all equally likely; takes ``n - 1`` draws."""
        result: list[Word] = [0] * min(n, 1)
        for k in range(1, n):
            place = self.below(k + 1)
            # The number in that place moves to the end, and this one takes it.
            last = _entry([*result, k], place)
            # Chosen, not computed, so that each is known to be one of them.
            result = [_entry([old, k], place == i) for i, old in enumerate(result)]
            result.append(last)
        return result

    def digit(self, n: Word, most: int | None = None) -> Word:
        """Return a number below ``n``, of the same draw as the digits before as long as that suffices.

        It suffices for up to 65,536 outcomes of all of them together, so that each is off by less than
        ``2**-16`` of its probability. Where ``n`` is a word, ``most`` is the most that it can be.
        """
        most = n if most is None else most
        self._outcomes *= most
        if self._outcomes > OUTCOMES:
            self._left, self._outcomes = self.bits(), most
        _asked(self._left)
        # The upper half of the product is the digit; the lower half serves as the next draw.
        product = self._left * n
        self._left = product & 0xFFFFFFFF
        return product >> 32

    def several(self, *outcomes: int) -> list[Word]:
        """Return a number below each of ``outcomes``, as :meth:`digit` makes them."""
        return [self.digit(n) for n in outcomes]


_NUMBERS = int, float, np.integer, np.floating


class CountingDraws(Draws):
    """Draws that are all 0, and counted."""

    def __init__(self, fraction: int | None = None) -> None:
        self.count = 0
        super().__init__(self._zeros(), fraction)

    def _zeros(self) -> Iterator[int]:
        while True:
            self.count += 1
            yield 0


MOST_DRAWS = 256
"""Draws of a reset, or of a step."""


def _asked(word: Word) -> None:
    """Let a symbol say whether it may be asked for."""
    if hasattr(word, "asked"):
        word.asked()


def _entry(entries: Sequence[Any], place: Word) -> Any:
    """Return an entry that a word chooses."""
    return place.entry(entries) if hasattr(place, "entry") else entries[place]


class _Wrap:
    """A type of NumPy's, called: its value modulo ``2**bits``."""

    def __init__(self, dtype: type[np.integer[Any]]) -> None:
        self.low, self.count = int(np.iinfo(dtype).min), 1 << np.dtype(dtype).itemsize * 8

    def __call__(self, value: Any = 0) -> int:
        return (int(value) - self.low) % self.count + self.low


PLAIN = Vocabulary(_Wrap, lambda values: values)
"""What golden functions name, on Python's integers."""


def as_python_runs_it(function: GoldenFunction, reals: bool = False) -> GoldenFunction:
    """Return a golden function on Python's integers: itself, with casts that wrap, and functions of reals."""
    if not isinstance(function, types.FunctionType):
        return function
    if reals or hasattr(function, "admits"):
        return rebound(function, PLAIN._replace(functions=FUNCTIONS).meaning, names=BUILTINS)  # type: ignore[no-any-return]
    return rebound(function, PLAIN.meaning)  # type: ignore[no-any-return]


def reference(function: GoldenFunction, *agent: int) -> Callable[..., tuple[Any, ...]]:
    """Return what runs a golden function itself, as Python runs it, and always returns a tuple.

    Arguments are numbers, or arrays of any shapes that go together: then the function runs for one element
    after the other, and results are arrays. ``agent`` is what :attr:`pearl_marl.spec.EnvSpec.views` has for
    it, the last argument of a function that tells what one agent of a world sees.
    Results are NumPy's integers of 64 bits; where those do not hold one, Python's integers.
    """
    again = as_python_runs_it(function)

    @functools.lru_cache(1 << 14)
    def once(*words: int) -> tuple[int, ...]:
        result = again(*words, *agent)
        return tuple(map(operator.index, result if isinstance(result, (tuple, list)) else (result,)))

    def run(*arguments: Any) -> tuple[Any, ...]:
        arrays = [np.asarray(argument) for argument in arguments]
        shape = np.broadcast_shapes(*(array.shape for array in arrays))
        if not shape:
            return tuple(_array([word])[0] for word in once(*(int(array[()]) for array in arrays)))
        columns = (np.broadcast_to(array, shape).ravel().tolist() for array in arrays)
        results = zip(*itertools.starmap(once, zip(*columns, strict=True)), strict=True)
        return tuple(_array(column).reshape(shape) for column in results)

    return run


def _array(words: Sequence[int]) -> Any:
    """Return an array of 64 bits, or of Python's integers where those do not hold them."""
    low, high = min(words), max(words)
    if low >= -(1 << 63) and high < 1 << 64 and (low >= 0 or high < 1 << 63):
        return np.array(words, np.int64 if high < 1 << 63 else np.uint64)
    return np.array(words, object)


def call_reference(function: GoldenFunction, arguments: Iterable[Any], *agent: int) -> tuple[Any, ...]:
    """Call :func:`reference` of a golden function once."""
    return reference(function, *agent)(*arguments)
