"""Seaquest against MinAtar's: the same decisions given to both, then all that either has, at every step."""

from __future__ import annotations

import itertools
from typing import Any

import gymnasium
import numpy as np
import pytest
from minatar import Environment
from scipy import stats

import pearl_marl
from pearl_marl.devices import BatchConfig, Native
from pearl_marl.envs.seaquest.spec import LAYOUT, minatar_attributes
from pearl_marl.envs.seaquest.step import CHANCE, CHANCE_BITS, THIRD
from pearl_marl.errors import ArgumentError
from pearl_marl.golden import call_reference, rng
from pearl_marl.porting.oracle import Actions, Draws, Games, Ours, Outcome, compare
from pearl_marl.spec import EnvSpec
from pearl_marl.testing import assert_same_play, compare_pictures, first_episodes
from pearl_marl.testing.oracles import random_actions_of

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


def some_draws(generator: np.random.Generator, n: int, count: int) -> Array:
    """Return the two draws of ``n`` slots; now and then one at which a decision changes."""
    both = generator.integers(1 << 32, size=(n, count), dtype=np.uint32)
    edges = np.array([0, THIRD - 1, THIRD, CHANCE, 26843545, 26843546], np.uint32)
    edged = generator.random((n, count)) < 0.1
    both[edged] = both[edged] & np.uint32(15 << 28) | generator.choice(edges, np.count_nonzero(edged))
    return both.astype(np.int64)


class Match:
    """The golden step and MinAtar side by side, ``n`` of each.

    Where ``immortal``, an end is put aside and the game goes on, until the sea is as full as it can get.
    """

    def __init__(self, n: int, immortal: bool = False, **options: Any) -> None:
        self.spec, self.n, self.immortal = spec(**options), n, immortal
        self.theirs = [minatar(**options) for _ in range(n)]
        self.words = [np.full(n, word) for word in call_reference(self.spec.positional.initial, ())]
        self.episodes = self.most_enemies = self.most_bullets = 0

    def play(self, policy: Actions, steps: int, seed: int, draws: Draws = some_draws) -> None:
        """Go on by so many steps, and compare whatever the two have after each."""
        games = Games(self.spec, self.theirs, self.pose, self.step, lambda game: Outcome(game.env.state()))
        for move in compare(
            self.spec,
            games,
            self.n,
            steps,
            state=self.words,
            actions=policy,
            draws=draws,
            seed=seed,
            restarts=not self.immortal,
        ):
            self.words = move.after
            self.episodes += int(move.ended.sum())
            for k, environment in enumerate(self.theirs):
                self.compare_attributes(k, environment)

    def pose(self, environment: Any, state: Any) -> None:
        environment.reset()
        vars(environment.env).update(minatar_attributes(state))
        environment.last_action = state.last_action

    def step(self, environment: Any, actions: list[int], draws: list[int]) -> Outcome:
        game = environment.env
        environment.random.expect(game, *draws)
        reward, end = environment.act(actions[0])
        assert not environment.random.queue
        if self.immortal:
            game.terminal, game.oxygen = False, max(0, game.oxygen)
        self.most_enemies = max(self.most_enemies, len(game.e_fish) + len(game.e_subs))
        self.most_bullets = max(self.most_bullets, len(game.e_bullets))
        last = {"last_action": environment.last_action}
        return Outcome(game.state(), reward, end, state=last)

    def compare_attributes(self, k: int, environment: Any) -> None:
        ours = minatar_attributes(LAYOUT.built(int(column[k]) for column in self.words))
        game = environment.env
        # MinAtar counts to -1 in the step that ends an episode.
        assert ours == {name: getattr(game, name) for name in ours} | {"oxygen": max(0, game.oxygen)}


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
    match = Match(n)
    match.play(policy, steps, seed=1)
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
    match = Match(8, immortal=True, **options)
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
    match = Match(n, immortal=True)
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
    match = Match(n, immortal=True, sticky_action_prob=0.0)
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
    ours = first_episodes(spec(), 20_000, 1, random_actions_of(spec()))
    assert_same_play(ours, episodes_of_minatar(20_000, 2))


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
    theirs = gymnasium.make(str(spec().oracle), render_mode="rgb_array")
    theirs.reset()
    game = theirs.unwrapped.game

    def drawn(state: Any) -> Any:
        vars(game.env).update(minatar_attributes(state))
        game.last_action = state.last_action
        return np.rint(255 * theirs.render()).astype(np.uint8)

    # Down at first and then still, where nothing happens for a while.
    actions = [UP, *[DOWN] * 5, *[LEFT, RIGHT, FIRE] * 18]
    compare_pictures(spec(), "rgb_array", drawn, actions, different=20, seed=7)
    theirs.close()
