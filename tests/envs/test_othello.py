"""Othello against pgx's: games of ``record_othello.py``."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import numpy as np
import pytest

import pearl_marl
from pearl_marl.envs.othello.step import CELLS, PASS, count
from pearl_marl.golden import call_reference
from pearl_marl.porting.oracle import Ours

from .record_othello import chances, checksum, chosen

SPEC = pearl_marl.get_spec("Othello")
RECORDED = np.load(Path(__file__).with_name("othello.npz"))


@pytest.mark.parametrize("games", [40, pytest.param(None, marks=pytest.mark.exhaustive)])
def test_games(games: int | None) -> None:
    """Boards, masks, rewards and ends after every move, with anything from the player not on turn."""
    checks, first = RECORDED["checks"][:, :games], RECORDED["first"][:games].astype(np.int64)
    ours, rows, results = Ours(SPEC, len(first)), np.arange(len(first)), Counter[tuple[float, ...]]()
    ours.start(first[:, None] << 31)
    moves = passes = 0
    for chance, check in zip(chances()[:, : len(first)], checks, strict=True):
        if not len(rows):
            break
        every, turn = np.arange(len(rows)), ours.words[2].astype(np.int64)
        actions = np.repeat(PASS - (rows % CELLS)[:, None], 2, 1)
        legal = ours.masks()[every, turn].astype(np.int64)
        actions[every, turn] = chosen(legal, chance[rows])
        made = ours.step(actions, np.zeros((len(rows), 0)))
        over, masks = made.terminated[:, 0], ours.masks()
        assert not masks[every, turn].any()
        legal = legal[every, actions[every, turn]]
        parts = legal, ours.observations(), masks[every, 1 - turn], made.rewards, over
        sums = [checksum(*row) for row in zip(*parts, strict=True)]
        np.testing.assert_array_equal(sums, check[rows])
        moves, passes = moves + len(rows), passes + int((actions[every, turn] == PASS).sum())
        results.update(map(tuple, made.rewards[over].tolist()))
        rows, ours.words, ours.n = rows[~over], [word[~over] for word in ours.words], int((~over).sum())
    print(f"{moves:,} moves, {passes:,} passes; {dict(results)}")
    assert games is not None or moves == RECORDED["count"]
    assert not len(rows)
    assert passes > 0
    assert min(results[1, -1], results[-1, 1]) > 10


def test_starts() -> None:
    """Either player begins, on the same four cells."""
    turns = call_reference(SPEC.positional.initial, [np.array([0, 2**31])])
    assert turns[2].tolist() == [0, 1]
    assert turns[0][0] == turns[1][1] == 1 << 28 | 1 << 35
    assert turns[0][1] == turns[1][0] == 1 << 27 | 1 << 36


def test_counts() -> None:
    generator = np.random.default_rng(1)
    boards = [0, 2**64 - 1, *(int(word) for word in generator.integers(2**63, size=50))]
    assert [count(board) for board in boards] == [board.bit_count() for board in boards]


def test_actions_that_are_none_lose() -> None:
    start = call_reference(SPEC.positional.initial, [0])
    for action in (PASS, 65, 127, 0, 27):
        assert call_reference(SPEC.positional.step, [*start, action, 0])[4:] == (-1, 1, 1, 1)


def test_picture() -> None:
    """Black discs are agent 0's."""
    assert SPEC.draw is not None
    start = call_reference(SPEC.positional.initial, [0])
    cells = SPEC.draw(SPEC.layout.built([int(word) for word in start]))[16::32, 16::32]
    assert cells[3, 4].tolist() == cells[4, 3].tolist() == [15, 15, 15]
    assert cells[3, 3].tolist() == cells[4, 4].tolist() == [245, 245, 245]
    assert (cells == (40, 120, 60)).all(-1).sum() == 60
