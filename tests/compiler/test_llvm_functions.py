"""Functions that are written straight into kernels, against what they do as plain Python."""

from __future__ import annotations

from typing import Any

import numba
import numpy as np
import pytest

from pearl_marl.compiler.llvm_functions import Code, Value, written
from pearl_marl.compiler.llvm_words import operations

from .plain import inlined, returning

N = 37


def scale(words: Any, numbers: Any, m: Any) -> None:
    for i in range(m):
        numbers[2 * i + 1] = np.float32(np.int32(words[i])) * np.float32(0.25)


def shear(words: Any, numbers: Any, m: Any) -> None:
    """A loop around another one, and one whose turns LLVM could write out."""
    for d in range(1, 3):
        first = words[d]
        for i in range(m):
            words[i] = np.int16(words[i] + first)
    for i in range(3):
        numbers[i] = np.float32(words[i + 1])


def look_up(words: Any, numbers: Any, m: Any) -> None:
    for i in range(m):
        words[i] = TABLE[i] // np.int16(7)


TABLE = np.arange(-N, N, dtype=np.int16) * np.int16(300)


@pytest.mark.parametrize("function", [scale, shear, look_up])
def test_what_it_does(function: Any) -> None:
    write = inlined(function)

    @numba.njit  # type: ignore[untyped-decorator]
    def compiled(words: Any, numbers: Any, m: Any) -> None:
        write(words, numbers, m)

    words = np.random.default_rng(0).integers(-(2**15), 2**15, N).astype(np.int16)
    expected, found = ((words.copy(), np.zeros(2 * N, np.float32)) for _ in range(2))
    with np.errstate(over="ignore"):
        function(*expected, N)
    compiled(*found, N)
    for one, other in zip(expected, found, strict=True):
        np.testing.assert_array_equal(one, other)


def test_one_calls_another() -> None:
    add = operations()["uint8_add"]

    def twice(word: Any) -> Any:
        return add(word, word)

    def fourfold(word: Any) -> Any:
        return twice(twice(word)), add(word, 1)

    assert returning(fourfold)(np.uint8(100)) == (400 & 255, 101)


def test_an_if_that_asks_for_a_word_is_refused() -> None:
    def branch(word: Any) -> Any:
        return word if word else np.uint8(1)

    with pytest.raises(TypeError, match=r"branches are written by `code\.when`"):
        returning(branch)(np.uint8(1))


def collatz(code: Code, arguments: dict[str, Any]) -> Value:
    """Branches in a loop, and variables that last from turn to turn."""
    starts, turns = arguments["starts"], arguments["turns"]
    odd = code.variable(code.word(numba.int64, 0))
    for i in code.range(arguments["m"]):
        with code.either(starts[i] & 1) as (is_odd, is_even):
            with is_odd:
                odd[0] = odd[0] + 1
                turns[i] = starts[i] * 3 + 1
            with is_even:
                turns[i] = starts[i] // 2
        with code.when(turns[i].equals(4)):
            turns[i] = 0
    return odd[0]


def test_branches() -> None:
    write = written(collatz, ["starts", "turns", "m"], {})

    @numba.njit  # type: ignore[untyped-decorator]
    def compiled(starts: Any, turns: Any, m: Any) -> Any:
        return write(starts, turns, m)

    starts, turns = np.arange(N), np.zeros(N, np.int64)
    assert compiled(starts, turns, N) == N // 2
    due = [3 * start + 1 if start % 2 else start // 2 for start in range(N)]
    assert turns.tolist() == [0 if turn == 4 else turn for turn in due]


def test_words_that_lie_apart_are_refused() -> None:
    write = inlined(scale)

    @numba.njit  # type: ignore[untyped-decorator]
    def compiled(words: Any, numbers: Any, m: Any) -> None:
        write(words, numbers, m)

    with pytest.raises(AssertionError, match="side by side"):
        compiled(np.zeros(2 * N, np.int16)[::2], np.zeros(2 * N, np.float32), N)
