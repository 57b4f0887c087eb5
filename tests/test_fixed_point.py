"""Fixed-point arithmetic against exact integers and against float64."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pearl_marl import fixed_point
from pearl_marl.golden import call_reference, i32, u32

WORDS = st.integers(-(1 << 31), (1 << 31) - 1)
SCALE = 2.0**fixed_point.FRACTION
QUADRANTS = np.array([k << 29 for k in range(8)])


def run(function: Callable[..., Any], *arguments: Any) -> tuple[Any, ...]:
    return call_reference(function, arguments)


@given(WORDS, WORDS, st.integers(1, 62))
def test_multiply_is_the_rounding_rule(a: int, b: int, shift: int) -> None:
    exact = (a * b + (1 << (shift - 1))) >> shift
    (found,) = run(lambda a, b: fixed_point.multiply(a, b, shift), i32(a), i32(b))
    assert int(found) == (exact + (1 << 31)) % (1 << 32) - (1 << 31)


@given(WORDS, WORDS)
def test_saturating_add(a: int, b: int) -> None:
    (found,) = run(fixed_point.saturating_add, i32(a), i32(b))
    assert int(found) == min(max(a + b, -(1 << 31)), (1 << 31) - 1)


def test_constants() -> None:
    assert fixed_point.constant(-1.5, 30) == -3 << 29
    assert fixed_point.constant(2 - 2**-30, 30) == (1 << 31) - 1
    for value in (2, -2.1):
        with pytest.raises(OverflowError, match=f"{value} with 30 fraction bits takes more than 32 bits"):
            fixed_point.constant(value, 30)


def test_sine_and_cosine() -> None:
    """At 400,000 angles, evenly and unevenly spaced, and around the edges of the quadrants."""
    near = (QUADRANTS[:, None] + np.arange(-1000, 1001)).ravel() % (1 << 32)
    random = np.random.default_rng(0).integers(1 << 32, size=130_000)
    turns = np.concatenate([np.arange(0, 1 << 32, 16384), random, near]).astype(np.uint32)
    sine, cosine = run(fixed_point.sine_cosine, turns)
    angle = turns * (2 * math.pi / 2**32)
    for name, words, truth in (("sine", sine, np.sin(angle)), ("cosine", cosine, np.cos(angle))):
        worst = np.abs(words / SCALE - truth).max()
        print(f"{name}: {worst:.2e} of {len(turns):,}")
        assert worst < 3.5e-9
        assert np.abs(words.astype(np.int64)).max() == fixed_point.ONE


def test_sine_and_cosine_at_whole_quadrants() -> None:
    quarters = u32(np.array([0, 1 << 30, 2 << 30, 3 << 30]))
    sine, cosine = run(fixed_point.sine_cosine, quarters)
    one = fixed_point.ONE
    np.testing.assert_array_equal(sine, [0, one, 0, -one])
    np.testing.assert_array_equal(cosine, [one, 0, -one, 0])
    signed = run(fixed_point.sine_cosine, quarters.view(np.int32))
    np.testing.assert_array_equal(signed, (sine, cosine))


def test_reciprocal() -> None:
    """At 230,000 numbers from 1 to 2, ends included."""
    generator = np.random.default_rng(0)
    random = generator.integers(1 << 30, 1 << 31, 100_000)
    ends = np.concatenate([(1 << 30) + np.arange(1000), (1 << 31) - 1 - np.arange(1000)])
    words = np.concatenate([np.arange(1 << 30, 1 << 31, 8192), random, ends]).astype(np.int32)
    (found,) = run(fixed_point.reciprocal, words)
    worst = np.abs(found / SCALE * (words / SCALE) - 1).max()
    print(f"reciprocal: {worst:.2e} of {len(words):,}, relatively")
    assert worst < 1.2e-8


@pytest.mark.parametrize(
    ("function", "powers", "words"),
    [
        (lambda y: np.sin(math.pi / 4 * y), (1, 3, 5, 7), ("S_1", "S_3", "S_5", "S_7")),
        (lambda y: np.cos(math.pi / 4 * y) - 1, (2, 4, 6, 8), ("C_2", "C_4", "C_6", "C_8")),
    ],
    ids=["sine", "cosine"],
)
def test_coefficients_are_those_of_the_fit(
    function: Callable[[Any], Any], powers: tuple[int, ...], words: tuple[str, ...]
) -> None:
    y = np.cos(math.pi * (np.arange(4000) + 0.5) / 8000)
    fitted, *_ = np.linalg.lstsq(y[:, None] ** np.array(powers), function(y), rcond=None)
    np.testing.assert_allclose([getattr(fixed_point, word) for word in words], fitted * SCALE, atol=0.51)


def test_first_guess_of_the_reciprocal_is_the_chebyshev_parabola() -> None:
    assert [round(k / 99 * SCALE) for k in (98, -80, 32)] == [
        fixed_point.R_0,
        fixed_point.R_1,
        fixed_point.R_2,
    ]
