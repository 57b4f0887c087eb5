"""Pendulum against Gymnasium's ``Pendulum-v1``."""

from __future__ import annotations

import math
from typing import Any

import gymnasium
import numpy as np
import pytest
from scipy import stats

import pearl_marl
from pearl_marl.devices import BatchConfig, Native
from pearl_marl.errors import ArgumentError
from pearl_marl.golden import call_reference

from .fixed import Array, values, words, worst
from .tabular import first_episodes, step_from

SPEC = pearl_marl.get_spec("Pendulum")
SPEED = SPEC.state[1]
WORST_REWARD = 3.2e-8
"""The greatest error of a reward that the README states."""


def worst_state(g: float) -> float:
    """Return the greatest error after one step: three roundings to 27 bits, and that of the sine, times g."""
    return 3 * 2**-28 + 3.5e-9 * 0.075 * abs(g)


def oracle_step(state: list[Array], torque: Array, **options: float) -> tuple[Array, Array, Array]:
    """Return angle, speed and reward of the oracle's own step, which takes arrays as it takes numbers."""
    env: Any = gymnasium.make("Pendulum-v1", **options).unwrapped
    env.state = np.stack([2 * math.pi * state[0], state[1]])
    _, reward, _, _, _ = env.step(torque[None])
    return env.state[0], env.state[1], reward


def random_states(generator: np.random.Generator, n: int) -> list[Array]:
    """Return any angle with any speed; a tenth of the angles is nearly upright or hanging."""
    angle = words(generator, SPEC.state[0], -0.5, 0.5 - 2**-32, n)
    near = words(generator, SPEC.state[0], -1e-6, 1e-6, n)
    near = np.where(generator.random(n) < 0.5, near, near + np.int32(-(1 << 31)))
    angle = np.where(generator.random(n) < 0.1, near, angle).astype(np.int32)
    return [angle, words(generator, SPEED, -8, 8, n)]


def test_spec_is_gymnasiums() -> None:
    theirs = gymnasium.make("Pendulum-v1")
    assert theirs.observation_space == SPEC.observation_space
    assert theirs.action_space == SPEC.action_space
    assert theirs.spec is not None
    assert theirs.spec.max_episode_steps == SPEC.max_cycles
    assert theirs.metadata["render_modes"] == list(SPEC.render_modes)
    assert theirs.metadata["render_fps"] == SPEC.render_fps


@pytest.mark.parametrize("g", [10.0, 9.81, -200.0])
def test_step(g: float) -> None:
    """100,000 states, one step each: state and reward, and the observation that the CPU delivers."""
    n, generator = 100_000, np.random.default_rng(1)
    spec = SPEC.with_options(g=g)
    state, torque = random_states(generator, n), words(generator, spec.action, -2, 2, n)
    angle, speed, reward, terminated = call_reference(spec.positional.step, [*state, torque])
    start = [values(word, field) for word, field in zip(state, spec.state, strict=True)]
    expected = oracle_step(start, values(torque, spec.action), g=g)
    # Angles are the same if they are on the circle.
    off = 2 * math.pi * values(angle, spec.state[0]) - expected[0]
    assert worst("angle", np.remainder(off + math.pi, 2 * math.pi) - math.pi, np.zeros(n)) < worst_state(g)
    assert worst("speed", values(speed, SPEED), expected[1]) < worst_state(g)
    assert worst("reward", values(reward, spec.reward), expected[2]) < WORST_REWARD
    # Smaller rewards have the same absolute error, which is that of their last two bits.
    large = np.abs(expected[2]) > 0.015
    assert np.count_nonzero(~large) > 10
    relative = values(reward, spec.reward)[large] / expected[2][large]
    assert worst("reward, relatively", relative, np.ones(len(relative))) < 2e-6
    assert not terminated.any()

    numbers = np.stack([np.cos(expected[0]), np.sin(expected[0]), expected[1]], 1)
    observed = call_reference(spec.positional.observe, [angle, speed])
    for k, field in enumerate(spec.observation):
        assert worst(field.name, values(observed[k], field), numbers[:, k]) < worst_state(g) + 3.5e-9

    if g == 10:
        step = step_from(spec, state, values(torque, spec.action)[:, None])
        delivered = [values(word, f) for word, f in zip(observed, spec.observation, strict=True)]
        np.testing.assert_array_equal(step.arrivals(), np.stack(delivered, 1).astype(np.float32))
        np.testing.assert_array_equal(step.rewards, values(reward, spec.reward).astype(np.float32))


