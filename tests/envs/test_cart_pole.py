"""CartPole against Gymnasium's ``CartPole-v1``."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.envs.classic_control.cartpole import CartPoleVectorEnv
from scipy import stats

import pearl_marl
from pearl_marl.devices import BatchConfig, Native
from pearl_marl.errors import ArgumentError
from pearl_marl.golden import call_reference

from .fixed import Array, values, words, worst
from .tabular import first_episodes, step_from

SPEC = pearl_marl.get_spec("CartPole")
TRACK, LEAN = 2.4, 12 * 2 * np.pi / 360
# What an episode can reach, by the README's argument.
REACH = (TRACK, 11.2, LEAN, 5.2)
WORST = 1.1e-8
"""The greatest error of a component after one step that the README states."""


def oracle_step(state: list[Array], action: Array, sutton_barto: bool = False) -> tuple[Array, Array, Array]:
    """Return the oracle's float64 state, rewards and terminations, from states of any number."""
    env = CartPoleVectorEnv(len(action), sutton_barto_reward=sutton_barto)
    env.reset(seed=0)
    env.state = np.stack(state)
    _, rewards, terminated, _, _ = env.step(action.astype(np.int64))
    return env.state, rewards, terminated


def random_states(generator: np.random.Generator, n: int) -> list[Array]:
    """Return states within reach; position and angle of a third are about to leave it."""
    state = [words(generator, f, -r, r, n) for f, r in zip(SPEC.state, REACH, strict=True)]
    for k in (0, 2):
        chosen = generator.random(n) < 1 / 3
        edge = words(generator, SPEC.state[k], REACH[k] - 0.02, REACH[k], n)
        state[k] = np.where(chosen, edge * generator.choice([-1, 1], n), state[k]).astype(np.int32)
    return state


def test_spec_is_gymnasiums() -> None:
    theirs = gymnasium.make("CartPole-v1")
    assert theirs.observation_space == SPEC.observation_space
    assert theirs.action_space == SPEC.action_space
    assert theirs.spec is not None
    assert theirs.spec.max_episode_steps == SPEC.max_cycles
    assert theirs.metadata["render_modes"] == list(SPEC.render_modes)
    assert theirs.metadata["render_fps"] == SPEC.render_fps


@pytest.mark.parametrize("sutton_barto", [False, True])
def test_step(sutton_barto: bool) -> None:
    """100,000 states, one step each, on the CPU device: state, reward and end."""
    n, generator = 100_000, np.random.default_rng(1)
    spec = SPEC.with_options(sutton_barto_reward=sutton_barto)
    state, actions = random_states(generator, n), generator.integers(2, size=n, dtype=np.uint8)
    *after, _, _ = call_reference(spec.positional.step, [*state, actions])
    start = [values(word, field) for word, field in zip(state, spec.state, strict=True)]
    expected, rewards, terminated = oracle_step(start, actions, sutton_barto)
    for field, ours, theirs in zip(spec.state, after, expected, strict=True):
        assert worst(field.name, values(ours, field), theirs) < WORST

    step = step_from(spec, state, actions)
    obs = np.stack([values(word, f) for word, f in zip(after, spec.state, strict=True)], 1).astype(np.float32)
    np.testing.assert_array_equal(step.arrivals(), obs)
    # Nearer to a threshold than the error, either answer is right.
    near = np.minimum(np.abs(np.abs(expected[0]) - TRACK), np.abs(np.abs(expected[2]) - LEAN)) < WORST
    assert np.count_nonzero(near) < 20
    assert 0.1 < terminated.mean() < 0.9
    np.testing.assert_array_equal(step.terminations[~near], terminated[~near])
    np.testing.assert_array_equal(step.rewards[~near], rewards[~near])


def test_step_of_the_scalar_oracle() -> None:
    """Gymnasium has the equations twice: its plain environment, too, for some of these states."""
    n, generator = 2_000, np.random.default_rng(2)
    state, actions = random_states(generator, n), generator.integers(2, size=n, dtype=np.uint8)
    *after, _, terminated = call_reference(SPEC.positional.step, [*state, actions])
    ours = np.stack([values(word, field) for word, field in zip(after, SPEC.state, strict=True)], 1)
    starts = np.stack([values(word, field) for word, field in zip(state, SPEC.state, strict=True)], 1)
    env: Any = gymnasium.make("CartPole-v1").unwrapped
    env.reset()
    for i in range(n):
        env.state, env.steps_beyond_terminated = starts[i], None
        _, reward, ended, _, _ = env.step(int(actions[i]))
        assert np.abs(env.state - ours[i]).max() < WORST
        assert (reward, ended) == (1.0, terminated[i])


