"""Seaquest against MinAtar's: the same decisions given to both, then all that either has, at every step."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import gymnasium
import numpy as np
import pytest
from minatar import Environment
from pearl_marl.envs.seaquest.spec import LAYOUT, minatar_attributes
from pearl_marl.envs.seaquest.step import CHANCE, CHANCE_BITS, THIRD
from scipy import stats

import pearl_marl
from pearl_marl import rng
from pearl_marl.compiler.kernels import compile_kernels
from pearl_marl.devices import BatchConfig, Native
from pearl_marl.errors import ArgumentError
from pearl_marl.golden import call_reference
from pearl_marl.spec import EnvSpec

from .tabular import first_episodes

Array = np.ndarray[Any, Any]
COLUMN = {field.name: k for k, field in enumerate(LAYOUT.fields)}
NOTHING, LEFT, UP, RIGHT, DOWN, FIRE = range(6)


def spec(**options: Any) -> EnvSpec:
    return pearl_marl.get_spec("Seaquest").with_options(**options)


class Decisions:
    """Stands for the random state of a MinAtar environment: gives out the decisions that we drew."""

    def __init__(self) -> None:
        self.queue: list[float] = []

    def rand(self) -> float:
        return self.queue.pop(0)

    def randint(self, low: int, high: int) -> int:
        value = self.queue.pop(0)
        assert low <= value < high
        return int(value)

    def expect(self, game: Any, draw_0: int, draw_1: int) -> None:
        """Line up those of a step, in the order in which MinAtar asks for them."""
        assert not self.queue
        self.queue.append((draw_1 & CHANCE) / (1 << CHANCE_BITS))
        if game.e_spawn_timer == 0:
            kind = (draw_0 & CHANCE) / (1 << CHANCE_BITS)
            self.queue += [0.0 if draw_0 >> 31 else 0.5, kind, 1 + (draw_0 >> 28 & 7)]
        if game.d_spawn_timer == 0:
            self.queue += [0.0 if draw_1 >> 31 else 0.5, 1 + (draw_1 >> 28 & 7)]


def minatar(**options: Any) -> Any:
    """Return MinAtar's environment, its draws to be given to it."""
    environment = Environment("seaquest", **options)
    environment.random = environment.env.random = Decisions()
    return environment


def draw_some(generator: np.random.Generator, n: int) -> tuple[Array, Array]:
    """Return the two draws of ``n`` slots; now and then one at which a decision changes."""
    both = generator.integers(1 << 32, size=(2, n), dtype=np.uint32)
    edges = np.array([0, THIRD - 1, THIRD, CHANCE, 26843545, 26843546], np.uint32)
    edged = generator.random((2, n)) < 0.1
    both[edged] = both[edged] & np.uint32(15 << 28) | generator.choice(edges, np.count_nonzero(edged))
    return both[0], both[1]


class Match:
    """The golden step and MinAtar side by side, ``n`` of each.

    Where ``immortal``, an end is put aside and the game goes on, until the sea is as full as it can get.
    """

    def __init__(self, n: int, immortal: bool = False, **options: Any) -> None:
        self.spec, self.n, self.immortal = spec(**options), n, immortal
        self.theirs = [minatar(**options) for _ in range(n)]
        self.start = call_reference(self.spec.positional.initial, ())
        self.ours = [np.full(n, word) for word in self.start]
        # No option changes what is seen, and one kernel is compiled sooner than four.
        self.deliver = compile_kernels(spec()).deliver
        self.episodes = self.most_enemies = self.most_bullets = 0

    def put(self, k: int, ramp: int, divers: int) -> None:
        """Give one game a higher difficulty and some divers."""
        self.ours[COLUMN["ramp"]][k], self.ours[COLUMN["aboard"]][k] = ramp, divers
        words = minatar_attributes(LAYOUT.built(int(column[k]) for column in self.ours))
        vars(self.theirs[k].env).update(words)

    def step(self, actions: Array, draw_0: Array, draw_1: Array) -> None:
        actions = np.asarray(actions, np.uint8)
        *after, rewards, ends = call_reference(
            self.spec.positional.step, [*self.ours, actions, draw_0, draw_1]
        )
        seen = np.empty((self.n, 10, 10, 10), bool)
        self.deliver(tuple(call_reference(self.spec.positional.observe, after)), seen, self.n)
        for k, environment in enumerate(self.theirs):
            game = environment.env
            environment.random.expect(game, int(draw_0[k]), int(draw_1[k]))
            assert environment.act(int(actions[k])) == (rewards[k], bool(ends[k]))
            assert not environment.random.queue
            ours = minatar_attributes(LAYOUT.built(int(column[k]) for column in after))
            # MinAtar counts to -1 in the step that ends an episode.
            theirs = {name: getattr(game, name) for name in ours} | {"oxygen": max(0, game.oxygen)}
            assert ours == theirs
            assert after[COLUMN["last_action"]][k] == environment.last_action
            assert np.array_equal(seen[k], game.state())
            self.most_enemies = max(self.most_enemies, len(game.e_fish) + len(game.e_subs))
            self.most_bullets = max(self.most_bullets, len(game.e_bullets))
            if ends[k]:
                self.episodes += 1
                if self.immortal:
                    game.terminal, game.oxygen = False, max(0, game.oxygen)
                else:
                    environment.reset()
                    environment.last_action = NOTHING
                    for column, word in zip(after, self.start, strict=True):
                        column[k] = word
        self.ours = after

    def y(self) -> Array:
        return self.ours[COLUMN["y"]]


