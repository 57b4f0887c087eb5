"""CartPole against Gymnasium's ``CartPole-v1``."""

from __future__ import annotations

from functools import partial
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.envs.classic_control.cartpole import CartPoleVectorEnv
from scipy import stats

import pearl_marl
from pearl_marl.devices import BatchConfig, Native
from pearl_marl.errors import ArgumentError
from pearl_marl.porting.oracle import Outcome, Rules, compare, one_by_one
from pearl_marl.testing import assert_same_play, compare_pictures, compare_steps, first_episodes
from pearl_marl.testing.oracles import random_actions_of

from .fixed import Array, drawing, words

SPEC = pearl_marl.get_spec("CartPole")
TRACK, LEAN = 2.4, 12 * 2 * np.pi / 360
# What an episode can reach, by the README's argument.
REACH = (TRACK, 11.2, LEAN, 5.2)
WORST = 1.1e-8
"""The greatest error of a component after one step that the README states."""


def gymnasiums(state: list[Array], actions: Array, draws: Array, **options: bool) -> Outcome:
    """Step Gymnasium's vector environment, which computes in float64, from states of ours."""
    env = CartPoleVectorEnv(len(actions), **options)
    env.reset(seed=0)
    env.state = np.stack(state)
    _, rewards, terminated, _, _ = env.step(actions[:, 0].astype(np.int64))
    position, _, angle, _ = env.state
    # Nearer to a threshold than the error, either answer is right.
    near = np.minimum(np.abs(np.abs(position) - TRACK), np.abs(np.abs(angle) - LEAN)) < WORST
    after = {field.name: values for field, values in zip(SPEC.state, env.state, strict=True)}
    return Outcome(env.state.T, rewards, terminated, state=after, undecided=near)


def random_states(generator: np.random.Generator, n: int) -> list[Array]:
    """Return states within reach; position and angle of a third are about to leave it."""
    state = [words(generator, f, -r, r, n) for f, r in zip(SPEC.state, REACH, strict=True)]
    for k in (0, 2):
        chosen = generator.random(n) < 1 / 3
        edge = words(generator, SPEC.state[k], REACH[k] - 0.02, REACH[k], n)
        state[k] = np.where(chosen, edge * generator.choice([-1, 1], n), state[k]).astype(np.int32)
    return state


@pytest.mark.parametrize("n", [20_000, pytest.param(100_000, marks=pytest.mark.exhaustive)])
@pytest.mark.parametrize("sutton_barto", [False, True])
def test_step(sutton_barto: bool, n: int) -> None:
    """One step from each of many states, on the CPU device, too: state, reward and end."""
    options, generator = {"sutton_barto_reward": sutton_barto}, np.random.default_rng(1)
    oracle = Rules(partial(gymnasiums, **options))
    states = random_states(generator, n)
    move = compare_steps(SPEC.with_options(**options), oracle, states, tolerance=WORST)
    assert np.count_nonzero(move.outcome.undecided) < 20
    assert 0.1 < move.ended.mean() < 0.9


def test_step_of_the_scalar_oracle() -> None:
    """Gymnasium has the equations twice: its plain environment, too, for some of these states."""
    env: Any = gymnasium.make("CartPole-v1").unwrapped
    env.reset()

    def step(state: Any, actions: list[int], draws: list[int]) -> Outcome:
        env.state, env.steps_beyond_terminated = np.array(state), None
        _, reward, ended, _, _ = env.step(actions[0])
        return Outcome(env.state, reward, ended)

    compare_steps(
        SPEC, one_by_one(SPEC, step), random_states(np.random.default_rng(2), 2_000), tolerance=WORST
    )


def test_no_state_overflows() -> None:
    """From any word at all: sums stop at the ends of their range, and nothing else comes near its own."""
    n, generator = 50_000, np.random.default_rng(3)

    def step(state: list[Array], actions: Array, draws: Array) -> Outcome:
        after = gymnasiums(state, actions, draws).state
        assert after is not None
        for values in after.values():
            assert np.count_nonzero(np.abs(values) > 16), "no state in the sample leaves the range"
        ends = {field.name: (field.low, field.high) for field in SPEC.state}
        return Outcome(state={name: np.clip(values, *ends[name]) for name, values in after.items()})

    # The angle is some 16 radians here, and its turns are rounded.
    compare_steps(
        SPEC, Rules(step), [words(generator, f, f.low, f.high, n) for f in SPEC.state], tolerance=1e-7
    )


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
    moves = compare(SPEC, Rules(gymnasiums), 64, 200, seed=5, posed=True, tolerance=WORST)
    assert sum(int(move.ended.sum()) for move in moves) > 5 * 64


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
    """20,000 episodes of each: lengths and returns have one distribution."""
    n = 20_000
    env, generator = CartPoleVectorEnv(n), np.random.default_rng(12)
    env.reset(seed=13)
    theirs, running = np.zeros(n, int), np.ones(n, bool)
    while running.any():
        _, _, terminated, truncated, _ = env.step(generator.integers(2, size=n))
        theirs += running
        running &= ~(terminated | truncated)
    assert_same_play(first_episodes(SPEC, n, 11, random_actions_of(SPEC)), (theirs, theirs))


def test_pictures_are_gymnasiums() -> None:
    env: Any = drawing(SPEC)

    def drawn(state: Any) -> Any:
        env.unwrapped.state = np.array(state)
        return env.render()

    compare_pictures(SPEC, "rgb_array", drawn, [0, *[1] * 7], different=5)


def test_bad_option() -> None:
    with pytest.raises(ArgumentError, match="sutton_barto_reward is 1; it must be True or False"):
        SPEC.with_options(sutton_barto_reward=1)
