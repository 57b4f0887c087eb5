"""MountainCarContinuous against Gymnasium's ``MountainCarContinuous-v0``."""

from __future__ import annotations

import math
from typing import Any

import gymnasium
import numpy as np
import pytest
from scipy import stats

import pearl_marl
from pearl_marl.errors import ArgumentError
from pearl_marl.porting.oracle import Ours, Outcome, Rules, compare, one_by_one
from pearl_marl.testing import assert_same_play, compare_pictures, compare_steps, first_episodes

from .fixed import Array, drawing, words

SPEC = pearl_marl.get_spec("MountainCarContinuous")
WORST = {"position": 6.1e-8, "velocity": 4.8e-9, "reward": 6e-10}
"""The greatest errors of a step; the state's are the last places of Gymnasium's, floats of 32 bits."""


def oracle(goal_velocity: float = 0) -> Rules:
    """Return the oracle's own step, from states of ours."""
    env: Any = gymnasium.make("MountainCarContinuous-v0", goal_velocity=goal_velocity).unwrapped

    def step(state: Any, actions: list[list[float]], draws: list[int]) -> Outcome:
        env.state = np.array(state)
        _, reward, ended, _, _ = env.step(np.array(actions[0]))
        x, v = (float(number) for number in env.state)
        near = x > 0.4 and min(abs(x - 0.45), abs(v - goal_velocity)) < 1e-7
        # A car that one stops at the wall and the other just before is the one jump there is.
        wall = abs(state.position + v + 1.2) < 1e-7
        after = {"position": x, "velocity": math.nan if wall else v}
        return Outcome(rewards=reward, terminated=ended, state=after, undecided=near)

    return one_by_one(SPEC, step)


@pytest.mark.parametrize(
    ("n", "goal_velocity"),
    [(2_000, 0), (1_000, 0.0312), pytest.param(200_000, 0, marks=pytest.mark.exhaustive)],
)
def test_step(n: int, goal_velocity: float) -> None:
    """One step from each of many states, on the CPU device, too; some meet the wall, some the goal."""
    spec, generator = SPEC.with_options(goal_velocity=goal_velocity), np.random.default_rng(1)
    position, velocity = spec.state
    low, high = np.array([(-1.2, 0.6), (-1.2, -1.15), (0.4, 0.47)])[generator.integers(3, size=n)].T
    where = low + (high - low) * generator.random(n)
    states = [
        np.clip(np.round(where * 2.0**position.fraction), *position.range).astype(np.int64),
        words(generator, velocity, -0.07, 0.07, n),
    ]
    move = compare_steps(spec, oracle(goal_velocity), states, tolerance=WORST)
    assert move.outcome.state is not None
    x, v = (move.outcome.state[name] for name in ("position", "velocity"))
    assert np.count_nonzero(np.isnan(v)) < 10
    assert np.count_nonzero(move.outcome.undecided) < 10
    assert 0.02 < move.ended.mean() < 0.9
    assert np.count_nonzero((x == np.float32(-1.2)) & (v == 0)) > n / 100
    assert np.count_nonzero(v == np.float32(0.07)) > n / 1000


def test_rewards_are_those_of_the_force() -> None:
    """Off the goal they are as fine as the field: to 1e-9, of any action that is a float of 32 bits."""
    env = pearl_marl.parallel_env("MountainCarContinuous", 1000)
    env.reset_batch(seed=0)
    actions = np.linspace(-1, 1, 1000, dtype=np.float32)[:, None]
    rewards = env.step_batch(actions).rewards
    np.testing.assert_allclose(rewards, -0.1 * actions[:, 0].astype(float) ** 2, rtol=1e-7, atol=2e-9)


def test_limits_are_delivered_as_the_space_has_them() -> None:
    space: Any = SPEC.observation_space
    for k, field in enumerate(SPEC.state):
        assert [np.float32(field.value(end)) for end in field.range] == [space.low[k], space.high[k]]


def test_starts_are_uniform() -> None:
    position, velocity = pearl_marl.parallel_env("MountainCarContinuous", 43_008).reset_batch(seed=7).T
    assert not velocity.any()
    p = stats.kstest(position, stats.uniform(-0.6, 0.2).cdf).pvalue
    print(f"position: p = {p:.3f}")
    assert p > 0.001


def pump(obs: Array, generator: np.random.Generator) -> Array:
    """Push along the velocity, mostly: the goal is then reached at many different times."""
    along = np.where(obs[:, 1] < 0, -1, 1)
    any_force = generator.uniform(-1, 1, len(obs))
    return np.where(generator.random(len(obs)) < 0.75, along, any_force).astype(np.float32)[:, None]


def pumped(ours: Ours, generator: np.random.Generator) -> Array:
    return pump(np.stack(ours.values(), 1), generator)[:, None]


def test_follows_the_oracle() -> None:
    """Whole runs with resets: at each step the oracle starts from where ours stands."""
    moves = compare(SPEC, oracle(), 16, 250, actions=pumped, seed=5, posed=True, tolerance=WORST)
    assert sum(int(move.outcome.terminated.sum()) for move in moves) > 16


@pytest.mark.slow
def test_episodes_that_reach_the_goal() -> None:
    """10,000 episodes of each, under a policy that gets there, by Gymnasium's equations in NumPy."""
    n, generator = 10_000, np.random.default_rng(12)
    x, v = generator.uniform(-0.6, -0.4, n), np.zeros(n)
    lengths, returns, running = np.zeros(n, int), np.zeros(n), np.ones(n, bool)
    while running.any():
        force = pump(np.stack([x, v], 1), generator)[:, 0].astype(float)
        v = np.clip(v + force * 0.0015 - 0.0025 * np.cos(3 * x), -0.07, 0.07)
        x = np.clip(x + v, -1.2, 0.6)
        v = np.where((x == -1.2) & (v < 0), 0, v)
        lengths += running
        there = running & (x >= 0.45) & (v >= 0)
        returns += running * (100 * there - 0.1 * force**2)
        running &= ~there
    assert 50 < lengths.mean() < 300
    assert_same_play(first_episodes(SPEC, n, 11, pump), (lengths, returns))


def test_pictures_are_gymnasiums() -> None:
    env = drawing(SPEC)

    def drawn(state: Any) -> Any:
        env.unwrapped.state = np.array([state.position, state.velocity])
        return env.render()

    compare_pictures(SPEC, "rgb_array", drawn, [[-1.0], *[[1.0]] * 11], different=6)


@pytest.mark.parametrize("goal_velocity", [1.5, math.nan, "fast", True, None])
def test_bad_goal_velocity(goal_velocity: Any) -> None:
    with pytest.raises(ArgumentError, match=r"goal_velocity is .*; it must be a number from -1 to 1"):
        SPEC.with_options(goal_velocity=goal_velocity)
