"""Elementary functions of words that stand for reals: ``word * 2**-fraction``.

They take and return words, of Python's integers or of a graph, and use no floats. ``docs/reals.md`` has the
measured errors.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from pearl_marl.errors import ArgumentError
from pearl_marl.golden.reals.words import (
    absolute,
    either,
    greatest,
    kept,
    least,
    limits,
    noted,
    product,
    rounded,
    scaled,
    shifted_product,
)
from pearl_marl.golden.tracing.words import Word

ONE = 1 << 30

# sin(pi/4 y) = y * (S_1 + ... + S_9 y**8) and cos(pi/4 y) = 1 + C_2 y**2 + ... + C_8 y**8 for y in -1 .. 1,
# times 2**31, and exp(x) = E_0 + ... + E_7 x**7 for x in -0.3467 .. 0.3467, times 2**30: least squares over
# 4,000 Chebyshev nodes, of exp's relative error. They are 1.7e-12, 1e-10 and 4e-11 off.
SINE = 663, -78537, 5348077, -173399666, 1686629713
COSINE = 7583, -699954, 34046909, -662337936, 1 << 31
EXPONENTIAL = 212245, 1497674, 8948112, 44738769, 178956953, 536870923, ONE, ONE

TURN = round(2**33 / (2 * math.pi))
"""Radians to turns, with 33 fraction bits; it is 1.1e-10 off, relatively."""

# 1 / (1 + y), y in 0 .. 1, is (576 - 544 y + 384 y**2 - 128 y**3) / 577 within 1/577, relatively: the cubic
# of least relative error, which is the fourth Chebyshev polynomial. With 16 fraction bits.
GUESS = tuple(round(k / 577 * 2**16) for k in (-128, 384, -544, 576))

DEEPEST = -32
"""From here down ``exp`` is 0 in every format."""


def _polynomial(x: Any, coefficients: tuple[int, ...], shift: int) -> Any:
    """Return a polynomial of a word with ``shift`` fraction bits; highest power first."""
    result: Any = coefficients[0]
    for coefficient in coefficients[1:]:
        result = product(x, result, shift) + coefficient
    return result


class _Angle(NamedTuple):
    """Sine and cosine of a place in a quadrant, with 31 fraction bits, and which quadrant that is."""

    sine: Any
    cosine: Any
    odd: Any
    lower: Any


def _angle(word: Any, fraction: int) -> _Angle:
    turns = product(word, TURN, fraction - 1)  # with 34 fraction bits
    turned = (turns + (1 << 31)) & ((1 << 34) - 1)  # by an eighth, so that quadrants begin where they are cut
    y = (turned & ((1 << 32) - 1)) - (1 << 31)  # eighths of a turn with 31 fraction bits, -1 .. 1
    square = product(y, y, 32)  # with 30: more would not fit 32 bits with a sign
    sine = product(y, _polynomial(square, SINE, 30), 31)
    return _Angle(sine, _polynomial(square, COSINE, 30), (turned >> 32) & 1, turned >> 33)


def sine(word: Any, fraction: int) -> Any:
    """Return the sine of an angle in radians, from which whole turns are taken; with the same fraction."""
    angle = _angle(word, fraction)
    size = either(angle.odd == 1, angle.cosine, angle.sine)
    return rounded(either(angle.lower == 1, -size, size), 31 - fraction)


def cosine(word: Any, fraction: int) -> Any:
    """Return the cosine of an angle in radians, from which whole turns are taken; with the same fraction."""
    angle = _angle(word, fraction)
    size = either(angle.odd == 1, angle.sine, angle.cosine)
    return rounded(either((angle.lower ^ angle.odd) == 1, -size, size), 31 - fraction)


def reciprocal(y: Any) -> Any:
    """Return ``1 / (1 + y)``, with 31 fraction bits, for ``y`` from 0 to just below 1 with 30 of them.

    A cubic, refined twice by Newton's ``r + r * (1 - x * r)``, each time squaring the error. Only the second
    time takes full words: the guess is 10 bits right, what comes first is 18.

    Returns
    -------
    A word within 0.55 units of its last place.
    """
    r = _polynomial(y >> 14, GUESS, 16) & ((1 << 17) - 1)
    x = y + ONE
    error = kept((1 << 38) - (x >> 8) * r, 31) >> 12  # with 26 fraction bits
    r = ((r << 10) + product(r, error, 16)) & ((1 << 27) - 1)
    error = kept((1 << 56) - x * r, 40) >> 15  # with 41 fraction bits
    return ((r << 5) + product(r, error, 36)) & ((1 << 32) - 1)


def quotient(numerator: Any, divisor: Any, fraction: int) -> Any:
    """Return one word by another, both of a fraction, with the same.

    Raises
    ------
    ZeroDivisionError
        The divisor is 0.
    ArgumentError
        The divisor is a word that can be 0, or it has more bits than this can do.
    TooWideError
        The quotient has more than 64 bits.
    """
    low, high = limits(divisor)
    if low <= 0 <= high:
        if not isinstance(divisor, Word):
            raise ZeroDivisionError("division by zero")
        raise ArgumentError(
            f"a divisor can be {low / 2**fraction:.6g} to {high / 2**fraction:.6g}, which has 0 in it; "
            "max(x, 0.001) or np.clip keeps it away from 0"
        )
    size = absolute(divisor)
    if limits(size)[1] >= 1 << min(62, 33 + fraction):
        raise ArgumentError(f"a divisor can be {high / 2**fraction:.6g}, which is too much; clip it")
    mantissa, shift = normalised(size)
    signed = either(divisor < 0, -numerator, numerator)
    found = shifted_product(signed, reciprocal(mantissa & (ONE - 1)), (61 - fraction) - shift)
    if not isinstance(found, Word):
        return found
    ends = [(end << fraction) // by for end in limits(numerator) for by in (low, high)]
    error = max(map(abs, ends)) >> 28
    return noted(found, min(ends) - error - 2, max(ends) + error + 2)


def normalised(size: Any) -> tuple[Any, Any]:
    """Return a word from 1 to ``2**62 - 1`` shifted until it is ``2**30`` to ``2**31 - 1``, and how far.

    The shift is to the left; where it is negative, to the right, bits get lost.
    """
    if not isinstance(size, Word):
        by = 31 - size.bit_length()
        return (size << by if by >= 0 else size >> -by), by
    shift: Any = 0
    for step in (16, 8, 4, 2, 1):
        small = size < 1 << (30 + step)
        size, shift = either(small, size, size >> step), shift - either(small, 0, step)
    for step in (16, 8, 4, 2, 1):
        small = size < 1 << (31 - step)
        moved = (size & ((1 << (31 - step)) - 1)) << step
        size, shift = either(small, moved, size), shift + either(small, step, 0)
    return size, shift


def square_root(word: Any, fraction: int) -> Any:
    """Return the square root, rounded to nearest; with the same fraction.

    Raises
    ------
    ValueError
        The word is negative.
    ArgumentError
        It is a word that can be negative.
    """
    low, high = limits(word)
    if isinstance(word, Word):
        if low < 0:
            raise ArgumentError(
                f"a square root is taken of {low / 2**fraction:.6g} to {high / 2**fraction:.6g}; "
                "max(x, 0.0) keeps it from below 0"
            )
        return _root_by_digits(word, fraction)
    if word < 0:
        raise ValueError("square root of a negative number")
    root = math.isqrt(word << fraction)
    return root + ((word << fraction) - root * root > root)


def _root_by_digits(word: Word, fraction: int) -> Any:
    """Return the square root of ``word << fraction``, which need not fit 64 bits, two bits at a time."""
    digits = (limits(word)[1].bit_length() + fraction + 1) // 2
    root: Any = 0
    rest: Any = 0
    for digit in reversed(range(digits)):
        at = 2 * digit - fraction
        pair = (word >> at) & 3 if at >= 0 else (word & 1) << 1 if at == -1 else 0
        rest = (rest << 2) | pair
        trial = (root << 2) | 1
        more = rest >= trial
        # What is left is at most twice the root, so far of `digits - digit` bits.
        rest = either(more, rest - trial, rest) & ((1 << digits - digit + 1) - 1)
        root = (root << 1) | more
    return noted(root + (rest > root), 0, math.isqrt(limits(word)[1] << fraction) + 1)


def exponential(word: Any, fraction: int, result: int) -> Any:
    """Return ``e`` to a power, with ``result`` fraction bits.

    Raises
    ------
    TooWideError
        The result has more than 64 bits.
    """
    word = greatest(word, DEEPEST << fraction)
    powers = product(word, round(math.log2(math.e) * 2**20), fraction + 20)
    own = max(fraction + 6, 31)
    rest = (word << own - fraction) - powers * round(math.log(2) * 2**own)
    mantissa = _polynomial(kept(rest >> own - 31, 31), EXPONENTIAL, 31) & ((1 << 31) - 1)
    return scaled(mantissa, (30 - result) - powers)


def hyperbolic_tangent(word: Any, fraction: int) -> Any:
    """Return the hyperbolic tangent, with the same fraction."""
    # From 0 up it is (1 - e**-2x) / (1 + e**-2x).
    low = exponential(-2 * absolute(word), fraction, 30)
    # Where that is 1, the numerator is 0.
    size = least(product(ONE - low, reciprocal(low & (ONE - 1)), 31 + 30 - fraction), 1 << fraction)
    return either(word < 0, -size, size)