Policy = Callable[[Match, np.random.Generator], Array]


def at_random(match: Match, generator: np.random.Generator) -> Array:
    return generator.integers(6, size=match.n)


def careful(match: Match, generator: np.random.Generator) -> Array:
    """Stay under water while there is no diver aboard, and shoot a lot."""
    actions = generator.choice([LEFT, UP, RIGHT, DOWN, FIRE, FIRE], match.n)
    surfaces = (actions == UP) & (match.y() == 1) & (match.ours[COLUMN["aboard"]] == 0)
    return np.where(surfaces, FIRE, actions)


def bobbing(match: Match, generator: np.random.Generator) -> Array:
    """Go up and down at the surface, where every second step raises the difficulty; shoot sometimes."""
    up_and_down = np.where(match.y() > 0, UP, DOWN)
    return np.where(generator.random(match.n) < 0.1, generator.integers(6, size=match.n), up_and_down)


@pytest.mark.parametrize(
    ("policy", "n", "steps", "episodes"),
    [
        (at_random, 24, 100, 50),
        (careful, 24, 100, 15),
        pytest.param(at_random, 64, 1200, 2000, marks=pytest.mark.exhaustive),
        pytest.param(careful, 64, 1200, 400, marks=pytest.mark.exhaustive),
    ],
)
def test_whole_episodes(policy: Policy, n: int, steps: int, episodes: int) -> None:
    generator, match = np.random.default_rng(1), Match(n)
    for _ in range(steps):
        match.step(policy(match, generator), *draw_some(generator, n))
    assert match.episodes >= episodes


@pytest.mark.parametrize(
    "options",
    [
        {"sticky_action_prob": 0.0},
        {"sticky_action_prob": 1.0},
        {"sticky_action_prob": 0.5, "difficulty_ramping": False},
    ],
)
def test_options(options: dict[str, Any]) -> None:
    generator, match = np.random.default_rng(2), Match(8, immortal=True, **options)
    for _ in range(120):
        match.step(bobbing(match, generator), *draw_some(generator, match.n))
    # The one diver more that is taken from six lets it surface without an end.
    for k in range(match.n):
        match.put(k, ramp=0, divers=6)
    for _ in range(60):
        match.step(bobbing(match, generator), *draw_some(generator, match.n))
    ramps = match.ours[COLUMN["ramp"]]
    assert (ramps.max() > 0) == (
        options["sticky_action_prob"] < 1 and options.get("difficulty_ramping", True)
    )


@pytest.mark.parametrize(
    ("n", "steps"), [(12, 150), pytest.param(20, 600, marks=pytest.mark.exhaustive, id="long")]
)
@pytest.mark.parametrize("policy", [at_random, bobbing])
def test_crowded_seas(n: int, steps: int, policy: Policy) -> None:
    """Every difficulty from the start, and nobody dies of it."""
    generator, match = np.random.default_rng(3), Match(n, immortal=True)
    for k in range(n):
        match.put(k, ramp=int(generator.integers(20)), divers=-1)
    for _ in range(steps):
        match.step(policy(match, generator), *draw_some(generator, n))
    assert match.most_enemies > 12
    assert match.most_bullets > 3


@pytest.mark.parametrize("submarines", [True, False])
def test_no_list_overflows(submarines: bool) -> None:
    """The worst that can come: the difficulty soars, each enemy has a free row, and nobody is shot.

    An entry pushed out of its list while alive would be missing beside MinAtar's.
    """
    n, generator = 6, np.random.default_rng(4)
    match = Match(n, immortal=True, sticky_action_prob=0.0)
    for k in range(n):
        match.put(k, ramp=0, divers=-1)
    for step in range(150):
        row = generator.integers(8, size=n).astype(np.uint32)
        # Each row has a direction of its own, so no row is refused.
        draw_0 = (row & 1) << 31 | row << 28 | np.uint32(0 if submarines else CHANCE)
        # One bobs from the start; the others take their time at first, as long as the seas fill up.
        rest = (np.arange(n) * 6 > step) | (generator.random(n) < 0.2 * (step < 60))
        match.step(np.where(rest, NOTHING, bobbing_only(match)), draw_0, np.full(n, CHANCE, np.uint32))
    assert match.ours[COLUMN["ramp"]].tolist() == [19] * n
    assert match.most_enemies == 29
    assert match.most_bullets == (8 if submarines else 0)


def bobbing_only(match: Match) -> Array:
    return np.where(match.y() > 0, UP, DOWN)


