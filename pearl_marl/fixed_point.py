"""Fixed-point arithmetic for golden steps.

A number is an ``i32`` word that stands for ``word * 2**-fraction``. Products have 64 bits and are
rounded once, by the rule in :func:`multiply`. ``docs/fixed_point.md`` has the formats and the
measured errors, and says how the coefficients below were fitted.
"""

from __future__ import annotations

import numpy as np

from pearl_marl.golden import Word, i32, i64, u32

FRACTION = 30
"""Fraction bits of sines, cosines and reciprocals: their words reach from -2 to just below 2."""
ONE = 1 << FRACTION

# sin(pi/4 y) = y * (S_1 + S_3 y**2 + S_5 y**4 + S_7 y**6) for y in -1 .. 1, and
# cos(pi/4 y) = 1 + C_2 y**2 + ... + C_8 y**8. Least squares over 4,000 Chebyshev nodes, which is
# within a few per cent of minimax, times 2**30: 1.3e-9 and 0.1e-9 off.
S_1, S_3, S_5, S_7 = 843314845, -86699678, 2673479, -38523
C_2, C_4, C_6, C_8 = -331168968, 17023455, -349977, 3792

# A first 1 / (1 + y), y in 0 .. 1, is (98 - 80 y + 32 y**2) / 99: the parabola of least relative
# error, which is the third Chebyshev polynomial's 1/99.
R_0, R_1, R_2 = 1062895947, -867670161, 347068064


def constant(value: float, fraction: int) -> int:
    """Return a constant as a word, for the top of a module or a closure; golden steps hold no floats.

    Raises
    ------
    OverflowError
        The word would need more than 32 bits.
    """
    word = round(value * 2.0**fraction)
    if not -(1 << 31) <= word < 1 << 31:
        raise OverflowError(f"{value} with {fraction} fraction bits takes more than 32 bits")
    return word


def multiply(a: Word, b: Word, shift: int) -> Word:
    """Return ``(a * b + half) >> shift``, the one rounding rule: to nearest, halves upwards.

    Parameters
    ----------
    a, b
        ``i32``, with any fractions.
    shift
        1 to 62; the product keeps the fraction bits of ``a`` and ``b`` together less this many.

    Returns
    -------
    ``i32``; a product that does not fit loses its upper bits.
    """
    product = i64(i64(a) * i64(b))
    return i32(i64(i64(product + i64(1 << (shift - 1))) >> i64(shift)))


def clip(x: Word, low: int, high: int) -> Word:
    """Return the nearest of ``low .. high``, which are words, to an ``i64``; an ``i32``."""
    return i32(np.minimum(np.maximum(i64(x), i64(low)), i64(high)))


def saturating_add(a: Word, b: Word) -> Word:
    """Return the nearest ``i32`` to the sum of two."""
    return clip(i64(i64(a) + i64(b)), -(1 << 31), (1 << 31) - 1)


def sine_cosine(turns: Word) -> tuple[Word, Word]:
    """Return sine and cosine of an angle, with :data:`FRACTION` fraction bits.

    Parameters
    ----------
    turns
        The angle as a fraction of a turn: ``u32`` or ``i32`` with 32 fraction bits. It wraps by itself.

    Returns
    -------
    Two ``i32`` of -1 to 1, each within 4e-9 of the truth. Zeros and ones are exact.
    """
    turned = u32(u32(turns) + u32(1 << 29))  # by an eighth, so that quadrants begin where they are cut
    quadrant = i32(turned >> u32(30))
    y = i32(i32(i32(turned & u32(0x3FFFFFFF)) - i32(1 << 29)) << i32(1))  # eighths of a turn, -1 .. 1
    square = multiply(y, y, 30)
    s = i32(multiply(square, i32(S_7), 30) + i32(S_5))
    s = i32(multiply(square, s, 30) + i32(S_3))
    s = i32(multiply(square, s, 30) + i32(S_1))
    s = multiply(y, s, 30)
    c = i32(multiply(square, i32(C_8), 30) + i32(C_6))
    c = i32(multiply(square, c, 30) + i32(C_4))
    c = i32(multiply(square, c, 30) + i32(C_2))
    c = i32(multiply(square, c, 30) + i32(ONE))
    # In odd quadrants sine and cosine change places; the signs are those of the quadrant.
    swap = i32(i32(0) - i32(quadrant & i32(1)))
    swapped = i32(i32(s ^ c) & swap)
    negative_s = i32(i32(0) - i32(quadrant >> i32(1)))
    negative_c = i32(negative_s ^ swap)
    s, c = i32(s ^ swapped), i32(c ^ swapped)
    return i32(i32(s ^ negative_s) - negative_s), i32(i32(c ^ negative_c) - negative_c)


def reciprocal(x: Word) -> Word:
    """Return ``1 / x`` for ``x`` from 1 to just below 2, both with :data:`FRACTION` fraction bits.

    A parabola, refined twice by Newton's ``r + r * (1 - x * r)``, each time squaring the error.

    Returns
    -------
    ``i32`` within 1.2e-8 of the truth, relatively.
    """
    y = i32(x - i32(ONE))
    r = i32(multiply(y, i32(R_2), 30) + i32(R_1))
    r = i32(multiply(y, r, 30) + i32(R_0))
    for _ in range(2):
        r = i32(r + multiply(r, i32(i32(ONE) - multiply(x, r, 30)), 30))
    return r
