"""Reals as the reference has them, of Python's integers: what they mean, and how near they are to float64.

Errors are in ulp, units of the last place of the fraction. Every test prints what it found.
"""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Iterable
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pearl_marl.errors import ArgumentError
from pearl_marl.golden.reals import Real, functions
from pearl_marl.golden.reals.choices import select, stored
from pearl_marl.golden.reals.names import FUNCTIONS
from pearl_marl.golden.reals.numbers import factor, fraction_for

FRACTIONS = 20, 26, 28, 30
TRIALS = 5_000
BEYOND = 1e6


def words(fraction: int, low: float, high: float, trials: int = TRIALS) -> list[Real]:
    """Numbers of a range that fit a field: random ones, small ones, and both ends."""
    most = 1 << 31
    ends = max(-most, math.ceil(low * 2**fraction)), min(most - 1, math.floor(high * 2**fraction))
    generator = random.Random(0)
    found = [generator.randint(*ends) for _ in range(trials)]
    found += [round(generator.uniform(0, 1) ** 9 * end) for end in ends for _ in range(trials // 10)]
    near = [n + k for n in (0, *ends) for k in range(-20, 21)]
    return [Real(n, fraction) for n in (*found, *near) if ends[0] <= n <= ends[1]]


def worst(name: str, fraction: int, found: Iterable[Real], truth: Iterable[float]) -> float:
    """The greatest error in ulp."""
    errors = [abs(x.word - math.ldexp(t, fraction)) for x, t in zip(found, truth, strict=True)]
    print(f"{name}, {fraction} fraction bits: {max(errors):.3f} ulp of {len(errors):,}")
    return max(errors)


@pytest.mark.parametrize("fraction", FRACTIONS)
@pytest.mark.parametrize("name", ["sin", "cos", "tanh"])
def test_functions_of_every_field(name: str, fraction: int) -> None:
    xs = words(fraction, -BEYOND, BEYOND)
    found = [getattr(np, name)(x) for x in xs]
    assert worst(name, fraction, found, (getattr(math, name)(float(x)) for x in xs)) < 2
    assert max(abs(x.word) for x in found) <= 1 << fraction


@pytest.mark.parametrize("fraction", FRACTIONS)
def test_sines_of_many_turns(fraction: int) -> None:
    """Beyond a field's range, an angle's error grows by 1.1e-10 of it: what turning it into turns costs."""
    xs = [x * 100 for x in words(fraction, -BEYOND, BEYOND, 2000)]
    allowed = 1.5 + 100 * 2**31 * 1.12e-10
    assert worst("sin", fraction, map(Real.sin, xs), (math.sin(float(x)) for x in xs)) < allowed


@pytest.mark.parametrize("fraction", FRACTIONS)
def test_square_roots_are_rounded_to_nearest(fraction: int) -> None:
    xs = words(fraction, 0, BEYOND)
    for x in xs:
        root = np.sqrt(x).word
        assert (2 * root - 1) ** 2 <= 4 * x.word << fraction < (2 * root + 1) ** 2 or x.word == root == 0
    assert worst("sqrt", fraction, (x**0.5 for x in xs), (math.sqrt(float(x)) for x in xs)) < 0.51


@pytest.mark.parametrize("fraction", FRACTIONS)
def test_exponentials(fraction: int) -> None:
    """Within half a unit of the last place and 2e-9 of the result."""
    xs = words(fraction, -40, math.log(2.0 ** (50 - fraction)))
    truth = [math.exp(float(x)) for x in xs]
    found = [np.exp(x) for x in xs]
    relative = max(
        (abs(x.word - t * 2**fraction) - 0.5) / (t * 2**fraction) for x, t in zip(found, truth, strict=True)
    )
    print(f"exp, {fraction} fraction bits: {relative:.2e} relatively, beside half an ulp")
    assert relative < 2e-9


@pytest.mark.parametrize("fraction", FRACTIONS)
@pytest.mark.parametrize(("bits", "most"), [((1, 31), 1.6), ((32, 40), 3.6)], ids=["fields", "beyond"])
def test_quotients(fraction: int, bits: tuple[int, int], most: float) -> None:
    """Where they fit a field. Of a divisor that does not, bits beyond the 31st are lost."""
    generator = random.Random(1)
    field = 1 << 31
    found, truth = [], []
    for _ in range(TRIALS):
        width = generator.randint(*bits)
        divisor = generator.choice((-1, 1)) * generator.randint(1 << width - 1, (1 << width) - 1)
        quotient = generator.randint(-field, field) >> generator.choice((0, 0, generator.randint(0, 30)))
        numerator = quotient * divisor >> fraction
        found.append(Real(numerator, fraction) / Real(divisor, fraction))
        truth.append(numerator / divisor)
    assert worst("quotient", fraction, found, truth) < most


@pytest.mark.parametrize("fraction", FRACTIONS)
def test_quotients_of_powers_of_two_are_exact(fraction: int) -> None:
    for k in range(-fraction, 4):
        power = Real.of(2.0**k, fraction)
        for x in words(fraction, -1, 1, 100):
            exact = x.word << -k if k < 0 else (x.word + (1 << k >> 1)) >> k
            assert (x / power).word == exact
            assert (x * 2.0**-k).word == exact
            assert (x / 2.0**k).word == exact


def test_reciprocals_are_within_a_unit_of_their_last_place() -> None:
    generator = random.Random(0)
    ys = [
        *range(1000),
        *(generator.randrange(1 << 30) for _ in range(20_000)),
        *range((1 << 30) - 1000, 1 << 30),
    ]
    error = max(abs(functions.reciprocal(y) - 2**61 / (2**30 + y)) for y in ys)
    print(f"reciprocal: {error:.3f} units of 2**-31")
    assert error < 0.55
    assert functions.reciprocal(0) == 1 << 31


@pytest.mark.parametrize("value", [0.02, -0.02, 9.8, 1 / 3, 1e-6, 12345.678, math.pi])
def test_constants_lose_nothing_as_factors(value: float) -> None:
    whole, shift = factor(value)
    assert abs(whole) < 1 << 31
    assert abs(whole * 2.0**-shift / value - 1) < 2**-29.9
    xs = words(27, -8, 8, 1000)
    error = worst(f"times {value}", 27, (x * value for x in xs), (float(x) * value for x in xs))
    assert error < 0.51 + abs(value)  # 2**-30 of a product, whose word is up to 2**30 times the constant


def test_exact_constants_are_shifts_and_small_factors() -> None:
    assert factor(0.0) == (0, 0)
    assert factor(-2.5) == (-5, 1)
    assert factor(2.0**40) == (1, -40)
    assert factor(2.0**-50) == (1, 50)
    assert factor(1e-300) == (0, 62)


def test_a_fraction_is_what_the_bounds_leave() -> None:
    assert fraction_for([(-5, 5), (-0.1, 0.1)]) == 28
    assert fraction_for([(-8, 7)]) == 28  # -8 itself is a word
    assert fraction_for([(-8, 8)]) == 27
    assert fraction_for([(0, 0.001)]) == 30
    assert fraction_for([(-(2.0**23), 0)]) == 8
    with pytest.raises(ArgumentError, match=r"reals from -1 to 8\.38861e\+06 leave fewer than 8 of 32 bits"):
        fraction_for([(-1, 2.0**23)])
    with pytest.raises(ArgumentError, match="a real's bounds are finite"):
        fraction_for([(-math.inf, 1)])


WORD = st.integers(-(1 << 31), (1 << 31) - 1)


@given(WORD, WORD)
def test_sums_are_exact_and_products_are_rounded_once(a: int, b: int) -> None:
    x, y = Real(a, 27), Real(b, 27)
    assert (x + y).word == a + b
    assert (x - y).word == a - b
    assert (-x).word == -a
    assert abs(x).word == abs(a)
    assert (x * y).word == (a * b + (1 << 26)) >> 27
    assert (x**2).word == (x * x).word
    assert (x**3).word == (x * x * x).word
    assert (x < y, x <= y, x > y, x >= y, x == y, x != y) == (a < b, a <= b, a > b, a >= b, a == b, a != b)


@given(WORD, st.integers(-50, 50))
def test_an_integer_is_a_real_without_a_fraction(a: int, n: int) -> None:
    x = Real(a, 27)
    assert (x + n).word == (n + x).word == a + (n << 27)
    assert (x * n).word == (n * x).word == a * n
    assert (n - x).word == (n << 27) - a
    assert (x < n) == (a < n << 27)
    if n:
        assert abs((x / n).word - a / n) < 1
        assert (x / n).word == (x / Real.of(n, 27)).word


@given(WORD)
def test_rounding_to_integers_is_pythons(a: int) -> None:
    for word in (a, a << 26, a >> 20 << 20):
        x, value = Real(word, 27), word / 2**27
        assert math.floor(x) == math.floor(value)
        assert math.ceil(x) == math.ceil(value)
        assert round(x) == round(value)
        assert int(x) == math.trunc(x) == int(value)
        assert float(np.floor(x)) == math.floor(value)
        assert float(np.rint(x)) == round(value)


@given(st.integers(-(1 << 40), 1 << 40), st.floats(0.01, 9))
def test_a_remainder_is_of_the_rounded_divisor(a: int, by: float) -> None:
    assert (Real(a, 27) % by).word == a % round(by * 2**27)


@given(WORD, st.floats(-20, 20), st.floats(0, 20))
def test_a_field_saturates(a: int, low: float, width: float) -> None:
    high = low + width
    found = stored(Real(a, 27), low, high, 27)
    assert found == min(max(a, round(low * 2**27)), round(high * 2**27))
    assert stored(low - 1, low, high, 27) == round(low * 2**27)
    assert stored(100, low, high, 27) == round(high * 2**27)


def test_functions_take_the_names_of_pythons_and_numpys() -> None:
    x, y = Real.of(-0.75, 27), Real.of(0.5, 27)
    cases: list[tuple[Callable[..., Any], tuple[Any, ...], float]] = [
        (math.sin, (x,), math.sin(-0.75)),
        (math.cos, (x,), math.cos(-0.75)),
        (math.sqrt, (y,), math.sqrt(0.5)),
        (math.exp, (x,), math.exp(-0.75)),
        (math.tanh, (x,), math.tanh(-0.75)),
        (math.fabs, (x,), 0.75),
        (math.hypot, (x, y), math.hypot(0.75, 0.5)),
        (math.hypot, (3.0, y), math.hypot(3.0, 0.5)),
        (math.pow, (x, 3), -(0.75**3)),
        (np.hypot, (x, 1), math.hypot(0.75, 1)),
        (np.power, (x, 2), 0.75**2),
        (np.square, (x,), 0.75**2),
        (np.abs, (x,), 0.75),
        (np.minimum, (x, 0.1), -0.75),
        (np.maximum, (0, x), 0),
        (np.clip, (x, -0.5, 1), -0.5),
        (np.where, (x < y, x, 3.0), -0.75),
        (min, (y, 3, x), -0.75),
        (max, ([x, 0.25, y],), 0.5),
        (int, (x,), 0),
        (float, (x,), -0.75),
        (round, (x,), -1),
    ]
    for function, arguments, truth in cases:
        assert float(FUNCTIONS[function](*arguments)) == pytest.approx(truth, abs=3e-8), function
        numbers = [np.float64(3.0) if a == 3.0 else a for a in arguments]
        if function in (np.hypot, np.power, np.square, np.abs, np.minimum, np.maximum, np.clip):
            assert float(function(*numbers)) == pytest.approx(truth, abs=3e-8), function
    assert float(np.float64(2) * x + np.float64(1)) == -0.5
    assert np.float64(2) > x


def test_of_numbers_alone_functions_are_themselves() -> None:
    assert FUNCTIONS[math.sin](1) == math.sin(1)
    assert FUNCTIONS[max](3, 1, 2) == 3
    assert FUNCTIONS[max]([], default=7) == 7
    assert FUNCTIONS[min]("b", "a", key=ord) == "a"
    assert FUNCTIONS[int]("12") == 12
    assert FUNCTIONS[round](1.25, 1) == 1.2
    assert select(True, 1, 2.5) == 1


X = Real.of(0.5, 27)
REFUSED: list[tuple[Callable[[], Any], type[Exception], str]] = [
    (lambda: X + math.nan, ArgumentError, "a real is finite, and nan is not"),
    (lambda: X * math.inf, ArgumentError, "a real is finite, and inf is not"),
    (lambda: X + Real.of(0.5, 26), ArgumentError, "reals of 27 and 26 fraction bits meet"),
    (lambda: X * Real.of(0.5, 26), ArgumentError, "reals of 27 and 26 fraction bits meet"),
    (lambda: X / 0.0, ZeroDivisionError, "division by zero"),
    (lambda: X / 0, ZeroDivisionError, "division by zero"),
    (lambda: 1 / (X - 0.5), ZeroDivisionError, "division by zero"),
    (lambda: X % -1.0, ArgumentError, "`%` of a real takes a constant above 0"),
    (lambda: X**0.3, ArgumentError, "a real to the power 0.3: possible are whole numbers and 0.5"),
    (lambda: np.sqrt(X - 1), ValueError, "square root of a negative number"),
    (lambda: round(X, 2), ArgumentError, "reals are rounded to integers, not to decimals"),
    (lambda: X + "a", TypeError, "unsupported operand"),
    (lambda: Real.of("a", 27), ArgumentError, "'a' is no number"),
    (lambda: np.arctan2(X, 1.0), ArgumentError, "golden functions have no np.arctan2 of reals"),
    (lambda: np.sum(X), ArgumentError, "golden functions have no np.sum of reals"),
    (lambda: np.add.reduce(X), ArgumentError, "golden functions have no np.add.reduce"),
]


@pytest.mark.parametrize(("function", "kind", "sentence"), REFUSED, ids=range(len(REFUSED)))
def test_what_is_refused(function: Callable[[], Any], kind: type[Exception], sentence: str) -> None:
    with pytest.raises(kind) as caught:
        function()
    assert sentence in str(caught.value)


def test_a_real_says_what_it_is() -> None:
    assert type(Real(np.int32(5), 27).word) is int
    assert repr(X) == "Real(0.5, fraction=27)"
    assert bool(X)
    assert not X - 0.5
    assert (X**-1).word == 2 << 27
    assert (X**0).word == 1 << 27
    with pytest.raises(TypeError, match="unhashable"):
        hash(X)


@pytest.mark.parametrize(
    ("function", "powers", "coefficients"),
    [
        (lambda y: np.sin(math.pi / 4 * y), (9, 7, 5, 3, 1), functions.SINE),
        (lambda y: np.cos(math.pi / 4 * y) - 1, (8, 6, 4, 2), functions.COSINE[:-1]),
    ],
    ids=["sine", "cosine"],
)
def test_coefficients_of_angles_are_those_of_the_fit(
    function: Callable[[Any], Any], powers: tuple[int, ...], coefficients: tuple[int, ...]
) -> None:
    y = np.cos(math.pi * (np.arange(4000) + 0.5) / 8000)
    fitted, *_ = np.linalg.lstsq(y[:, None] ** np.array(powers), function(y), rcond=None)
    np.testing.assert_allclose(coefficients, fitted * 2.0**31, atol=0.51)


def test_coefficients_of_the_exponential_are_those_of_the_fit() -> None:
    x = 0.3467 * np.cos(math.pi * (np.arange(4000) + 0.5) / 4000)
    table = x[:, None] ** np.arange(7, -1, -1) / np.exp(x)[:, None]
    fitted, *_ = np.linalg.lstsq(table, np.ones_like(x), rcond=None)
    np.testing.assert_allclose(functions.EXPONENTIAL, fitted * 2.0**30, atol=0.51)


def test_the_guess_of_the_reciprocal_is_chebyshevs() -> None:
    y = np.linspace(0, 1, 10_001)
    guess = np.polyval(np.array(functions.GUESS) / 2**16, y)
    assert np.abs(guess * (1 + y) - 1).max() < 1.03 / 577
