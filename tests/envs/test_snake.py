"""Snake against jumanji's: episodes of ``record_jumanji.py``, with their fruits."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import pearl_marl
from pearl_marl.devices.reference import observations_of
from pearl_marl.errors import ArgumentError
from pearl_marl.golden import call_reference

from .episodes import Array, below, replay

SPEC = pearl_marl.get_spec("Snake")
SNAKE = [0, 2, 1, 0, 1, 2, 4, 0b000101, 0b111, 0b001]
"""On a grid of 2 by 3: from its tail in the lower left corner up, then right; below its head the fruit."""


def begin(ours: Any, start: Array) -> None:
    """Start by the one draw of a head and a fruit."""
    fruit, others, head = start.T
    ours.start(below(head * others + fruit, (others + 1) * others)[:, None])


def draws(drawn: Array) -> Array:
    which, count = drawn.T
    return below(which, count)[:, None]


def planes(grids: Array) -> Array:
    """Return numerators of the last plane's shares of the length."""
    grids = grids.reshape(len(grids), -1, 5)
    lengths = grids[..., :1].sum(1)
    grids[..., 4] *= lengths
    return np.rint(grids).astype(np.uint8)


@pytest.mark.parametrize(
    ("case", "episodes"),
    [
        ("Snake, small", 60),
        ("Snake", 6),
        *(pytest.param(case, None, marks=pytest.mark.exhaustive) for case in ("Snake", "Snake, small")),
    ],
)
def test_episodes(case: str, episodes: int | None) -> None:
    """Every grid, reward, mask and end is the package's."""
    replayed = replay(case, begin, draws, planes, episodes)
    names = [field.name for field in SPEC.with_options(num_rows=3, num_cols=4).state]
    longest = int(replayed.last[:, names.index("length")].max())
    print(f"{replayed.steps:,} steps, {replayed.rewarded:,} fruits; the longest snake has {longest} cells")
    assert longest == 12 if case == "Snake, small" else longest >= 12
    assert replayed.idle > 0, "some have to run into something"


def test_starts() -> None:
    """Head and fruit are in any two cells, each pair as likely."""
    spec = SPEC.with_options(num_rows=3, num_cols=4)
    draws = (2 * np.arange(12 * 11 * 40) + 1 << 31) // (12 * 11 * 40)
    ours = call_reference(spec.positional.initial, [draws])
    row, column, _, _, fruit_row, fruit_column = ours[:6]
    pairs, counts = np.unique((4 * row + column) * 12 + 4 * fruit_row + fruit_column, return_counts=True)
    assert pairs.tolist() == [12 * a + b for a in range(12) for b in range(12) if a != b]
    assert (counts == 40).all()


def test_new_fruits() -> None:
    """A fruit is in each free cell equally often."""
    spec = SPEC.with_options(num_rows=2, num_cols=3)
    start = call_reference(spec.positional.initial, [0])
    head_row, head_column, _, _, fruit_row, fruit_column, *_ = start
    assert (head_row, head_column, fruit_row, fruit_column) == (0, 0, 0, 1)
    draws = (2 * np.arange(4 * 50) + 1 << 31) // (4 * 50)
    after = call_reference(spec.positional.step, [*start, 1, draws])
    cells, counts = np.unique(3 * after[4] + after[5], return_counts=True)
    assert cells.tolist() == [2, 3, 4, 5]
    assert (counts == 50).all()


def test_order() -> None:
    """Shares of the length, from the head to the tail."""
    spec = SPEC.with_options(num_rows=2, num_cols=3)
    words = [np.array([word]) for word in SNAKE]
    grid = observations_of(spec, words)[0]
    shares = np.array([[2, 3, 4], [1, 0, 0]], np.float32) / np.float32(4)
    np.testing.assert_array_equal(grid[..., 4], shares)


def test_picture() -> None:
    """The fruit is red, and the snake gets lighter to its tail."""
    assert SPEC.draw is not None
    spec = SPEC.with_options(num_rows=2, num_cols=3)
    assert spec.draw is not None
    picture = spec.draw(spec.layout.built(SNAKE))[::24, ::24].astype(int)
    assert picture[1, 2].tolist() == [205, 45, 45]
    assert picture[1, 1].tolist() == [238, 238, 228]
    greens = [picture[cell].sum() for cell in ((0, 2), (0, 1), (0, 0), (1, 0))]
    assert greens == sorted(greens)
    assert len(set(greens)) == 4


@pytest.mark.parametrize("option", ["num_rows", "num_cols"])
@pytest.mark.parametrize("size", [1, 17, 4.0])
def test_bad_sizes(option: str, size: Any) -> None:
    with pytest.raises(ArgumentError, match=rf"{option} is .*; it must be an integer from 2 to 16"):
        SPEC.with_options(**{option: size})
