"""Real numbers of golden functions: fixed point, of one fraction in a whole environment.

The reference computes with Python's integers, tracing with words; both run the lines below. No format and
no result depends on the range of a word or on which branch was taken, so that all devices agree to the bit.
"""

from __future__ import annotations

import functools
import math
import operator
from collections.abc import Callable, Iterable
from typing import Any

import numpy as np

from pearl_marl.errors import ArgumentError
from pearl_marl.golden.reals import functions
from pearl_marl.golden.reals.words import (
    TooWideError,
    absolute,
    either,
    fits,
    greatest,
    least,
    limits,
    narrowed,
    noted,
    product,
)
from pearl_marl.golden.tracing.words import Beyond, Word

FIELD_BITS = 32
MOST_FRACTION, LEAST_FRACTION = 30, 8
SIGNIFICANT = 30
"""Bits of a constant that a real is multiplied by."""

NUMPY: dict[Any, Callable[..., Any]] = {}
"""What takes the place of a function of NumPy's; :mod:`pearl_marl.golden.reals.names` fills it."""


class Number(Beyond):
    """A number that NumPy's functions take."""

    __slots__ = ()
    __hash__ = None  # type: ignore[assignment]
    __array_priority__ = 2000

    def __array_ufunc__(self, ufunc: Any, method: str, *inputs: Any, **keywords: Any) -> Any:
        if method != "__call__":
            raise ArgumentError(f"golden functions have no np.{ufunc.__name__}.{method}")
        return _called(ufunc, inputs, keywords)

    def __array_function__(self, function: Any, types: Any, args: Any, keywords: Any) -> Any:
        return _called(function, args, keywords)


def _called(function: Any, arguments: Any, keywords: Any) -> Any:
    if function not in NUMPY or keywords:
        raise ArgumentError(f"golden functions have no np.{function.__name__} of reals")
    # The operators of NumPy's numbers would come back here.
    return NUMPY[function](*(x.item() if isinstance(x, (np.generic, np.ndarray)) else x for x in arguments))


def fraction_for(bounds: Iterable[tuple[float, float]]) -> int:
    """Return the fraction bits of an environment: the most, up to 30, that its fields allow.

    Parameters
    ----------
    bounds
        The least and the greatest value of every field; each has to fit a signed 32-bit word.

    Raises
    ------
    ArgumentError
        A bound is not finite, or too great to leave 8 fraction bits.
    """
    ends = [float(end) for pair in bounds for end in pair]
    if not all(math.isfinite(end) for end in ends):
        raise ArgumentError(
            "a real's bounds are finite: give the range that matters, beyond which it saturates"
        )
    most = 1 << FIELD_BITS - 1
    for fraction in range(MOST_FRACTION, LEAST_FRACTION - 1, -1):
        if all(-most <= constant(end, fraction) < most for end in ends):
            return fraction
    raise ArgumentError(
        f"reals from {min(ends):g} to {max(ends):g} leave fewer than {LEAST_FRACTION} of {FIELD_BITS} bits "
        "to fractions; measure in a larger unit"
    )


@functools.lru_cache(1 << 12)
def constant(value: float, fraction: int) -> int:
    """Return the word of a constant.

    Raises
    ------
    ArgumentError
        The constant is infinite or no number.
    """
    if not math.isfinite(value):
        raise ArgumentError(f"a real is finite, and {value} is not")
    return round(math.ldexp(value, fraction))


@functools.lru_cache(1 << 12)
def factor(value: float) -> tuple[int, int]:
    """Return a constant as a factor and the shift to the right that comes after it: -1023 to 62.

    The factor has 30 bits, or fewer if those are exact, so that 0.02 is as exact as 1.02.

    Raises
    ------
    ArgumentError
        The constant is infinite or no number.
    """
    if value == 0:
        return 0, 0
    shift = min(SIGNIFICANT - math.frexp(value)[1], 62) if math.isfinite(value) else 0
    whole = constant(value, shift)
    spare = (whole & -whole).bit_length() - 1 if whole else 0
    return whole >> spare, shift - spare


def _like(make: Callable[[Real, Real], Any]) -> Callable[[Any, object], Any]:
    """Return an operator: it makes a real of the other number, too, and a result of both."""

    def method(self: Real, other: object) -> Any:
        known = self.like(other)
        return NotImplemented if known is None else make(self, known)

    return method


