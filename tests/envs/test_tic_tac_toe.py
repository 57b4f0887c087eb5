"""TicTacToe against PettingZoo's ``tictactoe_v3``: every position, whole games, and pictures."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Iterator
from typing import Any

os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")

import numpy as np
import pytest
from pettingzoo.classic.tictactoe import tictactoe

import pearl_marl
from pearl_marl.envs.tic_tac_toe.step import CELLS, FULL, LINES
from pearl_marl.golden import call_reference
from pearl_marl.porting.oracle import Games, Outcome, compare, one_by_one
from pearl_marl.testing import compare_pictures, compare_steps

from .turns import begin, legal, move, seen

SPEC = pearl_marl.get_spec("TicTacToe")
step = SPEC.positional.step


def positions() -> list[tuple[int, int, int]]:
    """Return the boards and the turn of every game that goes on, however it came about."""
    found, row = [(0, 0, 0)], {(0, 0, 0)}
    while row:
        row = {after for position in row for after in moved_on(position)}
        found += sorted(row)
    return found


def moved_on(position: tuple[int, int, int]) -> Iterator[tuple[int, int, int]]:
    """Yield what a legal move makes of a position, unless that ends the game."""
    *boards, turn = position
    for cell in range(CELLS):
        if not (boards[0] | boards[1]) >> cell & 1:
            after = [*boards[:turn], boards[turn] | 1 << cell, *boards[turn + 1 :]]
            if not any(after[turn] & line == line for line in LINES) and after[0] | after[1] != FULL:
                yield after[0], after[1], 1 - turn


@pytest.mark.parametrize("every", [12, pytest.param(1, marks=pytest.mark.exhaustive)])
def test_every_position(every: int) -> None:
    """Every twelfth, or every, legal move of any position: what is seen, masks, rewards and ends."""
    game = tictactoe.raw_env()

    def moved(state: Any, actions: list[int], draws: list[int]) -> Outcome:
        game.reset()
        first, second = state.boards
        game.board.squares = [(first >> cell & 1) + 2 * (second >> cell & 1) for cell in range(CELLS)]
        if state.turn:
            game.agent_selection = game._agent_selector.next()
        return move(game, actions, draws)

    rows = [
        (*position, cell)
        for position in positions()
        for cell in range(CELLS)
        if not (position[0] | position[1]) >> cell & 1
    ]
    assert len(rows) == 16_167
    *words, cells = np.array(rows[::every]).T
    compare_steps(SPEC, one_by_one(SPEC, moved), words, np.stack([cells, cells], 1))


@pytest.mark.parametrize("moves", [2_000, pytest.param(100_000, marks=pytest.mark.exhaustive)])
def test_moves(moves: int) -> None:
    """Random games to their ends, with any action of the player that is not on turn."""
    n, counts = 50, Counter[float]()
    games = Games(SPEC, [tictactoe.raw_env() for _ in range(n)], begin, move, seen)
    for made in compare(SPEC, games, n, moves // n, actions=legal, seed=7):
        counts.update(made.outcome.rewards[made.ended, 0].tolist())
    print(f"{moves:,} moves; the first won {counts[1]}, lost {counts[-1]}, drew {counts[0]}")
    assert min(counts[reward] for reward in (1, -1, 0)) >= 2


@pytest.mark.parametrize("mover", range(2))
def test_an_illegal_move_ends_the_game_as_in_pettingzoo(mover: int) -> None:
    """Its mover loses a point, and nobody wins one."""
    oracle = tictactoe.env()
    oracle.reset()
    state = call_reference(SPEC.positional.initial, ())
    for action in (4, 0)[: 2 - mover]:
        oracle.step(action)
        *state, _, _, over, _ = call_reference(step, [*state, action, action])
        assert not over
    oracle.step(4)
    after = call_reference(step, [*state, 4, 4])[3:]
    assert after[:2] == tuple(oracle.rewards[player] for player in oracle.possible_agents)
    assert after[2:] == (1, 1)
    assert all(oracle.terminations.values())
    assert after[mover] == -1
    # An action that is none does the same.
    for action in range(CELLS, 16):
        assert call_reference(step, [*state, action, action])[3:] == after


def test_pictures_are_pettingzoos() -> None:
    game, taken = tictactoe.raw_env(render_mode="rgb_array"), [4, 0, 8, 2, 1]
    game.reset()

    def drawn(state: Any) -> Any:
        game.step(taken.pop(0))
        return game.render()

    compare_pictures(SPEC, "rgb_array", drawn, [[action, action] for action in taken], different=5)
