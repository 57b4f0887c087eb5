"""What a rollout gives: statistics of its episodes and, if asked for, every step of it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[Any]


@dataclass(frozen=True, eq=False)
class Trajectories:
    """Every step of a rollout; arrays have the shape ``(steps, n_agents, ...)``.

    Attributes
    ----------
    observations, action_masks
        What agents saw before each step; ``action_masks`` is ``None`` where the environment has none.
    actions
        What they did, as ``step_batch`` takes it.
    rewards, terminations, truncations
        What came of it: ``float32``, ``bool`` and ``bool``.
    logits
        What actions were chosen by, ``int32``; ``None`` where the policy has none.
    """

    observations: Array
    action_masks: Array | None
    actions: Array
    rewards: Array
    terminations: Array
    truncations: Array
    logits: Array | None


@dataclass(frozen=True, eq=False)
class Rollout:
    """The result of ``rollout(policy, steps)``.

    Episodes count that began with the rollout or within it, and ended in it. Of an agent that ends before its world,
    the episode is as long as the agent takes part.

    Attributes
    ----------
    steps
        How many steps every agent did.
    episodes, truncated
        How many episodes ended, and how many of those by nothing but the time limit.
    returns
        Sums of rewards over each agent's episodes, ``float64`` of shape ``(n_agents,)``.
    lengths
        Steps of these, ``int64`` of shape ``(n_agents,)``.
    ended
        How many episodes of each agent ended, ``int64`` of shape ``(n_agents,)``.
    squares
        Sums of the squares of returns, ``float64`` of shape ``(n_agents,)``.
    trajectories
        Every step, if that was asked for.
    """

    steps: int
    truncated: int
    returns: Array
    squares: Array
    lengths: Array
    ended: Array
    trajectories: Trajectories | None = None

    @property
    def episodes(self) -> int:
        """How many episodes ended."""
        return int(self.ended.sum())

    @property
    def mean_return(self) -> float | None:
        """The mean of the episodes' returns; ``None`` where none ended."""
        return float(self.returns.sum() / self.episodes) if self.episodes else None

    @property
    def mean_length(self) -> float | None:
        """The mean of the episodes' lengths; ``None`` where none ended."""
        return float(self.lengths.sum() / self.episodes) if self.episodes else None
