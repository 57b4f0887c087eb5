"""Asterix against MinAtar's: the same decisions given to both, then all that either has, at every step."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pytest
from scipy import stats

import pearl_marl
from pearl_marl.envs.asterix.spec import minatar_attributes
from pearl_marl.envs.asterix.step import LAST_RAMP, MINIMAL, RAMP_STEPS
from pearl_marl.envs.minatar import DOWN
from pearl_marl.golden import call_reference, rng
from pearl_marl.porting.oracle import Actions, Ours

from .minatar import (
    STICKY_EDGES,
    Match,
    assert_a_device_plays_it,
    assert_same_pictures,
    at_random,
    edged_draws,
    initial_words,
    repeats,
)

Array = np.ndarray[Any, Any]
DRAWS = edged_draws(*STICKY_EDGES)
spec = pearl_marl.get_spec("Asterix").with_options
COLUMN = {field.name: k for k, field in enumerate(spec().state)}


def decide(environment: Any, action: int, draws: Sequence[int]) -> list[Any]:
    """Whether the last action is repeated; then of what spawns the direction, the kind and the slot."""
    *first, draw = draws
    queue, game = repeats(environment, action, first), environment.env
    if game.spawn_timer == 0:
        digits = []
        empty = game.entities.count(None)
        for n in (2, 3, empty):
            digits.append(draw * n >> 32)
            draw = draw * n & 0xFFFFFFFF
        rightward, kind, slot = digits
        queue += [0.0 if rightward else 0.5, 0.5 if kind else 0.0, *[slot][:empty]]
    return queue


def match(n: int, after: Callable[[Any], None] = lambda game: None, **options: Any) -> Match:
    immortal = options.pop("immortal", False)
    return Match(spec(**options), MINIMAL, minatar_attributes, decide, n, immortal, after)


def careful(ours: Ours, generator: np.random.Generator) -> Array:
    """Leave a row in which an enemy comes near; go to rows with treasure."""
    boards = ours.observations().reshape(ours.n, 10, 10, 4)
    actions = generator.choice([0, 0, 1, 3, 2, 4], ours.n)
    for k, board in enumerate(boards):
        y, x = (int(at[0]) for at in np.nonzero(board[..., 0]))
        near = slice(max(x - 2, 0), x + 3)
        if board[y, near, 1].any():
            free = [a for a, to in ((2, y - 1), (4, y + 1)) if 1 <= to <= 8 and not board[to, near, 1].any()]
            actions[k] = generator.choice(free or [1, 3])
        elif generator.random() < 0.5 and board[..., 3].any():
            to = int(np.nonzero(board[..., 3])[0][0])
            clear = 1 <= y + np.sign(to - y) <= 8 and not board[y + np.sign(to - y), near, 1].any()
            actions[k] = (2 if to < y else 4) if to != y and clear else 0
    return actions[:, None]


@pytest.mark.parametrize(
    ("policy", "n", "steps", "episodes", "earned"),
    [
        (at_random, 20, 150, 20, 10),
        (careful, 20, 150, 2, 40),
        pytest.param(at_random, 100, 600, 500, 300, marks=pytest.mark.exhaustive),
        pytest.param(careful, 100, 1200, 200, 1_000, marks=pytest.mark.exhaustive),
    ],
)
def test_whole_episodes(policy: Actions, n: int, steps: int, episodes: int, earned: int) -> None:
    game = match(n)
    game.play(policy, steps, seed=1, draws=DRAWS)
    assert game.episodes >= episodes
    assert game.earned >= earned


@pytest.mark.parametrize(
    "options",
    [
        {"sticky_action_prob": 0.0},
        {"sticky_action_prob": 1.0, "use_minimal_action_set": False},
        {"sticky_action_prob": 0.5, "difficulty_ramping": False},
    ],
)
def test_options(options: dict[str, Any]) -> None:
    game = match(8, immortal=True, **options)
    game.play(at_random, 110, seed=2)
    rises = options.get("difficulty_ramping", True)
    assert set(game.words[COLUMN["ramp"]].tolist()) == {int(rises)}


@pytest.mark.parametrize(("n", "steps"), [(20, 120), pytest.param(60, 1100, marks=pytest.mark.exhaustive)])
def test_full_rows(n: int, steps: int) -> None:
    """Every difficulty from the start, and nobody dies of it: the rows fill up, and then nothing spawns."""
    most = 0

    def count(game: Any) -> None:
        nonlocal most
        most = max(most, 8 - game.entities.count(None))

    generator, game = np.random.default_rng(3), match(n, count, immortal=True)
    game.words[COLUMN["ramp"]] = generator.integers(LAST_RAMP + 1, size=n)
    game.words[COLUMN["ramp_timer"]] = generator.integers(RAMP_STEPS + 1, size=n)
    game.words[COLUMN["spawn_timer"]][:] = game.words[COLUMN["move_timer"]][:] = 0
    game.play(at_random, steps, seed=3, draws=DRAWS)
    assert most == 8
    assert game.words[COLUMN["ramp"]].max() == LAST_RAMP
    assert game.earned > n / 2


def test_a_device_plays_minatars_game() -> None:
    assert_a_device_plays_it(spec(), decide, lambda draws: [], n=24, steps=100, ends=8)


@pytest.mark.parametrize("taken", [0, 0b10100101])
def test_draws_decide_as_often_as_minatars(taken: int) -> None:
    """Direction, kind and row of what spawns among the rows that are taken, by chi-squared."""
    n, config = 20_000, spec()
    state = [np.full(n, word) for word in initial_words(config)]
    state[COLUMN["spawn_timer"]][:], state[COLUMN["entities_alive"]][:] = 0, taken
    state[COLUMN["last_action"]][:] = DOWN
    draws = [rng.draws((1, 2), np.arange(n), 3, index) for index in (0, 1)]
    after = call_reference(config.positional.step, [*state, np.zeros(n, np.uint8), *draws])
    row = after[COLUMN["entities_alive"]].astype(int) ^ taken
    assert (np.bitwise_count(row) == 1).all()
    rightward, gold = ((after[COLUMN[f"entities_{name}"]] & row) != 0 for name in ("rightward", "gold"))
    empty = [k for k in range(8) if not taken >> k & 1]
    cases = 4 * np.searchsorted(empty, np.log2(row).astype(int)) + 2 * rightward + gold
    expected = np.where(np.arange(4 * len(empty)) % 2, 1 / 3, 2 / 3) * n / len(empty) / 2
    assert stats.chisquare(np.bincount(cases, minlength=len(expected)), expected).pvalue > 0.001
    repeated = int((after[COLUMN["last_action"]] == DOWN).sum())
    assert stats.binomtest(repeated, n, 0.1).pvalue > 0.001


def test_pictures_are_minatars() -> None:
    assert_same_pictures(spec(), [0] * 10 + [1, 2, 3, 4] * 12, different=20)
