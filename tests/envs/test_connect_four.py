"""ConnectFour against PettingZoo's ``connect_four_v3``: the same moves, and what comes of them."""

from __future__ import annotations

import os
from typing import Any, NamedTuple

os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")

import numpy as np
import pytest
from pettingzoo.classic.connect_four import connect_four

import pearl_marl
from pearl_marl.envs.connect_four.step import CELLS, COLUMNS, has_four
from pearl_marl.golden import call_reference, reference
from pearl_marl.rendering import renderer

Array = np.ndarray[Any, Any]
initial, step, observe, masks = pearl_marl.get_spec("ConnectFour").positional[:4]
PLAYERS = ("player_0", "player_1")
MASKS = 2
"""Where the masks of both stand in a record of a move."""


class Games(NamedTuple):
    """What PettingZoo makes of games: by move and game, and of each player."""

    actions: Array
    played: Array
    observations: Array
    masks: Array
    rewards: Array
    ends: Array


def played_by_pettingzoo(moves: int, seed: int) -> Games:
    """Play games of random legal moves to their ends, as many as make so many moves.

    What is observed before the first move stands before the first move's row.
    """
    oracle, generator = connect_four.raw_env(), np.random.default_rng(seed)
    most, chances = CELLS, generator.random((moves, CELLS))
    games: list[list[tuple[Any, ...]]] = []
    left = moves
    while left > 0:
        oracle.reset()
        game = [(0, *_seen(oracle))]
        for chance in chances[len(games)]:
            legal = np.flatnonzero(game[-1][MASKS].any(0))
            action = int(legal[int(chance * len(legal))])
            oracle.step(action)
            game.append((action, *_seen(oracle)))
            if oracle.terminations["player_0"]:
                break
        games.append(game)
        left -= len(game) - 1
    blank = games[0][0]
    padded = [game + [blank] * (most + 1 - len(game)) for game in games]
    columns = [
        np.array([[row[k] for row in game] for game in padded]).swapaxes(0, 1) for k in range(len(blank))
    ]
    actions, observations, legal, rewards, ends = columns
    lengths = np.array([len(game) - 1 for game in games])
    return Games(actions[1:], np.arange(most)[:, None] < lengths, observations, legal, rewards, ends)


def _seen(oracle: Any) -> tuple[Any, ...]:
    views = [oracle.observe(player) for player in PLAYERS]
    return (
        np.array([view["observation"] for view in views]),
        np.array([view["action_mask"] for view in views]),
        [oracle.rewards[player] for player in PLAYERS],
        [oracle.terminations[player] for player in PLAYERS],
    )


def unpacked(boards: tuple[Array, ...]) -> Array:
    """Return PettingZoo's planes of an observation."""
    planes = [np.asarray(board)[:, None] >> np.arange(CELLS) & 1 for board in boards]
    return np.stack(planes, -1).reshape(-1, 6, 7, 2)


def test_observations_are_unpacked() -> None:
    spec = pearl_marl.get_spec("ConnectFour")
    assert spec.positional.unpack is not None
    boards = np.random.default_rng(0).integers(1 << CELLS, size=(2, 50))
    rows = np.empty((50, 84), np.int8)
    for own, other, row in zip(*boards, rows, strict=True):
        spec.positional.unpack(own, other, row)
    np.testing.assert_array_equal(rows.reshape(-1, 6, 7, 2), unpacked(tuple(boards)))


def compare(moves: int, seed: int) -> Games:
    """Replay PettingZoo's games, all at once, and compare what can be seen after every move."""
    games = played_by_pettingzoo(moves, seed)
    n, observers, judges = (
        games.actions.shape[1],
        *([reference(f, k) for k in range(2)] for f in (observe, masks)),
    )
    state = [np.full(n, word) for word in call_reference(initial, ())]
    generator = np.random.default_rng(seed + 1)
    for t in range(CELLS + 1):
        now = np.ones(n, bool) if t == 0 else games.played[t - 1]
        for agent in range(2):
            seen = unpacked(observers[agent](*state))
            np.testing.assert_array_equal(seen[now], games.observations[t, now, agent])
            legal = np.stack(judges[agent](*state), 1)
            np.testing.assert_array_equal(legal[now], games.masks[t, now, agent])
        if t == CELLS:
            break
        actions = generator.integers(8, size=(2, n))  # of who is not on turn, anything
        actions[t % 2] = games.actions[t]
        *state, reward_0, reward_1, over_0, over_1 = call_reference(step, [*state, *actions])
        now = games.played[t]
        np.testing.assert_array_equal(np.stack([reward_0, reward_1], 1)[now], games.rewards[t + 1, now])
        np.testing.assert_array_equal(np.stack([over_0, over_1], 1)[now], games.ends[t + 1, now])
    return games


@pytest.mark.parametrize("moves", [25_000, pytest.param(100_000, marks=pytest.mark.exhaustive)])
def test_moves(moves: int) -> None:
    games = compare(moves, seed=moves)
    last = games.played.sum(0)
    rewards = games.rewards[last, np.arange(len(last)), 0]
    counts = [int((rewards == reward).sum()) for reward in (1, -1, 0)]
    print("{:,} moves; the first won {}, lost {}, drew {}".format(games.played.sum(), *counts))
    assert games.played.sum() >= moves
    assert min(counts) >= 2


def test_where_four_are_in_a_row() -> None:
    """Every four bits that are evenly spaced, of which those on the edges would run on in the next row."""
    cells = [(begin, by) for by in (1, 6, 7, 8) for begin in range(CELLS) if begin + 3 * by < CELLS]
    boards = np.array([sum(1 << begin + k * by for k in range(4)) for begin, by in cells])
    straight = []
    for begin, by in cells:
        places = [divmod(begin + k * by, COLUMNS) for k in range(4)]
        rows, columns = (np.diff(line) for line in zip(*places, strict=True))
        straight.append(max(abs(rows)) <= 1 and max(abs(columns)) <= 1)
    assert sum(straight) == 69
    np.testing.assert_array_equal(call_reference(has_four, [boards])[0], straight)
    for k in range(4):  # and no three of them
        holes = [board & ~(1 << begin + k * by) for board, (begin, by) in zip(boards, cells, strict=True)]
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
    assert [reward_0, reward_1] == [oracle.rewards[player] for player in PLAYERS]
    assert [over_0, over_1] == [oracle.terminations[player] for player in PLAYERS] == [1, 1]
    assert [reward_0, reward_1][mover] == -1
    # An action that is none does the same.
    assert call_reference(step, [*state, 7, 7])[3:] == (reward_0, reward_1, 1, 1)


def test_pictures_are_pettingzoos() -> None:
    oracle, state = connect_four.raw_env(render_mode="rgb_array"), call_reference(initial, ())
    oracle.reset()
    drawn = renderer(pearl_marl.get_spec("ConnectFour"), "rgb_array")
    for action in (3, 3, 2, 6, 0):
        oracle.step(action)
        *state, _, _, _, _ = call_reference(step, [*state, action, action])
    np.testing.assert_array_equal(drawn.render(np.array(state)), oracle.render())
    drawn.close()
