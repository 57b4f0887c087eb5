"""ConnectFour against PettingZoo's ``connect_four_v3``: the same moves, and what comes of them."""

from __future__ import annotations

import os
from collections import Counter
from typing import Any

os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")

import numpy as np
import pytest
from pettingzoo.classic.connect_four import connect_four

import pearl_marl
from pearl_marl.envs.connect_four.step import CELLS, COLUMNS, has_four
from pearl_marl.golden import call_reference
from pearl_marl.porting.oracle import Games, compare
from pearl_marl.testing import compare_pictures

from .turns import begin, legal, move, seen

SPEC = pearl_marl.get_spec("ConnectFour")
initial, step = SPEC.positional[:2]


@pytest.mark.parametrize("moves", [16_000, pytest.param(100_000, marks=pytest.mark.exhaustive)])
def test_moves(moves: int) -> None:
    """Random games to their ends: observations, masks, rewards and ends after every move."""
    n, counts = 100, Counter[float]()
    games = Games(SPEC, [connect_four.raw_env() for _ in range(n)], begin, move, seen)
    for made in compare(SPEC, games, n, moves // n, actions=legal, seed=7):
        counts.update(made.outcome.rewards[made.ended, 0].tolist())
    print(f"{moves:,} moves; the first won {counts[1]}, lost {counts[-1]}, drew {counts[0]}")
    assert min(counts[reward] for reward in (1, -1, 0)) >= 2


def test_where_four_are_in_a_row() -> None:
    """Every four bits that are evenly spaced, of which those on the edges would run on in the next row."""
    cells = [(first, by) for by in (1, 6, 7, 8) for first in range(CELLS) if first + 3 * by < CELLS]
    boards = np.array([sum(1 << first + k * by for k in range(4)) for first, by in cells])
    straight = []
    for first, by in cells:
        places = [divmod(first + k * by, COLUMNS) for k in range(4)]
        rows, columns = (np.diff(line) for line in zip(*places, strict=True))
        straight.append(max(abs(rows)) <= 1 and max(abs(columns)) <= 1)
    assert sum(straight) == 69
    np.testing.assert_array_equal(call_reference(has_four, [boards])[0], straight)
    for k in range(4):  # and no three of them
        holes = [board & ~(1 << first + k * by) for board, (first, by) in zip(boards, cells, strict=True)]
        assert not call_reference(has_four, [np.array(holes)])[0].any()


@pytest.mark.parametrize("mover", range(2))
def test_an_illegal_move_ends_the_game_as_in_pettingzoo(mover: int) -> None:
    """Its mover loses a point, and nobody wins one."""
    oracle = connect_four.env()
    oracle.reset()
    state = call_reference(initial, ())
    for action in (3, 3, 3, 3, 3, 3, *[0] * mover):
        oracle.step(action)
        *state, _, _, over, _ = call_reference(step, [*state, action, action])
        assert not over
    oracle.step(3)
    *_, reward_0, reward_1, over_0, over_1 = call_reference(step, [*state, 3, 3])
    assert [reward_0, reward_1] == [oracle.rewards[player] for player in oracle.possible_agents]
    assert [over_0, over_1] == [oracle.terminations[player] for player in oracle.possible_agents] == [1, 1]
    assert [reward_0, reward_1][mover] == -1
    # An action that is none does the same.
    assert call_reference(step, [*state, 7, 7])[3:] == (reward_0, reward_1, 1, 1)


def test_pictures_are_pettingzoos() -> None:
    game, taken = connect_four.raw_env(render_mode="rgb_array"), [3, 3, 2, 6, 0]
    game.reset()

    def drawn(state: Any) -> Any:
        game.step(taken.pop(0))
        return game.render()

    compare_pictures(SPEC, "rgb_array", drawn, [[action, action] for action in taken], different=5)
