"""SpaceInvaders against MinAtar's: the same decisions given to both, then all that either has."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy import stats

import pearl_marl
from pearl_marl.envs.space_invaders.spec import minatar_attributes
from pearl_marl.envs.space_invaders.step import LAST_RAMP, MINIMAL, SHOOT, TO_LEFT, TO_RIGHT
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
spec = pearl_marl.get_spec("SpaceInvaders").with_options
COLUMN = {field.name: k for k, field in enumerate(spec().state)}


class Sky:
    """A match, and how many bullets were in the air at once."""

    def __init__(self, n: int, immortal: bool = False, **options: Any) -> None:
        self.own = self.hostile = self.waves = 0
        self.match = Match(spec(**options), MINIMAL, minatar_attributes, repeats, n, immortal, self.look)
        self.left = dict[int, int]()

    def look(self, game: Any) -> None:
        self.own = max(self.own, np.count_nonzero(game.f_bullet_map))
        self.hostile = max(self.hostile, np.count_nonzero(game.e_bullet_map))
        aliens = np.count_nonzero(game.alien_map)
        self.waves += self.left.get(id(game), 24) <= 2 and aliens == 24
        self.left[id(game)] = aliens

    def play(self, policy: Actions, steps: int, seed: int) -> None:
        self.match.play(policy, steps, seed, DRAWS)


def dodging(ours: Ours, generator: np.random.Generator) -> Array:
    """Go out of a bullet's way, and shoot a lot."""
    x, bomb, low = (ours.words[COLUMN[name]].astype(int) for name in ("x", "bomb_x", "bomb_y"))
    danger = (ours.words[COLUMN["bomb_flies"]] == 1) & (bomb == x) & (low > 4)
    actions = generator.choice([TO_LEFT, TO_RIGHT, SHOOT, SHOOT, SHOOT], ours.n)
    return np.where(danger, np.where(x > 4, TO_LEFT, TO_RIGHT), actions)[:, None]


@pytest.mark.parametrize(
    ("policy", "n", "steps", "episodes", "earned"),
    [
        (at_random, 16, 120, 15, 50),
        (dodging, 16, 200, 5, 200),
        pytest.param(at_random, 60, 1000, 600, 3_000, marks=pytest.mark.exhaustive),
        pytest.param(dodging, 60, 1200, 300, 6_000, marks=pytest.mark.exhaustive),
    ],
)
def test_whole_episodes(policy: Actions, n: int, steps: int, episodes: int, earned: int) -> None:
    sky = Sky(n)
    sky.play(policy, steps, seed=1)
    assert sky.match.episodes >= episodes
    assert sky.match.earned >= earned


@pytest.mark.parametrize(
    "options",
    [
        {"sticky_action_prob": 0.0},
        {"sticky_action_prob": 1.0, "use_minimal_action_set": False},
        {"sticky_action_prob": 0.5, "difficulty_ramping": False},
    ],
)
def test_options(options: dict[str, Any]) -> None:
    n, sky = 8, Sky(8, immortal=True, **options)
    few(sky, n)
    before = sky.match.words[COLUMN["ramp"]].copy()
    sky.play(at_random, 80, seed=2)
    rises = options["sticky_action_prob"] < 1 and options.get("difficulty_ramping", True)
    assert (sky.match.words[COLUMN["ramp"]] > before).any() == rises


def few(sky: Sky, n: int) -> None:
    """Leave one or two aliens of each formation, anywhere on the board, at every difficulty."""
    generator, words = np.random.default_rng(3), sky.match.words
    rows, columns = generator.integers(4, size=(2, n)), generator.integers(6, size=(2, n))
    words[COLUMN["aliens_alive"]] = np.bitwise_or.reduce(1 << 6 * rows + columns)
    # So that the columns, at left - 5 and on, are on the board, and the rows are above the last two.
    words[COLUMN["aliens_left"]] = generator.integers(5 - columns.min(0), 15 - columns.max(0))
    words[COLUMN["aliens_top"]] = generator.integers(0, 8 - rows.max(0))
    words[COLUMN["aliens_leftward"]] = generator.integers(2, size=n)
    words[COLUMN["move_timer"]] = generator.integers(13, size=n)
    words[COLUMN["bomb_timer"]] = generator.integers(11, size=n)
    words[COLUMN["x"]] = generator.integers(10, size=n)
    words[COLUMN["ramp"]] = generator.integers(LAST_RAMP + 1, size=n)


@pytest.mark.parametrize(("n", "steps"), [(40, 60), pytest.param(200, 400, marks=pytest.mark.exhaustive)])
def test_the_last_aliens(n: int, steps: int) -> None:
    sky = Sky(n)
    few(sky, n)
    sky.play(dodging, steps, seed=4)
    assert sky.waves > n / 20
    assert sky.match.episodes > n / 4


@pytest.mark.parametrize(
    ("n", "steps", "ramp"), [(12, 250, 0), pytest.param(24, 2500, LAST_RAMP, marks=pytest.mark.exhaustive)]
)
def test_no_bullet_is_lost(n: int, steps: int, ramp: int) -> None:
    """Nobody dies, aliens go around the board and wave follows wave; all three bullets are in the air.

    A bullet that had no place would be missing beside MinAtar's.
    """
    sky = Sky(n, immortal=True)
    sky.play(dodging, steps, seed=5)
    assert (sky.own, sky.hostile) == (2, 1)
    assert sky.match.words[COLUMN["ramp"]].max() >= ramp


def test_a_device_plays_minatars_game() -> None:
    assert_a_device_plays_it(spec(), repeats, lambda draws: [], n=24, steps=60, ends=8)


def test_draws_decide_as_often_as_minatars() -> None:
    n, config = 20_000, spec()
    state = [np.full(n, word) for word in initial_words(config)]
    after = call_reference(
        config.positional.step, [*state, np.full(n, SHOOT), rng.draws((1, 2), np.arange(n), 3, 0)]
    )
    assert stats.binomtest(int((after[COLUMN["last_action"]] == 0).sum()), n, 0.1).pvalue > 0.001


def test_pictures_are_minatars() -> None:
    assert_same_pictures(spec(), [SHOOT, TO_LEFT, TO_LEFT, SHOOT, TO_RIGHT, 0] * 5, different=20)
