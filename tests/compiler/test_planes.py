"""Boards shown as planes: what CPU kernels call against the function that environments name."""

from __future__ import annotations

import numba
import numpy as np
import pytest

from pearl_marl.compiler.llvm_planes import REPLACEMENTS
from pearl_marl.golden.rebinding import rebound
from pearl_marl.planes import BoardCells, interleave, mark, mark_moving


@pytest.mark.parametrize("count", [1, 2, 21, 42, 63, 64])
def test_kernels_interleave_as_python_does(count: int) -> None:
    def unpack(first, second, row):
        interleave(first, second, count, row)

    compiled = rebound(unpack, finish=numba.njit, done=dict(REPLACEMENTS))
    boards = np.random.default_rng(count).integers(1 << 64, size=(20, 2), dtype=np.uint64)
    for first, second in boards:
        rows = np.full((2, 2 * count + 64), 7, np.int8)  # what lies behind a row stays as it is
        unpack(int(first), int(second), rows[0])
        compiled(first, second, rows[1])
        np.testing.assert_array_equal(*rows)
        assert set(rows[0, 2 * count :]) == {7}


def test_kernels_mark_as_python_does() -> None:
    """Things beyond each edge of the board, too, and several in one cell."""
    cells, places = BoardCells(lines=5, columns=6, first=3, channels=4), 29

    def unpack(alive, second, rightward, line, column, row):
        mark_moving(alive, second, rightward, line, column, cells, (0, 2, 1), row)
        mark(second, line, column, -2, cells, 3, row)

    compiled = rebound(unpack, finish=numba.njit, done=dict(REPLACEMENTS))
    random = np.random.default_rng(7)
    for _ in range(20):
        alive, second, rightward, *planes = random.integers(1 << places, size=9, dtype=np.int64)
        rows = np.zeros((2, 5 * 6 * 4 + 8), np.int8)
        words = (alive, second, rightward, tuple(planes[:3]), tuple(planes[3:]))
        unpack(*words, rows[0])
        compiled(*words, rows[1])
        np.testing.assert_array_equal(*rows)
        due = np.zeros((5, 6, 4), np.int8)
        for place in range(places):
            y, x = (sum((int(p) >> place & 1) << k for k, p in enumerate(of)) for of in words[3:])
            kind, behind = 2 * (second >> place & 1), x - 1 if rightward >> place & 1 else x + 1
            there = [(x, kind), (behind, 1)] * int(alive >> place & 1) + [(x - 2, 3)] * int(
                second >> place & 1
            )
            for column, channel in there:
                if y < 5 and 0 <= column < 6:
                    due[y, column, channel] = 1
        np.testing.assert_array_equal(rows[0, 3:-5], due.ravel())
        assert not rows[0, :3].any()
        assert not rows[0, -5:].any()