def test_a_device_plays_minatars_game() -> None:
    """The CPU device with its own draws, known from the seed: observations, rewards, ends, resets."""
    n, seed, config = 70, 5, spec()
    device = Native().open(BatchConfig(spec=config, n_envs=n))
    theirs = [minatar() for _ in range(n)]
    seen = device.reset(seed=seed)
    np.testing.assert_array_equal(seen, [environment.state() for environment in theirs])
    generator, ended = np.random.default_rng(6), 0
    for step in range(40):
        actions = generator.integers(6, size=n).astype(np.uint8)
        draws = [rng.draws(rng.seed_words(seed), np.arange(n), step, index) for index in (0, 1)]
        batch = device.step(actions)
        arrivals = batch.arrivals()
        for k, environment in enumerate(theirs):
            environment.random.expect(environment.env, *(int(draw[k]) for draw in draws))
            reward, end = environment.act(int(actions[k]))
            assert (batch.rewards[k], batch.terminations[k]) == (reward, end), f"step {step}"
            np.testing.assert_array_equal(arrivals[k], environment.state())
            if end:
                ended += 1
                environment.reset()
                environment.last_action = NOTHING
            np.testing.assert_array_equal(batch.obs[k], environment.state())
    assert ended > n / 2
    device.close()


def test_draws_decide_as_often_as_minatars() -> None:
    """Direction, row and kind of an enemy, those of a diver and the last action again, by chi-squared."""
    n, config = 40_000, spec()
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


def episodes_of_minatar(n: int, seed: int) -> tuple[Array, Array]:
    """Return length and return of ``n`` episodes of MinAtar's own under the random policy."""
    environment, generator = Environment("seaquest"), np.random.default_rng(seed)
    environment.seed(seed)
    lengths, returns = np.zeros(n, int), np.zeros(n)
    for k in range(n):
        environment.reset()
        environment.last_action = NOTHING
        end = False
        while not end:
            reward, end = environment.act(int(generator.integers(6)))
            lengths[k] += 1
            returns[k] += reward
    return lengths, returns


@pytest.mark.slow
def test_episodes_of_a_random_policy() -> None:
    """20,000 episodes of each: lengths and returns have one distribution, by Kolmogorov and Smirnov."""
    ours = first_episodes(spec(), 20_000, 1, lambda obs, generator: generator.integers(6, size=len(obs)))
    for mine, other in zip(ours, episodes_of_minatar(20_000, 2), strict=True):
        assert stats.ks_2samp(mine, other).pvalue > 0.001


@pytest.mark.parametrize("version", [0, 1])
def test_spaces_are_minatars(version: int) -> None:
    """Both versions have all six actions in one order, for Seaquest has a use for each."""
    theirs = gymnasium.make(f"{str(spec().oracle).removesuffix('1')}{version}")
    assert spec().observation_space == theirs.observation_space
    assert spec().observation_space.dtype == theirs.observation_space.dtype
    assert spec().action_space == theirs.action_space
    assert theirs.unwrapped.action_set == list(range(6))


def test_words_are_no_wider_than_the_papers() -> None:
    words = (LAYOUT.fields, (spec().action,), spec().observation, (spec().reward,))
    assert [sum(field.bits for field in fields) for fields in words] == [694, 3, 440, 4]


@pytest.mark.parametrize("bad", [-0.1, 1.5, float("nan"), "often", True, None])
def test_bad_sticky_action_prob(bad: Any) -> None:
    with pytest.raises(ArgumentError, match=r"sticky_action_prob is .*from 0 to 1"):
        spec(sticky_action_prob=bad)


def test_bad_difficulty_ramping() -> None:
    with pytest.raises(ArgumentError, match="difficulty_ramping is 1; it must be True or False"):
        spec(difficulty_ramping=1)


def test_pictures_are_minatars() -> None:
    pytest.importorskip("seaborn", reason="MinAtar takes its colours from seaborn")
    env = pearl_marl.parallel_env("Seaquest", 3, render_mode="rgb_array")
    theirs = gymnasium.make(str(env.spec.oracle), render_mode="rgb_array")
    theirs.reset()
    game = theirs.unwrapped.game
    game.random = game.env.random = Decisions()
    env.reset(seed=7)
    pictures, over = set(), False
    for tick in range(60):
        draws = [rng.draws(rng.seed_words(7), 1, tick, index) for index in (0, 1)]
        # Down at first and then still, where nothing happens for a while.
        action = DOWN if tick < 5 else (LEFT, RIGHT, FIRE)[tick % 3]
        env.step([UP, action, UP])
        game.random.expect(game.env, *map(int, draws))
        *_, over, _, _ = theirs.step(action)
        if over:
            break
        picture = env.render("agent_1")
        assert picture.dtype == np.uint8
        np.testing.assert_array_equal(picture, np.rint(255 * theirs.render()))
        pictures.add(np.asarray(picture).tobytes())
    assert len(pictures) > 20
    env.close()
    theirs.close()
