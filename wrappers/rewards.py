"""Wrappers that change rewards, each as SuperSuit's of the same name unless it says otherwise."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from gymnasium.spaces import Space

from pearl_marl.base.arrays import Array
from pearl_marl.batch.step import BatchStep
from pearl_marl.checks import checked_function, is_number
from pearl_marl.errors import ArgumentError
from pearl_marl.interfaces.batch import Batch

from .base import Env, wrap
from .transform import Transform


class _MappedRewards(Transform):
    def __init__(
        self, batch: Batch, space: Space[Any], action_space: Any, change: Callable[[Array], Array]
    ) -> None:
        super().__init__(batch, space, action_space)
        self._change = change

    def rewards(self, step: BatchStep) -> Array:
        return self._change(step.rewards)


def reward_lambda_v0(env: Env, change_reward_fn: Callable[[Array], Array]) -> Any:
    """Change rewards by a function of the whole batch, ``float32`` of shape ``(n,)`` to as many numbers."""
    checked_function("change_reward_fn", change_reward_fn)
    return wrap(env, _MappedRewards, partial(_by_function, change_reward_fn))


def _by_function(change_reward_fn: Callable[[Array], Array], rewards: Array) -> Array:
    result = np.asarray(change_reward_fn(rewards), np.float32)
    if result.shape != rewards.shape:
        raise ArgumentError(
            f"change_reward_fn made an array of shape {result.shape} of one of {rewards.shape}; "
            "it gets the rewards of the whole batch"
        )
    return result


class _Shared(Transform):
    def rewards(self, step: BatchStep) -> Array:
        rewards = step.rewards.reshape(-1, self.world.agents)
        shared: Array = rewards.sum(1, dtype=np.float32).repeat(self.world.agents)
        shared[~self.acting] = 0
        return shared


def shared_reward_v0(env: Env) -> Any:
    """Give every agent the sum of the rewards in its world, as a team; agents that have ended get none."""
    return wrap(env, _Shared)


def clip_reward_v0(env: Env, lower_bound: float = -1, upper_bound: float = 1) -> Any:
    """Move rewards beyond two bounds to the bounds."""
    for name, bound in (("lower_bound", lower_bound), ("upper_bound", upper_bound)):
        if not is_number(bound, infinite=True):
            raise ArgumentError(f"{name} is {bound!r}; it must be a number")
    if lower_bound > upper_bound:
        raise ArgumentError(
            f"lower_bound is {lower_bound}, upper_bound {upper_bound}; they are the wrong way round"
        )
    low, high = np.float32(lower_bound), np.float32(upper_bound)
    return wrap(env, _MappedRewards, partial(np.clip, a_min=low, a_max=high))