class Real(Number):
    """A real number: ``word * 2**-fraction``.

    Sums are exact; products, quotients and functions are rounded, once each, to the same fraction. Constants
    are Python's floats, rounded where they are added or compared, and of 30 significant bits where they are
    factors. A word may have 64 bits; the field that a real is kept in saturates:
    :func:`pearl_marl.golden.reals.choices.stored`.
    """

    __slots__ = ("fraction", "word")

    def __init__(self, word: Any, fraction: int) -> None:
        self.word: Any = word
        self.fraction = fraction
        if not isinstance(word, Word):
            self.word = int(word)  # not NumPy's, which overflow
        elif not fits(*limits(word)):
            raise self._too_great(*limits(word))

    @staticmethod
    def of(value: object, fraction: int) -> Real:
        """Return a number as a real.

        Raises
        ------
        ArgumentError
            It is no number, or not finite.
        """
        found = Real(0, fraction).like(value)
        if found is None:
            raise ArgumentError(f"{value!r} is no number")
        return found

    def like(self, other: object) -> Real | None:
        """Return a real, float or integer as a real of the same fraction; of anything else None."""
        if isinstance(other, Real):
            if other.fraction != self.fraction:
                raise ArgumentError(f"reals of {self.fraction} and {other.fraction} fraction bits meet")
            return other
        if isinstance(other, (float, np.floating)):
            return Real(constant(float(other), self.fraction), self.fraction)
        whole = integer(other)
        return None if whole is None else Real(whole << self.fraction, self.fraction)

    def _too_great(self, low: int, high: int) -> ArgumentError:
        ends = [f"{end / 2**self.fraction:.4g}" for end in (low, high, 1 << 63)]
        return ArgumentError(
            f"this can be {ends[0]} to {ends[1]}, and reals end at {ends[2]} here, as they have "
            f"{self.fraction} fraction bits; np.clip what it is made of"
        )

    def _made(self, function: Callable[..., Any], *words: Any) -> Real:
        try:
            return Real(function(*map(narrowed, words)), self.fraction)
        except TooWideError as error:
            raise self._too_great(error.low, error.high) from None

    # Sums and comparisons.

    __add__ = __radd__ = _like(lambda a, b: Real(a.word + b.word, a.fraction))
    __sub__ = _like(lambda a, b: Real(a.word - b.word, a.fraction))
    __rsub__ = _like(lambda a, b: Real(b.word - a.word, a.fraction))

    def __neg__(self) -> Real:
        return Real(-self.word, self.fraction)

    def __pos__(self) -> Real:
        return self

    def __abs__(self) -> Real:
        return Real(absolute(self.word), self.fraction)

    __lt__ = _like(lambda a, b: a.word < b.word)
    __le__ = _like(lambda a, b: a.word <= b.word)
    __gt__ = _like(lambda a, b: a.word > b.word)
    __ge__ = _like(lambda a, b: a.word >= b.word)
    __eq__ = _like(lambda a, b: a.word == b.word)
    __ne__ = _like(lambda a, b: a.word != b.word)

    def __bool__(self) -> bool:
        return bool(self.word != 0)

    # Products and quotients.

    def __mul__(self, other: object) -> Any:
        if isinstance(other, (float, np.floating)):
            return self.times(*factor(float(other)))
        if isinstance(other, Real):
            known = self.like(other)
            assert known is not None
            return self._made(product, self.word, known.word, self.fraction)
        whole = integer(other)
        return NotImplemented if whole is None else self.times(whole, 0)

    __rmul__ = __mul__

    def times(self, whole: Any, shift: int) -> Real:
        """Return the product with ``whole * 2**-shift``, a number or a word."""
        if shift < 0:
            whole, shift = whole << -shift, 0
        return self._made(product, self.word, whole, shift)

    def __truediv__(self, other: object) -> Any:
        if isinstance(other, (float, np.floating)):
            return self * (1 / float(other))
        known = self.like(other)
        return NotImplemented if known is None else self._quotient(self.word, known.word)

    __rtruediv__ = _like(lambda a, b: a._quotient(b.word, a.word))

    def _quotient(self, numerator: Any, divisor: Any) -> Real:
        return self._made(functions.quotient, numerator, divisor, self.fraction)

    def __floordiv__(self, other: object) -> Any:
        known = self._divisor(other, "//")
        return known if known is NotImplemented else Real(self.word // known << self.fraction, self.fraction)

    def __mod__(self, other: object) -> Any:
        known = self._divisor(other, "%")
        return known if known is NotImplemented else Real(remainder(self.word, known), self.fraction)

    __rfloordiv__ = _like(lambda a, b: b // a)
    __rmod__ = _like(lambda a, b: b % a)

    def __divmod__(self, other: object) -> Any:
        return self // other, self % other

    def _divisor(self, other: object, operation: str) -> Any:
        """Return the word of a divisor that leaves a remainder."""
        known = self.like(other)
        if known is None:
            return NotImplemented
        if isinstance(known.word, Word) or known.word < 1:
            raise ArgumentError(f"`{operation}` of a real takes a constant above 0")
        return known.word

    def __pow__(self, exponent: object) -> Real:
        if isinstance(exponent, float) and exponent == 0.5:
            return self.sqrt()
        if isinstance(exponent, (int, float)) and exponent == math.floor(exponent):
            if exponent < 0:
                found: Real = 1.0 / self**-exponent
                return found
            return self._power(int(exponent))
        raise ArgumentError(f"a real to the power {exponent!r}: possible are whole numbers and 0.5")

    def _power(self, exponent: int) -> Real:
        """Return a whole power; even ones are squares, so that they are known not to be negative."""
        if exponent < 2:
            return self if exponent else Real.of(1, self.fraction)
        part = self._power(exponent // 2) if exponent % 2 == 0 else self._power(exponent - 1)
        found: Real = part * (self if exponent % 2 else part)
        return found

    # Functions.

    def sin(self) -> Real:
        """Return the sine of an angle in radians."""
        return self._made(functions.sine, self.word, self.fraction)

    def cos(self) -> Real:
        """Return the cosine of an angle in radians."""
        return self._made(functions.cosine, self.word, self.fraction)

    def sqrt(self) -> Real:
        """Return the square root.

        Raises
        ------
        ValueError
            The number is negative.
        ArgumentError
            It is traced and can be negative.
        """
        return self._made(functions.square_root, self.word, self.fraction)

    def exp(self) -> Real:
        """Return ``e`` to this power."""
        return self._made(functions.exponential, self.word, self.fraction, self.fraction)

    def tanh(self) -> Real:
        """Return the hyperbolic tangent."""
        return self._made(functions.hyperbolic_tangent, self.word, self.fraction)

    def minimum(self, other: object) -> Real:
        """Return the less of two."""
        return Real(least(self.word, Real.of(other, self.fraction).word), self.fraction)

    def maximum(self, other: object) -> Real:
        """Return the greater of two."""
        return Real(greatest(self.word, Real.of(other, self.fraction).word), self.fraction)

    # To integers.

    def __floor__(self) -> Any:
        return self.word >> self.fraction

    def __ceil__(self) -> Any:
        return -((-self.word) >> self.fraction)

    def __trunc__(self) -> Any:
        return either(self.word < 0, self.__ceil__(), self.__floor__())

    def __round__(self, digits: None = None) -> Any:
        if digits is not None:
            raise ArgumentError("reals are rounded to integers, not to decimals")
        half = 1 << self.fraction - 1
        nearest = (self.word + half) >> self.fraction
        tie = (self.word & ((1 << self.fraction) - 1)) == half
        return nearest - (tie & (nearest & 1))  # halves to the even one, as Python does

    def __int__(self) -> int:
        return operator.index(self.__trunc__())

    def __float__(self) -> float:
        if isinstance(self.word, Word):
            raise ArgumentError("float() of a real; it has no value before hardware runs")
        return float(math.ldexp(self.word, -self.fraction))

    def __repr__(self) -> str:
        if isinstance(self.word, Word):
            return "a real"
        return f"Real({float(self)!r}, fraction={self.fraction})"

    def __format__(self, specification: str) -> str:
        if isinstance(self.word, Word):
            raise ArgumentError("a real becomes text, and it has no value before hardware runs")
        return format(float(self), specification)


def integer(value: object) -> Any:
    """Return an integer, a flag or a word as an integer or a word; of anything else None."""
    if isinstance(value, Word):
        return value
    if isinstance(value, (int, np.integer, np.bool_)):
        return int(value)
    return None


def remainder(word: Any, divisor: int) -> Any:
    """Return ``word % divisor``; without a division where few quotients are possible."""
    low, high = (end // divisor for end in limits(word))
    if not isinstance(word, Word) or high - low > 3:
        return word % divisor
    rest: Any = word - low * divisor
    for _ in range(high - low):
        rest = either(rest < divisor, rest, rest - divisor)
    rest = rest & ((1 << divisor.bit_length()) - 1)
    return noted(rest, 0, divisor - 1)
