"""Wrappers that change what a step is, or how long agents stay."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from gymnasium.spaces import Space
from gymnasium.vector import AutoresetMode

from pearl_marl.devices import BatchStep
from pearl_marl.errors import ArgumentError, OrderError
from pearl_marl.golden import uniform_below
from pearl_marl.parallel_interface import ParallelInterface

from .base import Array, Batch, Env, Mask, Transform, WrappedParallelEnv, wrap


class _FrameSkip(Transform):
    def __init__(self, batch: Batch, space: Space[Any], action_space: Any, low: int, high: int) -> None:
        super().__init__(batch, space, action_space)
        if batch._autoreset_mode is AutoresetMode.NEXT_STEP:
            raise ArgumentError(
                "frame_skip_v0 does not work in NEXT_STEP mode, whose slots spend a step resetting: "
                "make the environment with autoreset_mode='SameStep'"
            )
        self._low, self._high = low, high

    def step(self, actions: npt.ArrayLike) -> BatchStep:
        spread = self._high - self._low + 1
        count = self._low + (int(uniform_below(self.draws(0)[:1], spread)[0]) if spread > 1 else 0)
        self._tick += 1
        first = self.batch.step_batch(actions)
        rewards, ended = first.rewards.copy(), first.ended
        terminations, truncations = first.terminations.copy(), first.truncations.copy()
        obs, final_obs = first.obs, first.final_obs.copy()
        for _ in range(1, count):
            if ended.all():
                break
            step = self.batch.step_batch(actions)
            running = ~ended
            rewards[running] += step.rewards[running]
            now = step.ended & running
            terminations[now], truncations[now] = step.terminations[now], step.truncations[now]
            final_obs[now] = step.final_obs[now]
            obs, ended = step.obs, ended | now
            if now.any() and not self._anybody():
                break
        # Slots that ended on the way have gone on into their next episodes: those begin here instead.
        if ended.any() and self._anybody():
            obs = self.batch._reset_slots(ended)
        return BatchStep(obs, rewards, terminations, truncations, final_obs)

    def _anybody(self) -> bool:
        """Whether an agent is left to step, which there may not be where agents leave."""
        return bool(getattr(self.batch, "agents", True))


def frame_skip_v0(env: Env, num_frames: int | tuple[int, int]) -> Any:
    """Take each action several times and add up the rewards; an episode's end ends it.

    Parameters
    ----------
    env
        The environment. In NEXT_STEP mode this wrapper is refused.
    num_frames
        How often, or the least and the most: then a number for all agents is drawn in every step.
    """
    low, high = num_frames if isinstance(num_frames, tuple) else (num_frames, num_frames)
    if not all(isinstance(k, int) and not isinstance(k, bool) for k in (low, high)) or not 1 <= low <= high:
        raise ArgumentError(
            f"num_frames is {num_frames!r}; it must be a positive integer, or the least and the most of them"
        )
    return wrap(env, lambda batch, space, actions: _FrameSkip(batch, space, actions, low, high))


class _BlackDeath(WrappedParallelEnv):
    """Agents whose episode has ended stay, blind and without reward, until everybody's has."""

    def __init__(self, env: ParallelInterface) -> None:
        super().__init__(env, Transform(env, env._observation_space, env._action_space))
        self._present = False
        self._terminated = np.zeros(self._n, np.bool_)
        self._truncated = np.zeros(self._n, np.bool_)

    def reset_batch(self, seed: int | None = None) -> Array:
        obs: Array = super().reset_batch(seed)
        self._present = True
        self._terminated[:] = self._truncated[:] = False
        return obs

    def step_batch(self, actions: npt.ArrayLike) -> BatchStep:
        if not self._present and self._ready:
            raise OrderError("step() with no agent left: every episode has ended, call reset() first")
        alive: Mask = self.env._live
        step = self.env.step_batch(actions)
        self._terminated |= step.terminations & alive
        self._truncated |= step.truncations & alive
        obs, rewards = step.arrivals().copy(), step.rewards.copy()
        obs[~alive] = 0
        rewards[~alive] = 0
        self._present = bool(self.env.agents)
        over = not self._present
        nobody = np.zeros(self._n, np.bool_)
        terminations = self._terminated.copy() if over else nobody
        truncations = self._truncated.copy() if over else nobody
        return BatchStep(obs, rewards, terminations, truncations, obs)

    def load_state(self, blob: bytes) -> Array:
        raise OrderError("an environment in black_death_v3 cannot be put into a saved state: load it inside")

    @property
    def agents(self) -> list[str]:
        return list(self.possible_agents) if self._present else []

    @property
    def _agents(self) -> tuple[str, ...]:  # type: ignore[override]
        return tuple(self.agents)

    @property
    def _live(self) -> Mask:  # type: ignore[override]
        return np.full(self._n, self._present)


def black_death_v3(env: ParallelInterface) -> Any:
    """Keep agents whose episode has ended, with observations and rewards of zero, until all have ended.

    Then every agent gets the flags with which its own episode ended, in the step in which the last one
    does; SuperSuit says so a step late. For environments made with ``autoreset=False``.
    """
    if not isinstance(env, ParallelInterface) or env._autoreset:
        raise ArgumentError(
            "black_death_v3 takes a ParallelEnv made with autoreset=False: no agent dies in others"
        )
    return _BlackDeath(env)
