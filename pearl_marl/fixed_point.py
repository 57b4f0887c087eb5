"""Fixed-point arithmetic for golden steps.

A number is an ``i32`` word that stands for ``word * 2**-fraction``. Products have 64 bits and are
rounded once, by the rule in :func:`multiply`. ``docs/fixed_point.md`` has the formats and the
measured errors, and says how the coefficients below were fitted.
"""

from __future__ import annotations

from pearl_marl.golden import Word, i32, u32

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
    return i32((a * b + (1 << shift - 1)) >> shift)


def saturating_add(a: Word, b: Word) -> Word:
    """Return the nearest ``i32`` to the sum of two."""
    return min(max(a + b, -(1 << 31)), (1 << 31) - 1)


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
    turned = u32(turns + (1 << 29))  # by an eighth, so that quadrants begin where they are cut
    quadrant = turned >> 30
    y = 2 * ((turned & 0x3FFFFFFF) - (1 << 29))  # eighths of a turn, -1 .. 1
    square = multiply(y, y, 30)
    s = multiply(square, S_7, 30) + S_5
    s = multiply(square, s, 30) + S_3
    s = multiply(square, s, 30) + S_1
    s = multiply(y, s, 30)
    c = multiply(square, C_8, 30) + C_6
    c = multiply(square, c, 30) + C_4
    c = multiply(square, c, 30) + C_2
    c = multiply(square, c, 30) + ONE
    # In odd quadrants sine and cosine change places; the signs are those of the quadrant.
    odd, lower = quadrant & 1, quadrant >> 1
    if odd:
        s, c = c, s
    return -s if lower else s, -c if lower ^ odd else c


def reciprocal(x: Word) -> Word:
    """Return ``1 / x`` for ``x`` from 1 to just below 2, both with :data:`FRACTION` fraction bits.

    A parabola, refined twice by Newton's ``r + r * (1 - x * r)``, each time squaring the error.

    Returns
    -------
    ``i32`` within 1.2e-8 of the truth, relatively.
    """
    y = x - ONE
    r = multiply(y, R_2, 30) + R_1
    r = multiply(y, r, 30) + R_0
    for _ in range(2):
        r = r + multiply(r, ONE - multiply(x, r, 30), 30)
    return r
