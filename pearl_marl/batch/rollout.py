"""What a rollout gives: sums of its episodes and, if asked for, every step of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from pearl_marl.base.arrays import Array

SUMS = ("returns", "squares", "lengths", "ended", "truncated")
"""What is always there of a rollout."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Rollout:
    """The result of ``rollout(policy, steps)``.

    Episodes count that began within the rollout, or just before it, and ended in it. Without a time limit,
    steps of episodes are not counted, and those under way count from the rollout's start. An agent that ends
    before its world has an episode that is as long as it took part.

    Hardware with a policy engine adds up over all agents: arrays of sums have one element, and squares are
    NaN.

    Attributes
    ----------
    steps
        How many steps every agent did.
    returns, squares
        Sums of the returns of each agent's episodes, and of their squares, ``float64`` of shape
        ``(n_agents,)``.
    lengths, ended, truncated
        Sums of these episodes' steps, how many they are, and how many of them nothing but the time limit
        ended, ``int64`` of shape ``(n_agents,)``.
    observations, action_masks
        What agents saw before each step, of shape ``(steps, n_agents, ...)``. These and the following are
        ``None`` unless every step was asked for; and ``action_masks`` where the environment has none.
    actions
        What they did, as ``step_batch`` takes it, of shape ``(steps, n_agents, ...)``.
    rewards, terminations, truncations
        What came of it: ``float32``, ``bool`` and ``bool`` of shape ``(steps, n_agents)``.
    logits
        What actions were chosen by, ``int32`` of shape ``(steps, n_agents, outputs)``; ``None`` where there
        is no such.
    """

    steps: int
    returns: npt.NDArray[np.float64]
    squares: npt.NDArray[np.float64]
    lengths: npt.NDArray[np.int64]
    ended: npt.NDArray[np.int64]
    truncated: npt.NDArray[np.int64]
    observations: Array | None = None
    action_masks: Array | None = None
    actions: Array | None = None
    rewards: Array | None = None
    terminations: Array | None = None
    truncations: Array | None = None
    logits: Array | None = None

    @classmethod
    def total(cls, parts: Sequence[Rollout]) -> Rollout:
        """Return the sums of rollouts of several devices, which have one element each."""
        sums = {name: np.sum([getattr(part, name) for part in parts], axis=0) for name in SUMS}
        return cls(steps=parts[0].steps, **sums)

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


class Experience(NamedTuple):
    """Every step of a rollout, as learners take it: of shape ``(steps, n_agents, ...)``."""

    # Before each step; with a row more, for where the last one led.
    observations: Array
    action_masks: Array | None
    in_episode: Array  # bool: which agents take part
    # Of each step.
    words: Array  # int64, one for each field of an action
    outputs: Array  # float32: the network's, without noise
    rewards: Array
    terminations: Array
    truncations: Array
    final_observations: Array  # what agents saw last; only rows of truncations have a meaning
