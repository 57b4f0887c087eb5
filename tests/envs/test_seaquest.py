"""Seaquest against MinAtar's: the same decisions given to both, then all that either has, at every step."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from scipy import stats

import pearl_marl
from pearl_marl.envs.seaquest.spec import minatar_attributes
from pearl_marl.envs.seaquest.step import CHANCE, CHANCE_BITS, THIRD
from pearl_marl.golden import call_reference, rng
from pearl_marl.porting.oracle import Actions, Draws, Ours

from .minatar import Match, assert_a_device_plays_it, assert_same_pictures, edged_draws

Array = np.ndarray[Any, Any]
spec = pearl_marl.get_spec("Seaquest").with_options
COLUMN = {field.name: k for k, field in enumerate(spec().state)}
NOTHING, LEFT, UP, RIGHT, DOWN, FIRE = range(6)


def decide(environment: Any, action: int, draws: Sequence[int]) -> list[Any]:
    """Line up the decisions of a step, in the order in which MinAtar asks for them."""
    game, (draw_0, draw_1) = environment.env, draws
    queue: list[Any] = [(draw_1 & CHANCE) / (1 << CHANCE_BITS)]
    if game.e_spawn_timer == 0:
        kind = (draw_0 & CHANCE) / (1 << CHANCE_BITS)
        queue += [0.0 if draw_0 >> 31 else 0.5, kind, 1 + (draw_0 >> 28 & 7)]
    if game.d_spawn_timer == 0:
        queue += [0.0 if draw_1 >> 31 else 0.5, 1 + (draw_1 >> 28 & 7)]
    return queue


DRAWS = edged_draws(0, THIRD - 1, THIRD, CHANCE, 26843545, 26843546, mask=CHANCE)


class Sea:
    """Matches of Seaquest, and how full the sea was in them."""

    def __init__(self, n: int, immortal: bool = False, **options: Any) -> None:
        self.most_enemies = self.most_bullets = 0
        self.match = Match(
            spec(**options), range(6), minatar_attributes, decide, n, immortal, after=self.look
        )
        self.words = self.match.words

    def look(self, game: Any) -> None:
        game.oxygen = max(0, game.oxygen)  # MinAtar counts to -1 in the step that ends an episode
        self.most_enemies = max(self.most_enemies, len(game.e_fish) + len(game.e_subs))
        self.most_bullets = max(self.most_bullets, len(game.e_bullets))

    def play(self, policy: Actions, steps: int, seed: int, draws: Draws = DRAWS) -> None:
        self.match.play(policy, steps, seed, draws)
        self.words = self.match.words


def at_random(ours: Ours, generator: np.random.Generator) -> Array:
    return generator.integers(6, size=(ours.n, 1))


def careful(ours: Ours, generator: np.random.Generator) -> Array:
    """Stay under water while there is no diver aboard, and shoot a lot."""
    actions = generator.choice([LEFT, UP, RIGHT, DOWN, FIRE, FIRE], ours.n)
    surfaces = (actions == UP) & (ours.words[COLUMN["y"]] == 1) & (ours.words[COLUMN["aboard"]] == 0)
    return np.where(surfaces, FIRE, actions)[:, None]


def up_and_down(ours: Ours) -> Array:
    return np.where(ours.words[COLUMN["y"]] > 0, UP, DOWN)


def bobbing(ours: Ours, generator: np.random.Generator) -> Array:
    """Go up and down at the surface, where every second step raises the difficulty; shoot sometimes."""
    others = generator.integers(6, size=ours.n)
    return np.where(generator.random(ours.n) < 0.1, others, up_and_down(ours))[:, None]


@pytest.mark.parametrize(
    ("policy", "n", "steps", "episodes"),
    [
        (at_random, 24, 100, 50),
        (careful, 24, 100, 15),
        pytest.param(at_random, 64, 1200, 2000, marks=pytest.mark.exhaustive),
        pytest.param(careful, 64, 1200, 400, marks=pytest.mark.exhaustive),
    ],
)
def test_whole_episodes(policy: Actions, n: int, steps: int, episodes: int) -> None:
    match = Sea(n)
    match.play(policy, steps, seed=1)
    assert match.match.episodes >= episodes


@pytest.mark.parametrize(
    "options",
    [
        {"sticky_action_prob": 0.0},
        {"sticky_action_prob": 1.0},
        {"sticky_action_prob": 0.5, "difficulty_ramping": False},
    ],
)
def test_options(options: dict[str, Any]) -> None:
    match = Sea(8, immortal=True, **options)
    match.play(bobbing, 120, seed=2)
    # The one diver more that is taken from six lets it surface without an end.
    match.words[COLUMN["ramp"]][:], match.words[COLUMN["aboard"]][:] = 0, 6
    match.play(bobbing, 60, seed=3)
    ramps = match.words[COLUMN["ramp"]]
    assert (ramps.max() > 0) == (
        options["sticky_action_prob"] < 1 and options.get("difficulty_ramping", True)
    )


@pytest.mark.parametrize(
    ("n", "steps"), [(12, 150), pytest.param(20, 600, marks=pytest.mark.exhaustive, id="long")]
)
@pytest.mark.parametrize("policy", [at_random, bobbing])
def test_crowded_seas(n: int, steps: int, policy: Actions) -> None:
    """Every difficulty from the start, and nobody dies of it."""
    match = Sea(n, immortal=True)
    match.words[COLUMN["ramp"]][:] = np.random.default_rng(3).integers(20, size=n)
    match.words[COLUMN["aboard"]][:] = -1
    match.play(policy, steps, seed=3)
    assert match.most_enemies > 12
    assert match.most_bullets > 3


@pytest.mark.parametrize("submarines", [True, False])
def test_no_list_overflows(submarines: bool) -> None:
    """The worst that can come: the difficulty soars, each enemy has a free row, and nobody is shot.

    An entry pushed out of its list while alive would be missing beside MinAtar's.
    """
    n, steps = 6, itertools.count()
    match = Sea(n, immortal=True, sticky_action_prob=0.0)
    match.words[COLUMN["aboard"]][:] = -1

    def draws(generator: np.random.Generator, n: int, count: int) -> Array:
        row = generator.integers(8, size=n)
        # Each row has a direction of its own, so no row is refused.
        enemy = (row & 1) << 31 | row << 28 | (0 if submarines else CHANCE)
        return np.stack([enemy, np.full(n, CHANCE)], 1)[:, :count]

    def hurried(ours: Ours, generator: np.random.Generator) -> Array:
        # One bobs from the start; the others take their time at first, as long as the seas fill up.
        step = next(steps)
        rest = (np.arange(n) * 6 > step) | (generator.random(n) < 0.2 * (step < 60))
        return np.where(rest, NOTHING, up_and_down(ours))[:, None]

    match.play(hurried, 150, seed=4, draws=draws)
    assert match.words[COLUMN["ramp"]].tolist() == [19] * n
    assert match.most_enemies == 29
    assert match.most_bullets == (8 if submarines else 0)


def test_a_device_plays_minatars_game() -> None:
    assert_a_device_plays_it(spec(), decide, lambda draws: [], n=24, steps=40, ends=10)


def test_draws_decide_as_often_as_minatars() -> None:
    """Direction, row and kind of an enemy, those of a diver and the last action again, by chi-squared."""
    n, config = 10_000, spec()
    state = [np.full(n, word) for word in call_reference(config.positional.initial, ())]
    state[COLUMN["enemy_timer"]][:] = state[COLUMN["diver_timer"]][:] = 0
    state[COLUMN["last_action"]][:] = FIRE
    draws = [rng.draws((1, 2), np.arange(n), 3, index) for index in (0, 1)]
    after = call_reference(config.positional.step, [*state, np.full(n, DOWN, np.uint8), *draws])
    enemies = np.zeros(n, int)
    for name in ("row_0", "row_1", "row_2", "rightward", "submarine"):
        enemies = 2 * enemies + (after[COLUMN[f"enemies_{name}"]] >> 28 & 1)
    expected = np.where(np.arange(32) % 2, 1 / 3, 2 / 3) * n / 16
    assert stats.chisquare(np.bincount(enemies, minlength=32), expected).pvalue > 0.001
    assert after[COLUMN["enemies_alive"]].tolist() == [1 << 28] * n
    divers = np.bincount(after[COLUMN["divers_1"]] >> 4 & 15, minlength=16)
    assert stats.chisquare(divers).pvalue > 0.001
    repeated = int((after[COLUMN["last_action"]] == FIRE).sum())
    assert stats.binomtest(repeated, n, 0.1).pvalue > 0.001


def test_pictures_are_minatars() -> None:
    # Down at first and then still, where nothing happens for a while.
    assert_same_pictures(spec(), [UP, *[DOWN] * 5, *[LEFT, RIGHT, FIRE] * 18], different=20, seed=7)
