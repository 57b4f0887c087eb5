"""The AEC form: agents act one after the other, by a game's own turns or else in their order.

An action is checked when it is given.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from copy import deepcopy
from typing import Any

import numpy as np
from gymnasium.spaces import Box, Space
from pettingzoo import AECEnv
from pettingzoo.utils.wrappers import OrderEnforcingWrapper

from pearl_marl.base.arrays import Array
from pearl_marl.base.deferral import uninterrupted
from pearl_marl.batch.step import on_host
from pearl_marl.errors import ActionError, ArgumentError, OrderError
from pearl_marl.interfaces.parallel import PearlParallelEnv, parallel_env


def raw_env(env_id: str, n_agents: int | None = None, **arguments: Any) -> PearlAECEnv:
    """Make the AEC form, without PettingZoo's check of the order of calls.

    In a game of turns, ``agent_selection`` is the agent on turn. Of several worlds it is the first one's,
    then the second one's, and so on; when all agents on turn have acted, all worlds step. In other
    environments it goes through all agents, which then step at once.

    Takes what :func:`parallel_env` takes but ``autoreset``: agents leave when their episode ends.
    """
    if arguments.pop("autoreset", False):
        raise ArgumentError("the AEC form has no autoreset: its agents leave when their episode ends")
    return PearlAECEnv(parallel_env(env_id, n_agents, autoreset=False, **arguments))


def env(env_id: str, n_agents: int | None = None, **arguments: Any) -> Any:
    """Make the AEC form; takes what :func:`raw_env` takes."""
    return OrderEnforcingWrapper(raw_env(env_id, n_agents, **arguments))


class PearlAECEnv(AECEnv):  # type: ignore[misc]  # pettingzoo has no types
    """The agents of a :class:`pearl_marl.PearlParallelEnv`, ``env``, one after the other.

    As in PettingZoo's own games, ``terminations`` and ``truncations`` say which agents have ended. Wrappers
    may assign those, as ``TerminateIllegalWrapper`` does. Agents that have ended leave before the others act.
    """

    def __init__(self, parallel: PearlParallelEnv) -> None:
        self.env = parallel
        self.metadata = {**parallel.metadata, "is_parallelizable": not parallel.spec.turns}
        self.render_mode = parallel.render_mode
        self.possible_agents = parallel.possible_agents
        self.agents: list[str] = []

    # As of the environment inside: two that share it would step each other's agents.
    __copy__ = deepcopy

    @property
    def observation_spaces(self) -> Mapping[str, Space[Any]]:
        """See :class:`pearl_marl.PearlParallelEnv`."""
        return self.env.observation_spaces

    @property
    def action_spaces(self) -> Mapping[str, Space[Any]]:
        """See :class:`pearl_marl.PearlParallelEnv`."""
        return self.env.action_spaces

    @property
    def state_space(self) -> Box:
        """See :class:`pearl_marl.PearlParallelEnv`."""
        return self.env.state_space

    @property
    def np_random(self) -> np.random.Generator:
        """See :class:`pearl_marl.PearlParallelEnv`."""
        return self.env.np_random

    @np_random.setter
    def np_random(self, value: np.random.Generator) -> None:
        self.env.np_random = value

    def observation_space(self, agent: str) -> Space[Any]:
        """See :class:`pearl_marl.PearlParallelEnv`."""
        return self.env.observation_space(agent)

    def action_space(self, agent: str) -> Space[Any]:
        """See :class:`pearl_marl.PearlParallelEnv`."""
        return self.env.action_space(agent)

    def state(self) -> Array:
        """See :class:`pearl_marl.PearlParallelEnv`."""
        return self.env.state()

    def render(self, agent: str | None = None) -> Any:
        """See :class:`pearl_marl.PearlParallelEnv`."""
        return self.env.render(agent)

    def close(self) -> None:
        """See :class:`pearl_marl.PearlParallelEnv`."""
        self.env.close()

    @uninterrupted
    def reset(self, seed: int | None = None, options: dict[str, Any] | None = None) -> None:
        """Begin an episode for every agent."""
        self._observations, infos = self.env.reset(seed, options)
        self.infos = dict(infos)
        self.agents = list(self.env.agents)
        self.terminations = dict.fromkeys(self.agents, False)
        self.truncations = dict.fromkeys(self.agents, False)
        self.rewards = dict.fromkeys(self.agents, 0.0)
        self._cumulative_rewards = dict.fromkeys(self.agents, 0.0)
        self._chosen: dict[str, Any] = {}
        # The agents to step next: those that leave, then those that act.
        self._due = deque(self._on_turn())
        self.agent_selection = self._due[0]

    def observe(self, agent: str) -> Any:
        """Return what an agent sees."""
        try:
            return self._observations[agent]
        except KeyError:
            self.env.row_of(agent)  # says so where there is none of that name
            raise OrderError(
                f"observe({agent!r}): its episode has ended, and it has left until reset()"
            ) from None

    @uninterrupted
    def step(self, action: Any) -> None:
        """Take the selected agent's action; ``None`` from one whose episode has ended, which then leaves."""
        if not self.agents:
            self.env.device.check_idle("step", ready=True)
            raise OrderError("step() with no agent left: every episode has ended, call reset() first")
        agent = self.agent_selection
        if self._has_ended(agent):
            if action is not None:
                raise ActionError(f"{agent}: action {action!r}, but its episode has ended: it takes None")
            self._was_dead_step(action)
            return
        if agent != self._due[0]:
            raise ActionError(f"{agent}: action {action!r} out of turn; {self._due[0]} is on turn")
        masks = on_host(self.env.action_masks) if self.env.spec.masked == "refused" else None
        space: Any = self.env.action_space(agent)
        self.env.batch.action_rules.check_one(self.env.row_of(agent), action, space, masks)
        before = self.rewards, self._cumulative_rewards[agent]
        if not self._chosen:  # the first since all worlds stepped
            self.rewards = dict.fromkeys(self.agents, 0.0)
        self._cumulative_rewards[agent] = 0.0
        self._due.popleft()
        self._chosen[agent] = action
        try:
            self._go_on(agent)
        except BaseException:  # by a device, and it may be given again
            self.rewards, self._cumulative_rewards[agent] = before
            self._due.appendleft(agent)
            del self._chosen[agent]
            raise

    def _was_dead_step(self, action: Any) -> None:
        """Have the selected agent leave; PettingZoo's wrappers call this, too."""
        agent = self.agent_selection
        super()._was_dead_step(action)  # which selects another one that has ended
        if agent in self._due:
            self._due.remove(agent)
        another = self.agent_selection in self.rewards and self._has_ended(self.agent_selection)
        if not another or (self._due and self._has_ended(self._due[0])):
            self._go_on(agent)

    def _go_on(self, last: str) -> None:
        """Select the next agent, after a step of all worlds if none is due; ``last`` was selected before."""
        while self.agents and not self._due:
            # Some may have ended because a wrapper says so.
            self._due.extend(filter(self._has_ended, self.agents))
            if not self._due:
                self._play(self.env.rows[last])
        if self.agents:
            self.agent_selection = self._due[0]

    def _has_ended(self, agent: str) -> bool:
        return bool(self.terminations[agent] or self.truncations[agent])

    def _play(self, last: int) -> None:
        """Step all worlds with the actions given; the agent of row ``last`` gave the last one."""
        observations, *results = self.env.step(self._actions())
        self._chosen.clear()
        self._observations = observations
        self.rewards, self.terminations, self.truncations, self.infos = (
            {agent: values[agent] for agent in self.agents} for values in results
        )
        for agent, reward in self.rewards.items():
            self._cumulative_rewards[agent] += reward
        # They leave first, as in PettingZoo: from the one on that would have been on turn.
        rows = [self.env.rows[agent] for agent in self.agents]
        leaving = [row for row in rows if not self.env.present[row]]
        leaving = [row for row in leaving if row > last] + [row for row in leaving if row <= last]
        self._due.extend(self.env.possible_agents[row] for row in leaving)
        self._due.extend(agent for agent in self._on_turn() if agent in self.rewards)

    def _actions(self) -> dict[str, Any]:
        """Return an action for each present agent: of some it is not the turn, and some have left here."""
        batch, none = self.env.batch, [None] * self.env.batch_size
        idle = batch.action_rules.with_idle(none, np.ones(len(none), np.bool_), batch.action_masks)
        return {**{agent: idle[self.env.rows[agent]] for agent in self.env.agents}, **self._chosen}

    def _on_turn(self) -> list[str]:
        """Return the agents to act: all that are there, unless it is a game in which some are on turn."""
        present = self.env.present
        if self.env.spec.turns:
            turn = present & on_host(self.env.action_masks).any(1)
            present = turn if turn.any() else present
        return [self.env.possible_agents[row] for row in np.flatnonzero(present).tolist()]
