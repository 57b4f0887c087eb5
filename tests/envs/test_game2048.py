"""Game2048 against jumanji's: episodes of ``record_jumanji.py``, with their tiles."""

from __future__ import annotations

import zlib
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pearl_marl
from pearl_marl.envs.game2048.step import slid
from pearl_marl.errors import ArgumentError
from pearl_marl.golden import reference

Array = np.ndarray[Any, Any]
RECORDED = np.load(Path(__file__).with_name("jumanji.npz"))
SPEC = pearl_marl.get_spec("Game2048")


def draws_of(tiles: Array) -> list[Array]:
    """Return draws that put a tile into this free cell of so many, and make it a 2 or a 4."""
    which, count, tile = tiles.astype(np.int64).T
    return [-(-(which << 32) // np.maximum(count, 1)), np.where(tile == 2, 0, 2**32 - 1)]


@pytest.mark.parametrize("size", [4, 3, 2])
@pytest.mark.parametrize("episodes", [24, pytest.param(None, marks=pytest.mark.exhaustive)])
def test_episodes(size: int, episodes: int | None) -> None:
    """Every board, reward, mask and end is the package's, on boards of every size."""
    spec, cells = SPEC.with_options(board_size=size), size * size
    keys = "actions", "tiles", "checks", "running"
    actions, tiles, checks, running = (RECORDED[f"{size}/{key}"][:, :episodes] for key in keys)
    step, masks = reference(spec.positional.step), reference(spec.positional.masks)

    def checked(board: Array, reward: Array, over: Array) -> Array:
        """Return the recorder's checksums of these results."""
        said = np.stack(np.broadcast_arrays(*masks(*board.T), board[:, 0])[:-1], 1)
        parts = np.uint8(board), np.float32(reward), np.uint8(said), np.uint8(over)
        rows = zip(*parts, strict=True)
        return np.array([zlib.crc32(b"".join(part.tobytes() for part in row)) & 255 for row in rows])

    n = actions.shape[1]
    start = reference(spec.positional.initial)(*draws_of(tiles[0]))
    board = np.stack(np.broadcast_arrays(*start, np.zeros(n, np.int64))[:-1], 1)
    np.testing.assert_array_equal(checked(board, np.zeros(n), np.zeros(n)), checks[0])
    count, most, idle = 0, 0, 0
    steps = int(running.any(1).sum())
    rows = zip(actions, tiles[1:], checks[1:], running == 1, strict=True)
    for action, tile, check, on in islice(rows, steps):
        *after, reward, over = step(*board[on].T, action[on], *draws_of(tile[on]))
        idle += int((np.stack(after, 1) == board[on]).all(1).sum())
        board[on] = np.stack(after, 1)
        np.testing.assert_array_equal(checked(board[on], reward, over), check[on])
        count, most = count + int(on.sum()), max(most, int(board.max()))
    print(f"{count:,} steps, {idle:,} of which changed nothing; the greatest tile is {2**most}")
    assert idle > n / 4
    assert most >= {4: 7, 3: 5, 2: 3}[size]
    assert cells == board.shape[1]


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
