"""Game2048 against jumanji's: episodes of ``record_jumanji.py``, with their tiles."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import pearl_marl
from pearl_marl.envs.game2048.step import slid
from pearl_marl.errors import ArgumentError

from .episodes import Array, below, replay

SPEC = pearl_marl.get_spec("Game2048")


def draws(drawn: Array) -> Array:
    """Return draws that put a tile into this free cell of so many, and make it a 2 or a 4."""
    which, count, tile = drawn.T
    return np.stack([below(which, count), np.where(tile == 2, 0, 2**32 - 1)], 1)


def begin(ours: Any, start: Array) -> None:
    ours.start(draws(start))


@pytest.mark.parametrize(("case", "most"), [("Game2048", 7), ("Game2048, 3", 5), ("Game2048, 2", 3)])
@pytest.mark.parametrize("episodes", [24, pytest.param(None, marks=pytest.mark.exhaustive)])
def test_episodes(case: str, most: int, episodes: int | None) -> None:
    """Every board, reward, mask and end is the package's, on boards of every size."""
    replayed = replay(case, begin, draws, np.uint8, episodes)
    print(f"{replayed.steps:,} steps; {replayed.idle:,} changed nothing; up to 2^{replayed.last.max()}")
    assert replayed.idle > len(replayed.last) / 4
    assert replayed.last.max() >= most


def test_every_line() -> None:
    """Every line of four of the least and the greatest tiles, against another statement of the rule."""
    lines = np.array(np.meshgrid(*[[0, 1, 2, 3, 16, 17]] * 4)).reshape(4, -1)
    for line in lines.T.tolist():
        tiles, worth = [tile for tile in line if tile], 0
        k = 0
        while k + 1 < len(tiles):
            if tiles[k] == tiles[k + 1]:
                tiles[k : k + 2] = [min(tiles[k] + 1, 17)]
                worth += 2 ** tiles[k]
            k += 1
        assert slid(line, 17) == (tiles + [0] * (4 - len(tiles)), worth)


def test_one_tile_of_ten_is_a_four() -> None:
    env = pearl_marl.parallel_env("Game2048", 40_000)
    boards = env.reset_batch(seed=3).reshape(40_000, 16)
    share = (boards == 2).sum() / 40_000
    assert abs(share - 0.1) < 5 * 0.3 / 200
    counts = (boards > 0).sum(0)
    assert counts.sum() == 40_000
    assert (abs(counts - 2_500) < 5 * 50).all()


def test_picture() -> None:
    """Greater tiles are darker, and an empty cell has another colour."""
    assert SPEC.draw is not None
    board = np.zeros(16, int)
    board[:3] = 1, 5, 17
    one, five, most, none = SPEC.draw(SPEC.layout.built(board.tolist()))[24, 24::48].astype(int)
    assert tuple(none) == (205, 193, 180)
    assert one.sum() > five.sum() > most.sum()


@pytest.mark.parametrize("board_size", [1, 5, 4.0, "4"])
def test_bad_board_size(board_size: Any) -> None:
    with pytest.raises(ArgumentError, match=r"board_size is .*; it must be an integer from 2 to 4"):
        SPEC.with_options(board_size=board_size)
