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
from pearl_marl.porting.oracle import Ours, Outcome, Rules, compare
from pearl_marl.testing import assert_same_play, compare_pictures, compare_steps, first_episodes

from .fixed import Array, drawing, values, words, worst

SPEC = pearl_marl.get_spec("Pendulum")
SPEED = SPEC.state[1]
WORST_REWARD = 3.2e-8
"""The greatest error of a reward that the README states."""


def worst_state(g: float) -> float:
    """Return the greatest error after one step: three roundings to 27 bits, and that of the sine, times g."""
    return 3 * 2**-28 + 3.5e-9 * 0.075 * abs(g)


def oracle(**options: float) -> Rules:
    """Return the oracle's own step, which takes arrays as it takes numbers, from states of ours."""
    env: Any = gymnasium.make("Pendulum-v1", **options).unwrapped

    def step(state: list[Array], actions: Array, draws: Array) -> Outcome:
        env.state = np.stack([2 * math.pi * state[0], state[1]])
        _, rewards, _, _, _ = env.step(actions[:, 0, 0].astype(float)[None])
        angle, speed = env.state
        turns = np.remainder(angle / (2 * math.pi) + 0.5, 1) - 0.5
        turns[np.abs(turns) > 0.5 - 1e-7] = np.nan  # which may be on either end
        seen = np.stack([np.cos(angle), np.sin(angle), speed], 1)
        after = {"angle": turns, "speed": speed}
        return Outcome(seen, rewards, np.zeros(len(speed)), state=after)

    return Rules(step)


def tolerance(g: float = 10.0) -> dict[str, float]:
    """Return by how much each number may differ."""
    worst = worst_state(g)
    return {
        "angle": worst / (2 * math.pi),
        "speed": worst,
        "observation": worst + 3.5e-9,
        "reward": WORST_REWARD,
    }


def random_states(generator: np.random.Generator, n: int) -> list[Array]:
    """Return any angle with any speed; a tenth of the angles is nearly upright or hanging."""
    angle = words(generator, SPEC.state[0], -0.5, 0.5 - 2**-32, n)
    near = words(generator, SPEC.state[0], -1e-6, 1e-6, n)
    near = np.where(generator.random(n) < 0.5, near, near + np.int32(-(1 << 31)))
    angle = np.where(generator.random(n) < 0.1, near, angle).astype(np.int32)
    return [angle, words(generator, SPEED, -8, 8, n)]


def torques(spec: pearl_marl.EnvSpec, generator: np.random.Generator, n: int) -> Array:
    """Return torques as devices have them."""
    return (words(generator, spec.action, -2, 2, n) * 2.0**-spec.action.fraction)[:, None, None]


@pytest.mark.parametrize("n", [20_000, pytest.param(100_000, marks=pytest.mark.exhaustive)])
@pytest.mark.parametrize("g", [10.0, 9.81, -200.0])
def test_step(g: float, n: int) -> None:
    """One step from each of many states, on the CPU device, too: state, reward and observation."""
    generator = np.random.default_rng(1)
    spec = SPEC.with_options(g=g)
    states = random_states(generator, n)
    move = compare_steps(spec, oracle(g=g), states, torques(spec, generator, n), tolerance(g))
    # Smaller rewards have the same absolute error, which is that of their last two bits.
    rewards = move.outcome.rewards
    large = np.abs(rewards) > 0.015
    assert np.count_nonzero(~large) > 10
    assert (move.errors["reward"][large] / np.abs(rewards[large])).max() < 2e-6


def test_torque_is_clipped() -> None:
    """Beyond the limits, which a device refuses, a core still does as the oracle does."""
    n, generator = 1_000, np.random.default_rng(2)
    state, torque = random_states(generator, n), words(generator, SPEC.action, -4, 4 - 2**-29, n)
    _, speed, reward, _ = call_reference(SPEC.positional.step, [*state, torque])
    theirs = oracle()
    theirs.pose(np.arange(n), [values(word, field) for word, field in zip(state, SPEC.state, strict=True)])
    expected = theirs.step(values(torque, SPEC.action)[:, None, None], np.zeros((n, 0)))
    assert expected.state is not None
    assert worst("speed", values(speed, SPEED), expected.state["speed"]) < worst_state(10)
    assert worst("reward", values(reward, SPEC.reward), expected.rewards) < WORST_REWARD


def test_follows_the_oracle() -> None:
    """Whole runs with resets: at each step the oracle starts from where ours stands."""
    n = 64

    def whirled(ours: Ours, generator: np.random.Generator) -> Array:
        torque = torques(SPEC, generator, n)
        torque[: n // 2, 0, 0] = np.where(ours.words[1][: n // 2] > 0, 2, -2)
        return torque

    moves = list(compare(SPEC, oracle(), n, 200, actions=whirled, seed=5, posed=True, tolerance=tolerance()))
    fast = sum(np.count_nonzero(np.abs(values(move.after[1], SPEED)) == 8) for move in moves)
    assert fast > n, "some have to meet the limit of speed"


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

    env: Any = gymnasium.make("Pendulum-v1").unwrapped
    generator = np.random.default_rng(12)
    env.state = generator.uniform([[-math.pi], [-1]], [[math.pi], [1]], (2, n))
    theirs = np.zeros(n)
    for _ in range(200):
        theirs += env.step(generator.uniform(-2, 2, (1, n)))[1]
    assert_same_play(first_episodes(SPEC, n, 11, policy), (np.full(n, 200), theirs))


def test_pictures_are_gymnasiums() -> None:
    env = drawing(SPEC)

    def drawn(state: Any) -> Any:
        turns, speed = state
        env.unwrapped.state, env.unwrapped.last_u = np.array([2 * math.pi * turns, speed]), None
        return env.render()

    compare_pictures(SPEC, "rgb_array", drawn, [[-2], *[[2]] * 4], different=4)


@pytest.mark.parametrize("g", [200.5, -1e9, math.nan, math.inf, "10", True, None])
def test_bad_gravity(g: Any) -> None:
    with pytest.raises(ArgumentError, match=r"g is .*; it must be a number from -200 to 200"):
        SPEC.with_options(g=g)