def test_torque_is_clipped() -> None:
    """Beyond the limits, which a device refuses, a core still does as the oracle does."""
    n, generator = 1_000, np.random.default_rng(2)
    state, torque = random_states(generator, n), words(generator, SPEC.action, -4, 4 - 2**-29, n)
    _, speed, reward, _ = call_reference(SPEC.positional.step, [*state, torque])
    start = [values(word, field) for word, field in zip(state, SPEC.state, strict=True)]
    _, expected, rewards = oracle_step(start, values(torque, SPEC.action))
    assert worst("speed", values(speed, SPEED), expected) < worst_state(10)
    assert worst("reward", values(reward, SPEC.reward), rewards) < WORST_REWARD


def test_follows_the_oracle() -> None:
    """Whole runs with resets: at each step the oracle starts from where ours stands."""
    n, generator = 64, np.random.default_rng(5)
    env = pearl_marl.parallel_env("Pendulum", n, max_cycles=50)
    env.reset_batch(seed=3)
    fast = 0
    for t in range(200):
        start, torque = env.state().T, generator.uniform(-2, 2, (n, 1)).astype(np.float32)
        torque[: n // 2] = np.where(start[1, : n // 2, None] > 0, 2, -2)  # whirls
        step = env.step_batch(torque)
        angle, speed, rewards = oracle_step(list(start), torque[:, 0].astype(float))
        expected = np.stack([np.cos(angle), np.sin(angle), speed], 1)
        np.testing.assert_allclose(step.arrivals(), expected, rtol=1e-7, atol=1e-7, err_msg=f"step {t}")
        np.testing.assert_allclose(step.rewards, rewards, rtol=1e-7, atol=1e-7, err_msg=f"step {t}")
        assert not step.terminations.any()
        assert step.truncations.all() == (t % 50 == 49)
        fast += np.count_nonzero(speed == 8)
    assert fast > n, "some have to meet the limit of speed"
    env.close()


def test_starts_are_uniform() -> None:
    device = Native().open(BatchConfig(spec=SPEC, n_envs=43_008))
    device.reset(seed=7)
    starts = device.state()
    device.close()
    for k, reach in enumerate((0.5, 1)):
        assert -reach <= starts[:, k].min()
        assert starts[:, k].max() < reach
        p = stats.kstest(starts[:, k], stats.uniform(-reach, 2 * reach).cdf).pvalue
        print(f"{SPEC.state[k].name}: p = {p:.3f}")
        assert p > 0.001
    assert abs(np.corrcoef(starts.T)[0, 1]) < 4 / np.sqrt(len(starts)), "drawn independently"


@pytest.mark.slow
def test_returns_of_a_random_policy() -> None:
    """20,000 episodes of each: returns have one distribution, by Kolmogorov and Smirnov."""
    n = 20_000

    def policy(obs: Array, generator: np.random.Generator) -> Array:
        return generator.uniform(-2, 2, (n, 1)).astype(np.float32)

    lengths, ours = first_episodes(SPEC, n, 11, policy)
    assert (lengths == 200).all()
    env: Any = gymnasium.make("Pendulum-v1").unwrapped
    generator = np.random.default_rng(12)
    env.state = generator.uniform([[-math.pi], [-1]], [[math.pi], [1]], (2, n))
    theirs = np.zeros(n)
    for _ in range(200):
        theirs += env.step(generator.uniform(-2, 2, (1, n)))[1]
    p = stats.ks_2samp(ours, theirs).pvalue
    print(f"mean return {ours.mean():.1f} and {theirs.mean():.1f}, p = {p:.3f}")
    assert p > 0.001


def test_pictures_are_gymnasiums() -> None:
    pytest.importorskip("pygame", reason="Gymnasium draws with pygame")
    env = pearl_marl.parallel_env("Pendulum", 2, render_mode="rgb_array")
    gym: Any = gymnasium.make("Pendulum-v1", render_mode="rgb_array")
    env.reset(seed=0)
    gym.reset(seed=0)
    pictures = set()
    for _ in range(5):
        env.step(np.array([[-2], [2]], np.float32))
        turns, speed = env.state()[1]
        gym.unwrapped.state = np.array([2 * math.pi * turns, speed])
        picture = env.render("agent_1")
        np.testing.assert_array_equal(picture, gym.render())
        pictures.add(np.asarray(picture).tobytes())
    assert len(pictures) > 3
    env.close()
    gym.close()


@pytest.mark.parametrize("g", [200.5, -1e9, math.nan, math.inf, "10", True, None])
def test_bad_gravity(g: Any) -> None:
    with pytest.raises(ArgumentError, match=r"g is .*; it must be a number from -200 to 200"):
        SPEC.with_options(g=g)
