"""The AEC forms: a game's own turns, or else PettingZoo's conversion of the parallel form.

In both, an action is checked when it is given.
"""

from __future__ import annotations

from collections import deque
from typing import Any

import numpy as np
from pettingzoo.utils.conversions import parallel_to_aec_wrapper
from pettingzoo.utils.wrappers import OrderEnforcingWrapper

from pearl_marl.batch.actions import refuse_first, refuse_masked, why_not
from pearl_marl.batch.step import on_host
from pearl_marl.deferral import uninterrupted
from pearl_marl.errors import ActionError, ArgumentError, OrderError
from pearl_marl.interfaces.parallel import PearlParallelEnv, parallel_env


def raw_env(env_id: str, n_agents: int | None = None, **arguments: Any) -> Any:
    """Make the AEC form, without PettingZoo's check of the order of calls.

    In a game of turns, ``agent_selection`` is who is on turn. Of several worlds it is the first one's, then
    the second one's, and so on; when everybody who is on turn has acted, all worlds step. In other
    environments it goes through all agents, which then step at once.

    Takes what :func:`parallel_env` takes but ``autoreset``: agents leave when their episode ends.
    """
    if arguments.pop("autoreset", False):
        raise ArgumentError("the AEC form has no autoreset: its agents leave when their episode ends")
    parallel = parallel_env(env_id, n_agents, autoreset=False, **arguments)
    return (_TurnsAEC if parallel.spec.turns else _CheckedAEC)(parallel)


def env(env_id: str, n_agents: int | None = None, **arguments: Any) -> Any:
    """Make the AEC form; takes what :func:`raw_env` takes."""
    return OrderEnforcingWrapper(raw_env(env_id, n_agents, **arguments))


class _CheckedAEC(parallel_to_aec_wrapper):  # type: ignore[misc]
    """PettingZoo's conversion, which by itself would notice a bad action only at the end of the round."""

    env: PearlParallelEnv

    def observe(self, agent: str) -> Any:
        try:
            return super().observe(agent)
        except KeyError:
            self.env.slot_of(agent)  # says so where there is none of that name
            raise OrderError(
                f"observe({agent!r}): its episode has ended, and it has left until reset()"
            ) from None

    @uninterrupted
    def step(self, action: Any) -> None:
        self.check(action)
        super().step(action)

    def check(self, action: Any) -> None:
        """Refuse an action that the selected agent may not take."""
        agent = self.agent_selection
        if self.terminations[agent] or self.truncations[agent]:
            if action is not None:
                raise ActionError(f"{agent}: action {action!r}, but its episode has ended: it takes None")
            return
        space: Any = self.env.action_space(agent)
        if why_not(action, space):
            raise refuse_first([agent], [action], space)
        if self.env.spec.masked == "refused":
            slot = self.env.slots[agent]
            refuse_masked(np.array([action]), on_host(self.env.action_masks)[slot : slot + 1], slot)


class _TurnsAEC(_CheckedAEC):
    """A turn-based game: the agents whose masks are not all 0 are on turn."""

    def __init__(self, parallel: PearlParallelEnv) -> None:
        super().__init__(parallel)
        self.metadata["is_parallelizable"] = False

    @uninterrupted
    def reset(self, seed: int | None = None, options: dict[str, Any] | None = None) -> None:
        self._observations, infos = self.env.reset(seed, options)
        self.infos = dict(infos)
        self.agents = list(self.env.agents)
        self.terminations = dict.fromkeys(self.agents, False)
        self.truncations = dict.fromkeys(self.agents, False)
        self.rewards = dict.fromkeys(self.agents, 0.0)
        self._cumulative_rewards = dict.fromkeys(self.agents, 0.0)
        self._given: dict[str, Any] = {}
        self._due = deque(self._on_turn())
        self.agent_selection = self._due[0]

    @uninterrupted
    def step(self, action: Any) -> None:
        """Take the selected agent's action; ``None`` from one whose episode has ended, which then leaves."""
        if not self.agents:
            raise OrderError("step() with no agent left: every episode has ended, call reset() first")
        agent = self.agent_selection
        if agent != self._due[0]:
            raise ActionError(f"{agent}: action {action!r} out of turn; {self._due[0]} is on turn")
        self.check(action)
        self._due.popleft()
        self.rewards = dict.fromkeys(self.agents, 0.0)
        if self.terminations[agent] or self.truncations[agent]:
            self.agents.remove(agent)
            for values in self._by_agent:
                del values[agent]
        else:
            self._given[agent] = action
            self._cumulative_rewards[agent] = 0.0
            if not self._due:
                self._play(self.env.slots[agent])
        if self._due:
            self.agent_selection = self._due[0]

    @property
    def _by_agent(self) -> tuple[dict[str, Any], ...]:
        return self.rewards, self._cumulative_rewards, self.terminations, self.truncations, self.infos

    def _play(self, last: int) -> None:
        """Step all worlds with the actions given; ``last`` is the agent that gave the last one."""
        # Nobody looks at the actions of those that are not on turn.
        actions = {agent: self._given.get(agent, 0) for agent in self.env.agents}
        self._given.clear()
        observations, *results = self.env.step(actions)
        self._observations = observations
        self.rewards, self.terminations, self.truncations, self.infos = map(dict, results)
        for agent, reward in self.rewards.items():
            self._cumulative_rewards[agent] += reward
        # They leave first, as in PettingZoo: from the one on that would have been on turn.
        slots = [self.env.slots[agent] for agent in self.agents]
        gone = [slot for slot in slots if not self.env.live[slot]]
        gone = [slot for slot in gone if slot > last] + [slot for slot in gone if slot <= last]
        self._due.extend(self.env.possible_agents[slot] for slot in gone)
        self._due.extend(self._on_turn())

    def _on_turn(self) -> list[str]:
        """Return the agents to act: all of them, if no world has an agent on turn."""
        live = self.env.live
        turn = live & on_host(self.env.action_masks).any(1)
        slots = np.flatnonzero(turn if turn.any() else live)
        return [self.env.possible_agents[slot] for slot in slots.tolist()]
