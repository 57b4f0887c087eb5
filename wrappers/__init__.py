"""Wrappers that work on whole batches, under SuperSuit's names and PettingZoo's.

Each takes an environment of :func:`pearl_marl.parallel_env` or :func:`pearl_marl.make_vec` and returns
one of the same interface. They know when which agent's episode begins, so that what one episode leaves
behind never reaches the next; what they draw at random is each agent's own, from the seed of ``reset``;
and the dicts of a step stay unfilled until they are read.
"""

from __future__ import annotations

import difflib
from typing import Any

from .actions import (
    action_lambda_v1,
    clip_actions_v0,
    nan_noop_v0,
    nan_random_v0,
    nan_zeros_v0,
    pad_action_space_v0,
    scale_actions_v0,
    sticky_actions_v0,
)
from .episodes import black_death_v3, frame_skip_v0
from .observations import (
    agent_indicator_v0,
    color_reduction_v0,
    delay_observations_v0,
    dtype_v0,
    flatten_v0,
    frame_stack_v1,
    frame_stack_v2,
    max_observation_v0,
    normalize_obs_v0,
    observation_lambda_v0,
    pad_observations_v0,
    reshape_v0,
    resize_v1,
    world_observations_v0,
)
from .rewards import clip_reward_v0, reward_lambda_v0, shared_reward_v0
from .statistics import normalize_observation_v0, normalize_reward_v0


def ClipRewardParallelV1(env: Any, min_reward: float = -1, max_reward: float = 1) -> Any:  # noqa: N802
    """See :func:`clip_reward_v0`; PettingZoo has other names for the bounds."""
    return clip_reward_v0(env, min_reward, max_reward)


def RescaleObservationParallelV1(env: Any, min_obs: float = 0.0, max_obs: float = 1.0) -> Any:  # noqa: N802
    """See :func:`normalize_obs_v0`; PettingZoo has other names for the bounds."""
    return normalize_obs_v0(env, min_obs, max_obs)


# PettingZoo is taking over SuperSuit's wrappers under these names.
AgentIndicatorParallelV1 = agent_indicator_v0
BlackDeathParallelV4 = black_death_v3
ClipOutOfBoundsWrapper = clip_actions_v0
ColorReductionObservationParallelV1 = color_reduction_v0
DtypeObservationParallelV1 = dtype_v0
FrameSkipParallelV1 = frame_skip_v0
FrameStackV3 = frame_stack_v2
MaxObservationParallelV1 = max_observation_v0
NanNoopParallelV1 = nan_noop_v0
NanRandomParallelV1 = nan_random_v0
NanZerosParallelV1 = nan_zeros_v0
PadActionSpaceParallelV1 = pad_action_space_v0
PadObservationsParallelV1 = pad_observations_v0
ReshapeObservationParallelV1 = reshape_v0
ScaleActionParallelV1 = scale_actions_v0
StickyActionParallelV1 = sticky_actions_v0

_BRIDGES = {
    "benchmarl_task": "benchmarl",
    "rllib_multi_agent_env": "rllib",
    "rllib_vector_env": "rllib",
    "sb3_vec_env": "stable_baselines3",
    "to_torchrl": "torchrl",
}
"""Functions whose libraries are imported when they are first asked for, and the modules they are in."""

__all__ = [
    "AgentIndicatorParallelV1",
    "BlackDeathParallelV4",
    "ClipOutOfBoundsWrapper",
    "ClipRewardParallelV1",
    "ColorReductionObservationParallelV1",
    "DtypeObservationParallelV1",
    "FrameSkipParallelV1",
    "FrameStackV3",
    "MaxObservationParallelV1",
    "NanNoopParallelV1",
    "NanRandomParallelV1",
    "NanZerosParallelV1",
    "PadActionSpaceParallelV1",
    "PadObservationsParallelV1",
    "RescaleObservationParallelV1",
    "ReshapeObservationParallelV1",
    "ScaleActionParallelV1",
    "StickyActionParallelV1",
    "action_lambda_v1",
    "agent_indicator_v0",
    "benchmarl_task",
    "black_death_v3",
    "clip_actions_v0",
    "clip_reward_v0",
    "color_reduction_v0",
    "delay_observations_v0",
    "dtype_v0",
    "flatten_v0",
    "frame_skip_v0",
    "frame_stack_v1",
    "frame_stack_v2",
    "max_observation_v0",
    "nan_noop_v0",
    "nan_random_v0",
    "nan_zeros_v0",
    "normalize_obs_v0",
    "normalize_observation_v0",
    "normalize_reward_v0",
    "observation_lambda_v0",
    "pad_action_space_v0",
    "pad_observations_v0",
    "reshape_v0",
    "resize_v1",
    "reward_lambda_v0",
    "rllib_multi_agent_env",
    "rllib_vector_env",
    "sb3_vec_env",
    "scale_actions_v0",
    "shared_reward_v0",
    "sticky_actions_v0",
    "to_torchrl",
    "world_observations_v0",
]


def __getattr__(name: str) -> Any:
    if name in _BRIDGES:
        from importlib import import_module

        return getattr(import_module(f"pearl_marl.wrappers.{_BRIDGES[name]}"), name)
    near = difflib.get_close_matches(name, __all__, n=1, cutoff=0.8)
    hint = f"; did you mean {near[0]}?" if near else ""
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}{hint}")
