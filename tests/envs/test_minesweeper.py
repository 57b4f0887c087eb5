"""Minesweeper against jumanji's: episodes of ``record_jumanji.py``, with their mines."""

from __future__ import annotations

from itertools import combinations
from typing import Any

import numpy as np
import pytest

import pearl_marl
from pearl_marl.errors import ArgumentError
from pearl_marl.golden import call_reference

from .episodes import Array, replay

SPEC = pearl_marl.get_spec("Minesweeper")


def begin(ours: Any, start: Array) -> None:
    """Lay the mines."""
    rows, columns = (ours.spec.options[name] for name in ("num_rows", "num_cols"))
    mined = [((start // columns == row) << start % columns).sum(1) for row in range(rows)]
    ours.words = [*mined, *(np.zeros(len(start), np.int64) for _ in range(rows))]


def draws(drawn: Array) -> Array:
    """Return none."""
    return drawn


@pytest.mark.parametrize(
    ("case", "episodes"),
    [
        ("Minesweeper, small", 200),
        ("Minesweeper", 20),
        *(
            pytest.param(case, None, marks=pytest.mark.exhaustive)
            for case in ("Minesweeper", "Minesweeper, small")
        ),
    ],
)
def test_episodes(case: str, episodes: int | None) -> None:
    """Every board, reward, mask and end is the package's."""
    replayed = replay(case, begin, draws, np.int8, episodes)
    mined, explored = np.split(replayed.last, 2, 1)
    full = (1 << (5 if "small" in case else 10)) - 1
    solved, exploded = ((mined | explored) == full).all(1), (mined & explored).any(1)
    lost = len(solved) - int(solved.sum()) - int(exploded.sum())
    print(f"{replayed.steps:,} steps; {solved.sum()} solved, {exploded.sum()} mines, {lost} explored twice")
    assert min(solved.sum(), exploded.sum(), replayed.idle) > 0


def test_mines() -> None:
    """Every choice of cells is equally likely."""
    spec = SPEC.with_options(num_rows=2, num_cols=3, num_mines=3)
    assert spec.reset_draws == 1
    count = 6 * 5 * 4 * 60
    draws = (2 * np.arange(count) + 1 << 31) // count
    upper, lower, *_ = call_reference(spec.positional.initial, [draws])
    boards, counts = np.unique(upper + 8 * lower, return_counts=True)
    assert boards.tolist() == sorted(sum(1 << cell for cell in mines) for mines in combinations(range(6), 3))
    assert (counts == count // 20).all()


def test_every_number_of_mines_around() -> None:
    """A cell tells 0 to 8, by its eight neighbours and not by its own mine."""
    spec = SPEC.with_options(num_rows=3, num_cols=3, num_mines=8)
    mined = np.arange(512)
    lines = [mined >> 3 * row & 7 for row in range(3)]
    seen = call_reference(spec.positional.observe, [*lines, 0, 2, 0])
    planes = np.stack(np.broadcast_arrays(*seen, mined)[:-1], 1).reshape(512, 3, 4)
    centre = sum((planes[:, 1, k] >> 1 & 1) << k for k in range(4))
    around = [(mined & ~16) >> k & 1 for k in range(9)]
    np.testing.assert_array_equal(centre, np.sum(around, 0))
    assert (planes[:, [0, 2]] == 7).all(), "what is unexplored tells nothing"


def test_picture() -> None:
    """An explored cell has a dot for each mine around it, and a mine is black."""
    spec = SPEC.with_options(num_rows=2, num_cols=2, num_mines=2)
    assert spec.draw is not None
    picture = spec.draw(spec.layout.built([0b10, 0b10, 0b11, 0b00])).reshape(2, 24, 2, 24, 3)
    assert (picture[0, 1:, 1, 1:] == (20, 20, 20)).all()
    assert (picture[1, 1:, :, 1:] == (150, 150, 150)).all()
    dots = (picture[0, :, 0] == (0, 128, 0)).all(-1)
    assert dots.sum() == 2 * 9


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"num_rows": 17}, "num_rows is 17; it must be an integer from 2 to 16"),
        ({"num_cols": 1}, "num_cols is 1; it must be an integer from 2 to 16"),
        ({"num_mines": 0}, "num_mines is 0; it must be an integer from 1 to 40"),
        (
            {"num_rows": 2, "num_cols": 3, "num_mines": 6},
            "num_mines is 6; a board of 2 x 3 cells takes up to 5",
        ),
    ],
)
def test_bad_options(options: dict[str, Any], message: str) -> None:
    with pytest.raises(ArgumentError, match=message):
        SPEC.with_options(**options)