def test_no_state_overflows() -> None:
    """From any word at all: sums stop at the ends of their range, and nothing else comes near its own."""
    n, generator = 50_000, np.random.default_rng(3)
    state = [words(generator, f, f.low, f.high, n) for f in SPEC.state]
    actions = generator.integers(2, size=n, dtype=np.uint8)
    *after, _, _ = call_reference(SPEC.positional.step, [*state, actions])
    expected, _, _ = oracle_step([values(w, f) for w, f in zip(state, SPEC.state, strict=True)], actions)
    for field, ours, theirs in zip(SPEC.state, after, expected, strict=True):
        assert np.count_nonzero(np.abs(theirs) > 16), "no state in the sample leaves the range"
        # The angle is some 16 radians here, and its turns are rounded.
        assert worst(field.name, values(ours, field), np.clip(theirs, field.low, field.high)) < 1e-7


def test_episodes_stay_within_reach() -> None:
    """Policies that race along the track, and that whirl the pole."""
    n = 2_000
    device = Native().open(BatchConfig(spec=SPEC, n_envs=n))
    obs = device.reset(seed=1)
    greatest = np.zeros(4)
    for t in range(600):
        balance = obs[:, 2] + 0.3 * obs[:, 3] + np.where(np.arange(n) % 4 < 2, -0.03, 0.03) > 0
        step = device.step(np.where(np.arange(n) % 2, balance, (t // 8) % 2).astype(np.uint8))
        obs = step.obs
        greatest = np.maximum(greatest, np.abs(step.arrivals()).max(axis=0))
    device.close()
    print("greatest position, velocity, angle, angular velocity:", greatest)
    assert (greatest < np.array(REACH) * [1.1, 1, 1.5, 1]).all()
    assert greatest[0] > TRACK
    assert greatest[2] > LEAN


def test_follows_the_oracle() -> None:
    """Whole runs with resets: at each step the oracle starts from where ours stands."""
    n, generator = 64, np.random.default_rng(5)
    env = pearl_marl.parallel_env("CartPole", n, max_cycles=30)
    env.reset_batch(seed=3)
    ends = 0
    for t in range(200):
        start, actions = env.state().T, generator.integers(2, size=n, dtype=np.uint8)
        step = env.step_batch(actions)
        expected, rewards, terminated = oracle_step(list(start), actions)
        np.testing.assert_allclose(
            step.arrivals(), expected.T, rtol=1e-7, atol=2 * WORST, err_msg=f"step {t}"
        )
        np.testing.assert_array_equal(step.terminations, terminated)
        np.testing.assert_array_equal(step.rewards, rewards)
        ends += int(step.ended.sum())
    assert ends > 5 * n
    env.close()


def test_starts_are_uniform() -> None:
    device = Native().open(BatchConfig(spec=SPEC, n_envs=43_008))
    starts = device.reset(seed=7)
    device.close()
    for k in range(4):
        assert np.abs(starts[:, k]).max() <= 0.05
        p = stats.kstest(starts[:, k], stats.uniform(-0.05, 0.1).cdf).pvalue
        print(f"{SPEC.state[k].name}: p = {p:.3f}")
        assert p > 0.001
    off = np.abs(np.corrcoef(starts.T) - np.eye(4)).max()
    assert off < 4 / np.sqrt(len(starts)), "components are drawn independently"


@pytest.mark.slow
def test_episodes_of_a_random_policy() -> None:
    """20,000 episodes of each: lengths have one distribution, by Kolmogorov and Smirnov."""
    n = 20_000
    ours, returns = first_episodes(SPEC, n, 11, lambda obs, g: g.integers(2, size=n, dtype=np.uint8))
    np.testing.assert_array_equal(ours, returns)
    env, generator = CartPoleVectorEnv(n), np.random.default_rng(12)
    env.reset(seed=13)
    theirs, running = np.zeros(n, int), np.ones(n, bool)
    while running.any():
        _, _, terminated, truncated, _ = env.step(generator.integers(2, size=n))
        theirs += running
        running &= ~(terminated | truncated)
    p = stats.ks_2samp(ours, theirs).pvalue
    print(f"mean length {ours.mean():.2f} and {theirs.mean():.2f}, p = {p:.3f}")
    assert p > 0.001


def test_pictures_are_gymnasiums() -> None:
    pytest.importorskip("pygame", reason="Gymnasium draws with pygame")
    env = pearl_marl.parallel_env("CartPole", 2, render_mode="rgb_array")
    gym: Any = gymnasium.make("CartPole-v1", render_mode="rgb_array")
    env.reset(seed=0)
    gym.reset(seed=0)
    pictures = set()
    for _ in range(8):
        env.step([0, 1])
        gym.unwrapped.state = env.state()[1]
        picture = env.render("agent_1")
        np.testing.assert_array_equal(picture, gym.render())
        pictures.add(np.asarray(picture).tobytes())
    assert len(pictures) > 4
    env.close()
    gym.close()


def test_bad_option() -> None:
    with pytest.raises(ArgumentError, match="sutton_barto_reward is 1; it must be True or False"):
        SPEC.with_options(sutton_barto_reward=1)
