"""What the reference runs golden functions on, against Python's own integers."""

from __future__ import annotations

import operator
import random
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pearl_marl.golden import call_reference, i8, i16, i32, u8, u32, u64

OPERATIONS: list[Callable[[Any, Any], Any]] = [
    operator.add,
    operator.sub,
    operator.mul,
    operator.and_,
    operator.or_,
    operator.xor,
    operator.eq,
    operator.ne,
    operator.lt,
    operator.le,
    operator.gt,
    operator.ge,
    lambda a, b: a << (b & 15),
    lambda a, b: a >> (b & 63),
    lambda a, b: a // ((b & 7) + 1),
    lambda a, b: a % ((b & 7) + 1),
    lambda a, b: ~a + -b,
    lambda a, b: abs(a) - b**2,
    lambda a, b: 3 - a + (5 & b) * 7,
]
WORDS = st.integers(-(1 << 31), (1 << 31) - 1) | st.integers(-3, 3)


def chain(seed: int, cast: Any = u32) -> Callable[[Any, Any], tuple[Any, ...]]:
    """Return a golden function of random operations and casts, whose words grow far beyond 64 bits."""

    def function(a: Any, b: Any) -> tuple[Any, ...]:
        chance, words = random.Random(seed), [a, b]
        for _ in range(12):
            words.append(chance.choice(OPERATIONS)(*chance.choices(words, k=2)))
            words.append(cast(words[-1]))
        return tuple(words)

    return function


def wrapped(x: int) -> int:
    return x % (1 << 32)


@given(st.integers(0, 10**6), st.lists(st.tuples(WORDS, WORDS), min_size=1, max_size=5))
def test_they_are_pythons_integers(seed: int, pairs: list[tuple[int, int]]) -> None:
    columns = zip(*pairs, strict=True)
    results = call_reference(chain(seed), [np.array(column, np.int32) for column in columns])
    wanted = zip(*(chain(seed, cast=wrapped)(*pair) for pair in pairs), strict=True)
    for result, words in zip(results, wanted, strict=True):
        assert np.broadcast_to(result, len(pairs)).tolist() == list(map(int, words))


@given(st.integers(0, 10**6), WORDS, WORDS)
def test_one_slot_is_like_many(seed: int, a: int, b: int) -> None:
    results = call_reference(chain(seed), [i32(a), i32(b)])
    assert list(map(int, results)) == list(map(int, chain(seed, cast=wrapped)(a, b)))


@pytest.mark.parametrize("dtype", [u8, i8, i16, i32, u32, u64])
@given(x=st.integers(-(1 << 130), 1 << 130))
def test_a_cast_wraps(dtype: type[np.integer[Any]], x: int) -> None:
    def function(high: Any, low: Any) -> Any:
        return dtype((high << 63 << 5) + low)

    high, low = x >> 68, x & ((1 << 68) - 1)
    bits, signed = np.dtype(dtype).itemsize * 8, int(np.iinfo(dtype).min < 0)
    (found,) = call_reference(function, [np.array([high], object), np.array([low], object)])
    half = signed << bits - 1
    assert found.tolist() == [(x + half) % (1 << bits) - half]


def test_choices() -> None:
    def function(a: Any, b: Any) -> tuple[Any, ...]:
        return (
            b if a else 7,
            min(a, b),
            max(3, b),
            min(max(b, -1), a),
            a if True else b,
            not a,
            a and b,
            a or b,
        )

    a, b = np.array([0, 1, 200], np.uint8), np.array([-5, 5, 6], np.int8)
    wanted = [[7, 5, 6], [-5, 1, 6], [3, 5, 6], [-1, 1, 6], [0, 1, 200], [1, 0, 0], [0, 5, 6], [-5, 1, 200]]
    assert [word.tolist() for word in call_reference(function, [a, b])] == wanted


@given(WORDS, WORDS)
def test_a_choice_wraps_as_a_whole(a: int, b: int) -> None:
    def function(a: Any, b: Any) -> Any:
        return u32(a & 7 if a > b else min(a * b, max(b, -5)))

    wanted = a & 7 if a > b else min(a * b, max(b, -5))
    assert call_reference(function, [np.array([a]), np.array([b])])[0].tolist() == [wrapped(wanted)]


SQUARES, GRID = np.array([0, 1, 4, 9], np.uint8), [[1, 2], [3, 4], (5, 6)]


def test_tables() -> None:
    def function(k: Any, flag: Any) -> tuple[Any, ...]:
        return SQUARES[k] * 100, GRID[k % 3][flag], GRID[1][flag], len(GRID), sum(SQUARES), SQUARES[1:][flag]

    k = np.arange(4, dtype=np.uint8)
    wanted = [[0, 100, 400, 900], [1, 4, 5, 2], [3, 4, 3, 4], [3] * 4, [14] * 4, [1, 4, 1, 4]]
    assert [word.tolist() for word in call_reference(function, [k, k & 1])] == wanted


@pytest.mark.parametrize(
    ("function", "words"),
    [
        (lambda a: SQUARES[a + 3], "index out of range"),
        (lambda a: 1 << (a - 1), "negative shift count"),
        (lambda a: 7 % a, "modulo by zero"),
        (lambda a: a + 0.5, "'float' object cannot be interpreted as an integer"),
    ],
)
def test_what_has_no_meaning_is_refused(function: Callable[..., Any], words: str) -> None:
    with pytest.raises((TypeError, ValueError, IndexError, ZeroDivisionError), match=words):
        call_reference(function, [np.arange(4, dtype=np.uint8)])
