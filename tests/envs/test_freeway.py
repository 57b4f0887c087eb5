"""Freeway against MinAtar's: the same decisions given to both, then all that either has, at every step."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from scipy import stats

import pearl_marl
from pearl_marl.envs.freeway.spec import minatar_attributes
from pearl_marl.envs.freeway.step import GO_DOWN, GO_UP, LANES, MINIMAL, TIME_LIMIT
from pearl_marl.envs.minatar import UP
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
spec = pearl_marl.get_spec("Freeway").with_options
COLUMN = {field.name: k for k, field in enumerate(spec().state)}


def decide_start(draws: Sequence[int]) -> list[Any]:
    """The speeds of eight cars, and a direction for each: of a draw, four decimal digits."""
    digits = []
    for draw in draws:
        for _ in range(4):
            digits.append(draw * 10 >> 32)
            draw = draw * 10 & 0xFFFFFFFF
    cases = np.array(digits)
    return [1 + cases % 5, np.where(cases >= 5, 0.75, 0.25)]


def decide(environment: Any, action: int, draws: Sequence[int]) -> list[Any]:
    """Whether the last action is repeated; then new speeds, if the chicken arrives."""
    *first, draw_0, draw_1 = draws
    queue, game = repeats(environment, action, first), environment.env
    if queue[0] < environment.sticky_action_prob:
        action = environment.last_action
    arrives = action == UP and game.move_timer == 0 and game.pos == 1
    return queue + (decide_start([draw_0, draw_1]) if arrives else [])


def clamp(game: Any) -> None:
    """MinAtar counts to -1 in the step that ends an episode."""
    game.terminate_timer = max(0, game.terminate_timer)


def match(n: int, immortal: bool = False, **options: Any) -> Match:
    game = Match(spec(**options), MINIMAL, minatar_attributes, decide, n, immortal, clamp)
    draws = np.random.default_rng(0).integers(1 << 32, size=(2, n))
    game.words = list(call_reference(game.spec.positional.initial, draws))
    return game


def upward(ours: Ours, generator: np.random.Generator) -> Array:
    return generator.choice([0, GO_UP, GO_UP, GO_UP, GO_UP, GO_DOWN], (ours.n, 1))


@pytest.mark.parametrize(
    ("policy", "n", "steps", "earned"),
    [
        (at_random, 12, 150, 0),
        (upward, 16, 250, 10),
        pytest.param(at_random, 20, 2600, 0, marks=pytest.mark.exhaustive),
        pytest.param(upward, 24, 5200, 500, marks=pytest.mark.exhaustive),
    ],
)
def test_whole_games(policy: Actions, n: int, steps: int, earned: int) -> None:
    game = match(n)
    game.play(policy, steps, seed=1, draws=DRAWS)
    assert game.episodes == n * (steps // (TIME_LIMIT + 1))
    assert game.earned >= earned


def test_the_end() -> None:
    """An episode lasts 2,501 steps: it ends after the step that finds no time left."""
    n, game = 8, match(8)
    game.words[COLUMN["steps_left"]] = np.arange(n)
    game.play(upward, 40, seed=2)
    assert game.episodes == n


@pytest.mark.parametrize("y", range(1, 10))
def test_every_lane(y: int) -> None:
    """The chicken is in each lane, and all cars are beside its column, to the left or to the right."""
    n, game = 40, match(40)
    right = np.random.default_rng(y).integers(256, size=n)
    game.words[COLUMN["y"]][:] = y
    for k in range(4):
        left_bit, right_bit = 3 >> k & 1, 5 >> k & 1
        game.words[COLUMN[f"cars_column_{k}"]] = left_bit * (255 & ~right) | right_bit * right
    game.play(at_random, 3, seed=y, draws=DRAWS)
    hit = int(((y - game.words[COLUMN["y"]].astype(int)) < -1).sum())
    assert (0 < hit < n) == (y < 8)


@pytest.mark.parametrize(
    "options",
    [
        {"sticky_action_prob": 0.0},
        {"sticky_action_prob": 1.0, "use_minimal_action_set": False, "difficulty_ramping": False},
        {"sticky_action_prob": 0.5},
    ],
)
def test_options(options: dict[str, Any]) -> None:
    game = match(8, **options)
    game.play(at_random, 100, seed=2)


def test_starts_are_minatars() -> None:
    env = minatar(spec())
    for seed in range(50):
        draws = np.random.default_rng(seed).integers(1 << 32, size=2).tolist()
        env.game.random.queue = decide_start(draws)
        env.game.reset()
        state = spec().layout.built(initial_words(spec(), *draws))
        assert_attributes(env.game.env, minatar_attributes(state))


def test_a_device_plays_minatars_game() -> None:
    assert_a_device_plays_it(spec(), decide, decide_start, n=16, steps=40, ends=0)


def test_draws_decide_as_often_as_minatars() -> None:
    """Direction and speed of each car at a start, by chi-squared; cars do not depend on each other."""
    n, config = 20_000, spec()
    draws = [rng.draws((1, 2), np.arange(n), 3, index) for index in range(3)]
    start = call_reference(config.positional.initial, draws[:2])
    cases = np.zeros((LANES, n), int)
    for name in ("cars_rightward", "cars_interval_2", "cars_interval_1", "cars_interval_0"):
        cases = 2 * cases + (start[COLUMN[name]] >> np.arange(LANES)[:, None] & 1)
    cases = cases // 8 * 5 + cases % 8 - 1
    for lane in range(LANES):
        assert stats.chisquare(np.bincount(cases[lane], minlength=10)).pvalue > 0.001
        pairs = 10 * cases[lane] + cases[(lane + 1) % LANES]
        assert stats.chisquare(np.bincount(pairs, minlength=100)).pvalue > 0.001
    state = [np.full(n, word) for word in initial_words(config)]
    after = call_reference(config.positional.step, [*state, np.full(n, GO_UP), draws[2], *draws[:2]])
    assert stats.binomtest(int((after[COLUMN["last_action"]] == 0).sum()), n, 0.1).pvalue > 0.001


def test_pictures_are_minatars() -> None:
    assert_same_pictures(spec(), [0, *[GO_UP] * 30], different=20)
