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
from pearl_marl.golden import call_reference

from .fixed import Array, values, words, worst
from .tabular import first_episodes, step_from

SPEC = pearl_marl.get_spec("MountainCar")
POSITION, VELOCITY = SPEC.state
WORST = 7e-10
"""The greatest error of a component after one step that the README states."""


def oracle_steps(position: Array, velocity: Array, action: Array, goal_velocity: float) -> Array:
    """Return position, velocity and end of the oracle's own step, one state after the other."""
    env: Any = gymnasium.make("MountainCar-v0", goal_velocity=goal_velocity).unwrapped
    results = np.empty((len(action), 3))
    for i, (x, v, a) in enumerate(zip(position.tolist(), velocity.tolist(), action.tolist(), strict=True)):
        env.state = x, v
        _, reward, ended, _, _ = env.step(a)
        results[i] = *env.state, ended
        assert reward == -1
    return results.T


def random_states(generator: np.random.Generator, n: int) -> tuple[Array, Array]:
    """Return any state in range; a third each is about to meet the wall and the goal."""
    position = words(generator, POSITION, -1.2, 0.6, n)
    velocity = words(generator, VELOCITY, -0.07, 0.07, n)
    where = generator.random(n)
    position = np.where(where < 1 / 3, words(generator, POSITION, -1.2, -1.15, n), position)
    position = np.where(where > 2 / 3, words(generator, POSITION, 0.46, 0.52, n), position)
    return position.astype(np.int32), velocity


def test_spec_is_gymnasiums() -> None:
    theirs = gymnasium.make("MountainCar-v0")
    assert theirs.observation_space == SPEC.observation_space
    assert theirs.action_space == SPEC.action_space
    assert theirs.spec is not None
    assert theirs.spec.max_episode_steps == SPEC.max_cycles
    assert theirs.metadata["render_modes"] == list(SPEC.render_modes)
    assert theirs.metadata["render_fps"] == SPEC.render_fps


@pytest.mark.parametrize(
    ("n", "goal_velocity"),
    [(30_000, 0), (20_000, 0.0312), pytest.param(300_000, 0, marks=pytest.mark.exhaustive)],
)
def test_step(n: int, goal_velocity: float) -> None:
    """One step from each of many states, on the CPU device, too: state and end."""
    generator = np.random.default_rng(1)
    spec = SPEC.with_options(goal_velocity=goal_velocity)
    (position, velocity), actions = random_states(generator, n), generator.integers(3, size=n, dtype=np.uint8)
    x, v, _, ended = call_reference(spec.positional.step, [position, velocity, actions])
    start = values(position, POSITION), values(velocity, VELOCITY)
    theirs_x, theirs_v, theirs_ended = oracle_steps(*start, actions, goal_velocity)
    assert worst("position", values(x, POSITION), theirs_x) < WORST
    # A car that one stops at the wall and the other just before is the one jump there is.
    wall = np.abs(start[0] + theirs_v + 1.2) < WORST
    assert np.count_nonzero(wall) < 10
    assert worst("velocity", values(v, VELOCITY)[~wall], theirs_v[~wall]) < WORST
    near = np.minimum(np.abs(theirs_x - 0.5), np.abs(theirs_v - goal_velocity)) < WORST
    assert np.count_nonzero(near & (theirs_x > 0.4)) < 10
    assert 0.02 < theirs_ended.mean() < 0.9
    np.testing.assert_array_equal(ended[~near], theirs_ended[~near])
    assert np.count_nonzero((theirs_x == -1.2) & (theirs_v == 0)) > n / 100
    assert np.count_nonzero(theirs_v == 0.07) > n / 1000

    step = step_from(spec, [position, velocity], actions)
    delivered = np.stack([values(x, POSITION), values(v, VELOCITY)], 1).astype(np.float32)
    np.testing.assert_array_equal(step.arrivals(), delivered)
    np.testing.assert_array_equal(step.terminations, ended)
    assert (step.rewards == -1).all()


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


def test_follows_the_oracle() -> None:
    """Whole runs with resets: at each step the oracle starts from where ours stands."""
    n, generator = 16, np.random.default_rng(5)
    env = pearl_marl.parallel_env("MountainCar", n)
    obs = env.reset_batch(seed=3)
    ends = 0
    for t in range(300):
        actions = pump(obs, generator).astype(np.uint8)
        start = env.state().T
        step = env.step_batch(actions)
        *expected, ended = oracle_steps(*start, actions, 0)
        np.testing.assert_allclose(
            step.arrivals(), np.stack(expected, 1), rtol=1e-7, atol=2 * WORST, err_msg=f"step {t}"
        )
        np.testing.assert_array_equal(step.terminations, ended)
        assert (step.rewards == -1).all()
        obs, ends = step.obs, ends + int(step.terminations.sum())
    assert ends > n
    env.close()


@pytest.mark.slow
def test_episodes_of_a_random_policy() -> None:
    """20,000 episodes of each, under a policy that gets there: lengths have one distribution.

    The oracle's equations stand here once more, on arrays: its own step takes a minute for as many, and
    ``test_step`` holds ours against that.
    """
    n = 20_000
    ours, returns = first_episodes(SPEC, n, 11, lambda obs, g: pump(obs, g).astype(np.uint8))
    np.testing.assert_array_equal(ours, -returns)
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
    p = stats.ks_2samp(ours, theirs).pvalue
    print(f"mean length {ours.mean():.1f} and {theirs.mean():.1f}, p = {p:.3f}")
    assert 50 < ours.mean() < 190
    assert p > 0.001


def test_pictures_are_gymnasiums() -> None:
    pytest.importorskip("pygame", reason="Gymnasium draws with pygame")
    env = pearl_marl.parallel_env("MountainCar", 2, render_mode="rgb_array")
    gym: Any = gymnasium.make("MountainCar-v0", render_mode="rgb_array")
    env.reset(seed=0)
    gym.reset(seed=0)
    pictures = set()
    for _ in range(12):
        env.step([0, 2])
        gym.unwrapped.state = tuple(env.state()[1])
        picture = env.render("agent_1")
        np.testing.assert_array_equal(picture, gym.render())
        pictures.add(np.asarray(picture).tobytes())
    assert len(pictures) > 5
    env.close()
    gym.close()


@pytest.mark.parametrize("goal_velocity", [1.5, -2, math.nan, "fast", True, None])
def test_bad_goal_velocity(goal_velocity: Any) -> None:
    with pytest.raises(ArgumentError, match=r"goal_velocity is .*; it must be a number from -1 to 1"):
        SPEC.with_options(goal_velocity=goal_velocity)
