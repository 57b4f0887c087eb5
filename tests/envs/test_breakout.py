"""Breakout against MinAtar's: the same decisions given to both, then all that either has, at every step."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pytest
from scipy import stats

import pearl_marl
from pearl_marl.envs.breakout.spec import minatar_attributes
from pearl_marl.envs.breakout.step import MINIMAL, TO_LEFT, TO_RIGHT, State
from pearl_marl.golden import call_reference, rng
from pearl_marl.porting.oracle import Actions, Ours

from .minatar import (
    STICKY_EDGES,
    Match,
    assert_a_device_plays_it,
    assert_attributes,
    assert_same_pictures,
    at_random,
    edged_draws,
    initial_words,
    minatar,
    repeats,
)

Array = np.ndarray[Any, Any]
DRAWS = edged_draws(*STICKY_EDGES)
spec = pearl_marl.get_spec("Breakout").with_options


def decide_start(draws: Sequence[int]) -> list[Any]:
    return [draws[0] >> 31]


def match(n: int, after: Callable[[Any], None] = lambda game: None, **options: Any) -> Match:
    return Match(spec(**options), MINIMAL, minatar_attributes, repeats, n, after=after)


def catching(ours: Ours, generator: np.random.Generator) -> Array:
    """Mostly go to where the ball will be."""
    state = State(*ours.words)
    ahead = state.x.astype(int) + np.where(state.rightward, 1, -1)
    towards = np.choose(np.sign(ahead - state.paddle) + 1, [TO_LEFT, 0, TO_RIGHT])
    return np.where(generator.random(ours.n) < 0.9, towards, generator.integers(3, size=ours.n))[:, None]


@pytest.mark.parametrize(
    ("policy", "n", "steps", "episodes", "earned"),
    [
        (at_random, 20, 60, 100, 20),
        (catching, 20, 200, 2, 150),
        pytest.param(at_random, 100, 600, 5_000, 1_000, marks=pytest.mark.exhaustive),
        pytest.param(catching, 100, 1500, 150, 10_000, marks=pytest.mark.exhaustive),
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
        {"sticky_action_prob": 1.0, "difficulty_ramping": False},
        {"sticky_action_prob": 0.5, "use_minimal_action_set": False},
    ],
)
def test_options(options: dict[str, Any]) -> None:
    game = match(8, **options)
    game.play(at_random, 60, seed=2)
    assert game.episodes > 8


def test_the_last_brick() -> None:
    """One brick is left, anywhere; once none is and the ball is down, there are three rows again."""
    n, left, refilled = 40, dict[int, int](), 0

    def count(game: Any) -> None:
        nonlocal refilled
        bricks = np.count_nonzero(game.brick_map)
        refilled += left.get(id(game)) == 0 and bricks == 30
        left[id(game)] = bricks

    game = match(n, after=count)
    game.words[State._fields.index("bricks")] = 1 << np.random.default_rng(3).integers(30, size=n)
    game.play(catching, 60, seed=3, draws=DRAWS)
    assert refilled > n / 8


def test_starts_are_minatars() -> None:
    env = minatar(spec())
    for draw in (0, (1 << 31) - 1, 1 << 31, (1 << 32) - 1):
        env.game.random.queue = decide_start([draw])
        env.game.reset()
        state = spec().layout.built(initial_words(spec(), draw))
        assert_attributes(env.game.env, minatar_attributes(state))


def test_a_device_plays_minatars_game() -> None:
    assert_a_device_plays_it(spec(), repeats, decide_start, n=40, steps=25, ends=60)


def test_draws_decide_as_often_as_minatars() -> None:
    """The side that the ball comes from, and the last action again."""
    n, config = 20_000, spec()
    draws = [rng.draws((1, 2), np.arange(n), 3, index) for index in (0, 1)]
    starts = State(*call_reference(config.positional.initial, draws[:1]))
    assert stats.binomtest(int(starts.rightward.sum()), n, 0.5).pvalue > 0.001
    state = [np.full(n, word) for word in initial_words(config)]
    after = State(*call_reference(config.positional.step, [*state, np.full(n, TO_LEFT), draws[1]])[:-2])
    assert stats.binomtest(int((after.last_action == 0).sum()), n, 0.1).pvalue > 0.001


def test_pictures_are_minatars() -> None:
    assert_same_pictures(spec(), [0, TO_LEFT, *[TO_RIGHT, 0] * 6], different=8)
