"""MountainCar against Gymnasium's ``MountainCar-v0``."""

from __future__ import annotations

import math
from typing import Any

import gymnasium
import numpy as np
import pytest
from scipy import stats

import pearl_marl
from pearl_marl.devices import BatchConfig, Native
from pearl_marl.envs.mountain_car.step import LEFT_END, MAX_SPEED, RIGHT_END
from pearl_marl.errors import ArgumentError
from pearl_marl.porting.oracle import Ours, Outcome, Rules, compare, one_by_one
from pearl_marl.testing import assert_same_play, compare_pictures, compare_steps, first_episodes

from .fixed import Array, drawing, words

SPEC = pearl_marl.get_spec("MountainCar")
POSITION, VELOCITY = SPEC.state
WORST = 7e-10
"""The greatest error of a component after one step that the README states."""


def oracle(goal_velocity: float = 0) -> Rules:
    """Return the oracle's own step, from states of ours."""
    env: Any = gymnasium.make("MountainCar-v0", goal_velocity=goal_velocity).unwrapped

    def step(state: Any, actions: list[int], draws: list[int]) -> Outcome:
        env.state = state.position, state.velocity
        _, reward, ended, _, _ = env.step(actions[0])
        x, v = env.state
        near = x > 0.4 and min(abs(x - 0.5), abs(v - goal_velocity)) < WORST
        # A car that one stops at the wall and the other just before is the one jump there is.
        wall = abs(state.position + v + 1.2) < WORST
        after = {"position": x, "velocity": math.nan if wall else v}
        return Outcome(rewards=reward, terminated=ended, state=after, undecided=near)

    return one_by_one(SPEC, step)


def random_states(generator: np.random.Generator, n: int) -> list[Array]:
    """Return any state in range; a third each is about to meet the wall and the goal."""
    position = words(generator, POSITION, -1.2, 0.6, n)
    velocity = words(generator, VELOCITY, -0.07, 0.07, n)
    where = generator.random(n)
    position = np.where(where < 1 / 3, words(generator, POSITION, -1.2, -1.15, n), position)
    position = np.where(where > 2 / 3, words(generator, POSITION, 0.46, 0.52, n), position)
    return [position.astype(np.int32), velocity]


@pytest.mark.parametrize(
    ("n", "goal_velocity"),
    [(8_000, 0), (6_000, 0.0312), pytest.param(300_000, 0, marks=pytest.mark.exhaustive)],
)
def test_step(n: int, goal_velocity: float) -> None:
    """One step from each of many states, on the CPU device, too: state and end."""
    spec = SPEC.with_options(goal_velocity=goal_velocity)
    states = random_states(np.random.default_rng(1), n)
    move = compare_steps(spec, oracle(goal_velocity), states, tolerance=WORST)
    assert move.outcome.state is not None
    x, v = (move.outcome.state[name] for name in ("position", "velocity"))
    assert np.count_nonzero(np.isnan(v)) < 10
    assert np.count_nonzero(move.outcome.undecided) < 10
    assert 0.02 < move.ended.mean() < 0.9
    assert np.count_nonzero((x == -1.2) & (v == 0)) > n / 100
    assert np.count_nonzero(v == 0.07) > n / 1000


def test_limits_are_delivered_as_the_space_has_them() -> None:
    """The ends of the track and of speed are no multiples of ``2**-30``; as float32 they are the same."""
    space: Any = SPEC.observation_space
    ends = (LEFT_END, RIGHT_END), (-MAX_SPEED, MAX_SPEED)
    for k, (field, (low, high)) in enumerate(zip(SPEC.state, ends, strict=True)):
        assert np.float32(field.value(low)) == space.low[k]
        assert np.float32(field.value(high)) == space.high[k]


def test_starts_are_uniform() -> None:
    device = Native().open(BatchConfig(spec=SPEC, n_envs=43_008))
    position, velocity = device.reset(seed=7).T
    device.close()
    assert not velocity.any()
    assert position.min() >= -0.6
    assert position.max() <= -0.4
    p = stats.kstest(position, stats.uniform(-0.6, 0.2).cdf).pvalue
    print(f"position: p = {p:.3f}")
    assert p > 0.001


def pump(obs: Array, generator: np.random.Generator) -> Array:
    """Push along the velocity, mostly: the goal is then reached at many different times."""
    along = np.where(obs[:, 1] < 0, 0, 2)
    return np.where(generator.random(len(obs)) < 0.75, along, generator.integers(3, size=len(obs)))


def pumped(ours: Ours, generator: np.random.Generator) -> Array:
    return pump(np.stack(ours.values(), 1), generator)[:, None]


def test_follows_the_oracle() -> None:
    """Whole runs with resets: at each step the oracle starts from where ours stands."""
    moves = compare(SPEC, oracle(), 16, 300, actions=pumped, seed=5, posed=True, tolerance=WORST)
    assert sum(int(move.outcome.terminated.sum()) for move in moves) > 16


@pytest.mark.slow
def test_episodes_of_a_random_policy() -> None:
    """20,000 episodes of each, under a policy that gets there: lengths have one distribution.

    The oracle's equations stand here once more, on arrays: its own step takes a minute for as many, and
    ``test_step`` holds ours against that.
    """
    n = 20_000
    generator = np.random.default_rng(12)
    x, v = generator.uniform(-0.6, -0.4, n), np.zeros(n)
    theirs, running = np.zeros(n, int), np.ones(n, bool)
    for _ in range(200):
        actions = pump(np.stack([x, v], 1), generator)
        v = np.clip(v + (actions - 1) * 0.001 - np.cos(3 * x) * 0.0025, -0.07, 0.07)
        x = np.clip(x + v, -1.2, 0.6)
        v = np.where((x == -1.2) & (v < 0), 0, v)
        theirs += running
        running &= x < 0.5
    assert 50 < theirs.mean() < 190
    assert_same_play(first_episodes(SPEC, n, 11, pump), (theirs, -theirs))


def test_pictures_are_gymnasiums() -> None:
    env = drawing(SPEC)

    def drawn(state: Any) -> Any:
        env.unwrapped.state = state.position, state.velocity
        return env.render()

    compare_pictures(SPEC, "rgb_array", drawn, [0, *[2] * 11], different=6)


@pytest.mark.parametrize("goal_velocity", [1.5, -2, math.nan, "fast", True, None])
def test_bad_goal_velocity(goal_velocity: Any) -> None:
    with pytest.raises(ArgumentError, match=r"goal_velocity is .*; it must be a number from -1 to 1"):
        SPEC.with_options(goal_velocity=goal_velocity)
