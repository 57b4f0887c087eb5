"""Worlds that stay where they ended until they are reset, as TorchRL wants its environments."""

from __future__ import annotations

from functools import reduce
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from pearl_marl.base.arrays import Array
from pearl_marl.base.deferral import uninterrupted
from pearl_marl.interfaces.parallel import PearlParallelEnv
from pearl_marl.interfaces.world import Mask


class WorldsStep(NamedTuple):
    """What a reset or a step returns of ``n`` worlds of ``K`` agents."""

    obs: Array
    """Shape ``(n, K, ...)``. Of an agent that ended in this step, its last."""
    masks: Mask | None
    """Which actions may be taken, ``bool`` of shape ``(n, K, n_actions)``; ``None`` where there are no masks.
    An agent without a choice, as its episode is over or it is not on turn, may take action 0: it is ignored.
    """
    rewards: Array
    """``float32``, shape ``(n, K)``."""
    terminated: Mask
    truncated: Mask
    """Of each agent, shape ``(n, K)``; both may be set. An agent that ended before its world is terminated
    until the world is reset."""
    world_terminated: Mask
    world_truncated: Mask
    """Of each world, shape ``(n,)``: all its agents have terminated; its time limit is reached."""


class WaitingWorlds:
    """The worlds of an environment, each to be reset once its episode is over.

    They go through the same episodes as the environment does by itself.

    A world that the device truncates begins again in the same step, and then it is too late to tell what
    its state was and which actions were possible, which learners ask for. So the time limit is kept here. A
    world that terminates begins again by itself all the same: after such an end there is nothing to ask.

    Parameters
    ----------
    env
        An environment with ``autoreset=True``, in wrappers that step it once a step, or none. It is this
        object's from now on, and has no time limit any more.
    """

    def __init__(self, env: PearlParallelEnv) -> None:
        self.env = env
        self.n, self.k = env.n_worlds, env.agents_per_world
        self.max_cycles = env.max_cycles
        env.max_cycles = 0
        self._elapsed = np.zeros(self.n, np.int64)
        self._terminated = np.zeros(self.n, np.bool_)
        self._obs: Array | None = None

    @uninterrupted
    def reset(self, seed: int | None = None) -> WorldsStep:
        """Begin an episode in every world."""
        self._obs = self.env.reset_batch(seed)
        self._elapsed[:] = 0
        return self._first()

    @uninterrupted
    def reset_some(self, worlds: Mask) -> WorldsStep:
        """Begin an episode in some worlds, by a ``bool`` for each; show all of them."""
        # Those that terminated have begun already.
        begin = worlds & (self._elapsed > 0)
        if begin.any():
            self._obs = self.env.reset_slots(begin)
            self._elapsed[begin] = 0
        return self._first()

    @uninterrupted
    def step(self, actions: npt.ArrayLike) -> WorldsStep:
        """Step every world once, by actions that have a row an agent. Raises what ``step_batch`` does."""
        env, world = self.env, self.env.batch.world
        acting = env.in_episode
        step = env.step_batch(actions)
        began = world.begins(step)[:: self.k]
        self._elapsed += 1
        late = self._elapsed >= self.max_cycles if self.max_cycles else np.zeros(self.n, np.bool_)
        self._elapsed[began] = 0
        self._obs, self._terminated = step.obs, began
        # Where a world began, masks and rows of agents that had ended before show the next episode.
        obs, masks = step.arrivals(), self._masks(world.rows(began))
        terminated, truncated = step.terminations, world.rows(late)
        if not acting.all():
            terminated, truncated = terminated | ~acting, truncated & acting
            if began.any():  # and then these are a copy
                obs[world.rows(began) & ~acting] = 0
        by_world = self._by_world
        agents = by_world(step.rewards), by_world(terminated), by_world(truncated)
        return WorldsStep(by_world(obs), by_world(masks), *agents, began, late)

    def state(self) -> Array:
        """Return ``env.state()`` as ``float32``, shape ``(n, fields)``; zeros where a step terminated."""
        state: Array = self.env.state().astype(np.float32)
        state[self._terminated] = 0
        return state

    @property
    def action_masks(self) -> Mask | None:
        """Which actions may be taken in the next step, as in :class:`WorldsStep`."""
        masks: Mask | None = self._by_world(self._masks(np.zeros(self.n * self.k, np.bool_)))
        return masks

    def _first(self) -> WorldsStep:
        """Return what is seen after a reset."""
        assert self._obs is not None
        self._terminated = np.zeros(self.n, np.bool_)
        none = np.zeros(self.n * self.k, np.bool_)
        rewards = np.zeros(self.n * self.k, np.float32)
        by_world, ended = self._by_world, self._terminated
        agents = by_world(rewards), by_world(~self.env.in_episode), by_world(none)
        return WorldsStep(by_world(self._obs), by_world(self._masks(none)), *agents, ended, ended)

    def _masks(self, over: Mask) -> Mask | None:
        """Return the masks of all agents: action 0 alone for those that are ``over`` or have no choice."""
        masks = self.env.action_masks
        if masks is None:
            return None
        # By columns: along the short rows, any() takes several times as long.
        idle = np.flatnonzero(over | (reduce(np.bitwise_or, masks.T) == 0))
        allowed = masks.astype(np.bool_)
        allowed[idle] = False
        allowed[idle, 0] = True
        return allowed

    def _by_world(self, rows: Any) -> Any:
        return None if rows is None else rows.reshape(self.n, self.k, *rows.shape[1:])
