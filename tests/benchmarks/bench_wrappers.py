"""What each wrapper costs a step of 43,008 agents, beside the step alone and a copy of its observations."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import pearl_marl
from pearl_marl import wrappers

N = 43008

WRAPPERS: dict[str, Callable[[Any], Any]] = {
    "none": lambda env: env,
    "action_lambda": lambda env: wrappers.action_lambda_v1(env, lambda a, space: 1 - a, lambda space: space),
    "agent_indicator": wrappers.agent_indicator_v0,
    "clip_reward": wrappers.clip_reward_v0,
    "delay_observations(3)": lambda env: wrappers.delay_observations_v0(env, 3),
    "dtype(float64)": lambda env: wrappers.dtype_v0(env, np.float64),
    "frame_skip(4)": lambda env: wrappers.frame_skip_v0(env, 4),
    "frame_stack_v1(4)": wrappers.frame_stack_v1,
    "frame_stack_v2(4)": wrappers.frame_stack_v2,
    "max_observation(4)": lambda env: wrappers.max_observation_v0(env, 4),
    "nan_random": wrappers.nan_random_v0,
    "normalize_observation": wrappers.normalize_observation_v0,
    "normalize_reward": wrappers.normalize_reward_v0,
    "sticky_actions(0.25)": lambda env: wrappers.sticky_actions_v0(env, 0.25),
}


@pytest.mark.parametrize("wrap", WRAPPERS.values(), ids=WRAPPERS)
def test_wrapped_step(wrap: Callable[[Any], Any], benchmark: Any) -> None:
    env = wrap(pearl_marl.parallel_env("CartPole", N))
    env.reset(seed=0)
    actions = np.random.default_rng(0).integers(2, size=N, dtype=np.uint8)
    for _ in range(12):  # episodes have begun to end
        env.step_batch(actions)
    assert len(benchmark(env.step_batch, actions).obs) == N
    env.close()


def test_copy_of_observations(benchmark: Any) -> None:
    obs = pearl_marl.parallel_env("CartPole", N).reset_batch(0)
    assert benchmark(np.copy, obs).shape == (N, 4)
