"""SuperSuit's wrappers around both of PettingZoo's forms, as they are, under PettingZoo's own tests."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from gymnasium.spaces import Box
from pettingzoo.test import api_test, parallel_api_test, parallel_seed_test, seed_test

import pearl_marl

with warnings.catch_warnings():
    warnings.simplefilter("ignore")  # SuperSuit tells of its successor, and imports what is deprecated
    supersuit = pytest.importorskip("supersuit", reason="SuperSuit is not installed")

pytestmark = pytest.mark.filterwarnings("ignore")
WRAPPERS: dict[str, Callable[[Any], Any]] = {
    "agent_indicator": supersuit.agent_indicator_v0,
    "black_death": supersuit.black_death_v3,
    "clip_reward": supersuit.clip_reward_v0,
    "delay_observations": lambda env: supersuit.delay_observations_v0(env, 2),
    "dtype": lambda env: supersuit.dtype_v0(env, np.float64),
    "flatten": supersuit.flatten_v0,
    "frame_skip": lambda env: supersuit.frame_skip_v0(env, 3),
    "frame_skip, drawn": lambda env: supersuit.frame_skip_v0(env, (1, 4)),
    "frame_stack": lambda env: supersuit.frame_stack_v1(env, 3),
    "max_observation": lambda env: supersuit.max_observation_v0(env, 2),
    "nan_noop": lambda env: supersuit.nan_noop_v0(env, 0),
    "nan_random": supersuit.nan_random_v0,
    "nan_zeros": supersuit.nan_zeros_v0,
    "observation_lambda": lambda env: supersuit.observation_lambda_v0(env, lambda obs, space: obs),
    "action_lambda": lambda env: supersuit.action_lambda_v1(
        env, lambda action, space: action, lambda space: space
    ),
    "reshape": lambda env: supersuit.reshape_v0(env, (4, 1)),
    "reward_lambda": lambda env: supersuit.reward_lambda_v0(env, lambda reward: 2 * reward),
    "pad_observations": supersuit.pad_observations_v0,
    "pad_action_space": supersuit.pad_action_space_v0,
    "sticky_actions": lambda env: supersuit.sticky_actions_v0(env, 0.5),
}


@pytest.mark.parametrize("wrap", WRAPPERS.values(), ids=WRAPPERS)
def test_parallel_form(wrap: Any) -> None:
    parallel_api_test(wrap(pearl_marl.parallel_env("CartPole", 4, autoreset=False, max_cycles=9)), 30)


@pytest.mark.parametrize("wrap", WRAPPERS.values(), ids=WRAPPERS)
def test_aec_form(wrap: Any) -> None:
    if wrap is supersuit.black_death_v3 or wrap is WRAPPERS["frame_skip, drawn"]:
        pytest.skip("SuperSuit has it for the parallel form")
    # The indicator in a Box may be beyond the bounds that SuperSuit gives it.
    name = "CliffWalking" if wrap is supersuit.agent_indicator_v0 else "CartPole"
    api_test(wrap(pearl_marl.env(name, 4, max_cycles=9)), 40)


@pytest.mark.parametrize("name", ["sticky_actions", "nan_random"])
def test_seeds_of_what_wrappers_draw(name: str) -> None:
    """They take ``unwrapped.np_random``, which ``reset`` seeds."""
    seed_test(lambda: WRAPPERS[name](pearl_marl.env("CartPole", 2, max_cycles=9)), 20)
    parallel_seed_test(lambda: WRAPPERS["frame_skip, drawn"](pearl_marl.parallel_env("CartPole", 2)), 20)


@pytest.mark.parametrize("name", ["CartPole", "MountainCar"])
def test_skipped_frames(name: str) -> None:
    """Agents that leave on the way are given actions on and on, as SuperSuit has it; rewards add up."""
    env = supersuit.frame_skip_v0(pearl_marl.parallel_env(name, 5, autoreset=False, max_cycles=50), 4)
    inside = pearl_marl.parallel_env(name, 5, autoreset=False, max_cycles=50)
    for one in (env, inside):
        one.reset(seed=3)
    generator = np.random.default_rng(0)
    while env.agents:
        actions = {agent: int(generator.integers(2)) for agent in env.agents}
        totals = dict.fromkeys(env.agents, 0.0)
        rewards = env.step(actions)[1]
        for _ in range(4):
            for agent, reward in inside.step(actions)[1].items():
                totals[agent] += reward
        assert {agent: float(rewards[agent]) for agent in rewards} == {a: totals[a] for a in rewards}
        assert env.agents == inside.agents
    assert not inside.agents


@pytest.mark.parametrize("base_class", ["gymnasium", "stable_baselines3"])
def test_vector_environments(base_class: str) -> None:
    env = supersuit.pettingzoo_env_to_vec_env_v1(pearl_marl.parallel_env("CartPole", 3, max_cycles=4))
    env = supersuit.concat_vec_envs_v1(env, 2, num_cpus=0, base_class=base_class)
    assert env.num_envs == 6
    assert isinstance(env.observation_space, Box)
    env.reset()
    ends = 0
    for _ in range(9):
        results = env.step(np.ones(6, np.int64))
        ends += int(np.sum(results[2] | results[3] if base_class == "gymnasium" else results[2]))
    assert ends == 12


@pytest.mark.slow
def test_vector_environments_in_other_processes() -> None:
    """Which get the environment as a pickle."""
    env = supersuit.pettingzoo_env_to_vec_env_v1(pearl_marl.parallel_env("Taxi", 3, max_cycles=4))
    env = supersuit.concat_vec_envs_v1(env, 2, num_cpus=2, base_class="gymnasium")
    env.reset(seed=1)
    assert env.step(np.zeros(6, np.int64))[1].shape == (6,)
    env.close()
