"""Wrappers that change what a step is, or how long agents stay."""

from __future__ import annotations

from typing import Any

import numpy as np
from gymnasium.spaces import Space
from gymnasium.vector import AutoresetMode

from pearl_marl.base.arrays import Array
from pearl_marl.batch.step import BatchStep
from pearl_marl.checks import NumberRange
from pearl_marl.errors import ArgumentError
from pearl_marl.golden import uniform_below
from pearl_marl.interfaces.batch import Batch
from pearl_marl.interfaces.parallel import PearlParallelEnv
from pearl_marl.interfaces.world import Mask

from .base import Env, with_zeros, wrap
from .transform import Transform


class _FrameSkip(Transform):
    def __init__(self, batch: Batch, space: Space[Any], action_space: Any, low: int, high: int) -> None:
        super().__init__(batch, space, action_space)
        if batch.slot_autoreset_mode is AutoresetMode.NEXT_STEP:
            raise ArgumentError(
                "frame_skip_v0 does not work in NEXT_STEP mode, whose slots spend a step resetting: "
                "make the environment with autoreset_mode='SameStep'"
            )
        if batch.world.masked == "refused":
            raise ArgumentError(
                "frame_skip_v0 does not work where masked actions are refused: an action may be masked by "
                "the time it is to be repeated"
            )
        self._low, self._high = low, high

    def take(self, actions: Array) -> BatchStep:
        count = self._low
        if self._high > count:
            count += int(uniform_below(self.draws()[:1], self._high - count + 1)[0])
        step = super().take(actions)
        rewards, terminations, truncations, final_obs = (self.new.copy(array) for array in step[1:])
        over, started = self.world.begins(step), False
        for _ in range(1, count):
            if over.all() or not self.batch.present.any():  # where agents leave, none may be left to step
                break
            started |= bool(over.any())
            step = super().take(actions)
            running = ~over
            np.add(rewards, step.rewards, out=rewards, where=running)
            now = np.flatnonzero(step.ended & running)
            terminations[now], truncations[now] = step.terminations[now], step.truncations[now]
            final_obs[now] = step.final_obs[now]
            over |= self.world.begins(step)
        # Worlds that ended on the way have gone on into their next episodes: those begin here instead. Where
        # agents leave, none is there to see that.
        again = (over & self.batch.present)[:: self.world.agents]
        obs = self.batch.reset_slots(again) if started and again.any() else step.obs
        return self.carried(step, obs, rewards, terminations, truncations, final_obs)


def frame_skip_v0(env: Env, num_frames: int | tuple[int, int]) -> Any:
    """Take each action several times and add up the rewards; an episode's end ends it.

    Parameters
    ----------
    env
        The environment. In NEXT_STEP mode this wrapper is refused.
    num_frames
        How often, or the least and the most: then a number for all agents is drawn in every step.
    """
    counts = num_frames if isinstance(num_frames, tuple) else (num_frames, num_frames)
    if (
        len(counts) != 2
        or any(count not in NumberRange(least=1, whole=True) for count in counts)
        or counts[0] > counts[1]
    ):
        raise ArgumentError(
            f"num_frames is {num_frames!r}; it must be a positive integer, or the least and the most of them"
        )
    return wrap(env, _FrameSkip, *counts)


def skips_frames(env: Env) -> bool:
    """Return whether an environment has :func:`frame_skip_v0` around it, wherever among its wrappers."""
    batch = env.batch
    while isinstance(batch, Transform):
        if isinstance(batch, _FrameSkip):
            return True
        batch = batch.batch
    return False


class _BlackDeath(Transform):
    """Agents whose episode has ended stay, blind and without reward, until all agents' have."""

    def __init__(self, batch: Batch, space: Space[Any], action_space: Any) -> None:
        super().__init__(batch, with_zeros(space), action_space)
        self._all, self._none = np.ones(self.n, np.bool_), np.zeros(self.n, np.bool_)
        self._present = np.zeros((), np.bool_)
        self._terminated, self._truncated = np.zeros(self.n, np.bool_), np.zeros(self.n, np.bool_)
        self.memory = {
            "live": self._present,  # as saved states of before have it
            "terminated": self._terminated,
            "truncated": self._truncated,
        }

    @property
    def present(self) -> Mask:
        return self._all if self._present else self._none

    def reset(self, obs: Array, seed: int | None, mask: Mask | None = None) -> Array:
        self._present[...] = True
        began = slice(None) if mask is None else self.world.rows(mask)
        self._terminated[began] = self._truncated[began] = False
        return super().reset(obs, seed, mask)

    def results(self, step: BatchStep) -> BatchStep:
        in_episode = self.acting
        self._terminated |= step.terminations & in_episode
        self._truncated |= step.truncations & in_episode
        self._present[...] = self.batch.present.any()
        obs, rewards = self.new.copy(self.arrivals(step)), step.rewards.copy()
        obs[~in_episode] = 0
        rewards[~in_episode] = 0
        over = ~self._present
        return self.carried(step, obs, rewards, self._terminated & over, self._truncated & over, obs)

    @property
    def action_masks(self) -> Array | None:
        masks = self.batch.action_masks
        return None if masks is None else np.where(self.batch.present[:, None], masks, np.int8(0))

    def restored(self, obs: Array) -> Array:
        obs = obs.copy()
        obs[~self.batch.present] = 0
        return obs


def black_death_v3(env: PearlParallelEnv) -> Any:
    """Keep agents whose episode has ended, with observations and rewards of zero, until all have ended.

    Then every agent gets the flags with which its own episode ended, in the step in which the last one
    does; SuperSuit says so a step late. For environments made with ``autoreset=False``.
    """
    if not isinstance(env, PearlParallelEnv) or env.autoreset:
        raise ArgumentError(
            "black_death_v3 takes a ParallelEnv made with autoreset=False: no agent dies in others"
        )
    return wrap(env, _BlackDeath)
