"""PettingZoo's dicts around a batch of arrays: what an environment and its wrappers have in common."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt
import pettingzoo
from gymnasium.spaces import Box, Discrete, Space

from pearl_marl.batch.actions import refuse_first
from pearl_marl.batch.step import on_host
from pearl_marl.devices import BatchStep
from pearl_marl.errors import ActionError
from pearl_marl.interfaces.agent_dict import AgentDict, ended_infos, observations_in, python_values

Array = npt.NDArray[Any]


class ParallelInterface(pettingzoo.ParallelEnv):  # type: ignore[misc]
    """A ``ParallelEnv`` made of two methods on whole arrays, ``reset_batch`` and ``step_batch``.

    Attributes
    ----------
    possible_agents, agents
        ``"agent_0"`` and so on, in the order of the slots: all of them, and those still there.
    """

    possible_agents: list[str]
    # Whether agents stay when their episode ends; who is there, as a tuple that steps may keep, and by slot.
    _autoreset: bool
    _agents: tuple[str, ...]
    _live: npt.NDArray[np.bool_]
    _known: frozenset[str]

    def _set_spaces(self, observation_space: Space[Any], action_space: Discrete | Box) -> None:
        self._observation_space, self._action_space = observation_space, action_space
        self._observations = observations_in(observation_space)
        self._action_shape = action_space.shape or ()
        self._action_kinds = "iu" if isinstance(action_space, Discrete) else "iuf"
        self._idle = action_space.low[0] if isinstance(action_space, Box) else 0

    def observation_space(self, agent: str) -> Space[Any]:
        """Return the observation space, one object for all agents."""
        return self._observation_space

    def action_space(self, agent: str) -> Space[Any]:
        """Return the action space, one object for all agents."""
        return self._action_space

    @abstractmethod
    def reset_batch(self, seed: int | None = None) -> Array:
        """Begin an episode for every agent; return observations of shape ``(n_agents, ...)``."""

    @abstractmethod
    def step_batch(self, actions: npt.ArrayLike) -> BatchStep:
        """Step every slot once, without any dict.

        Parameters
        ----------
        actions
            Shape ``(n_agents, *action_space.shape)``; integers cost least in the dtype of ``spec.action``.

        Returns
        -------
        :class:`pearl_marl.devices.BatchStep`, its rows in the order of ``possible_agents``. Without
        autoreset, the slots of agents that left run on, and their rows have no meaning; in the step in
        which an agent ends, ``obs`` is already its slot's next start (``arrivals()`` is where it ended).
        """

    @property
    def _ready(self) -> bool:
        """Whether a step is possible."""
        return True

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Begin an episode for every agent.

        Parameters
        ----------
        seed
            A non-negative integer. ``None`` goes on with the random numbers in use.
        options
            Accepted as PettingZoo asks, and not used.

        Returns
        -------
        Observations and infos, dicts by agent; the infos are empty.
        """
        obs = on_host(self.reset_batch(seed))
        nobody = np.zeros(len(obs), np.bool_)
        return (
            AgentDict(self._agents, obs, self._observations),
            AgentDict(self.possible_agents, nobody, ended_infos(obs, self._observations)),
        )

    def step(self, actions: Mapping[str, Any] | npt.ArrayLike) -> tuple[dict[str, Any], ...]:
        """Step every agent of ``agents`` once.

        Parameters
        ----------
        actions
            An action for each of ``agents`` by name, or an array of shape ``(n_agents, *action_space.shape)``
            for all of ``possible_agents``; there, what it says for agents that have left is ignored.

        Returns
        -------
        Observations (NumPy scalars, tuples of them, or arrays), rewards (``float``), terminations and
        truncations (``bool``) and infos, each a dict by agent; all empty for ``{}`` once no agent is left.

        Raises
        ------
        ActionError
            Names the first agent whose action is missing, unexpected or out of range.
        OrderError
            Before ``reset``, after ``close``, or once every agent has left.
        """
        agents, live = self._agents, self._live
        given: Any = actions
        if isinstance(actions, Mapping) and self._ready:
            if not agents and not actions:  # PettingZoo's convention, which SuperSuit's black_death needs
                return {}, {}, {}, {}, {}
            given = self._action_array(actions)
        result = self.step_batch(given).on_host()
        obs, rewards, terminations, truncations, final_obs = result
        ended = result.ended
        if not self._autoreset:
            # Here an agent that ended sees its last observation, and nothing of what its slot does next.
            obs = result.arrivals()
            ended = np.zeros(len(agents), np.bool_)
            if len(agents) < len(live):
                obs, rewards, terminations, truncations = (
                    a[live] for a in (obs, rewards, terminations, truncations)
                )
        return (
            AgentDict(agents, obs, self._observations),
            AgentDict(agents, rewards, python_values),
            AgentDict(agents, terminations, python_values),
            AgentDict(agents, truncations, python_values),
            AgentDict(agents, ended, ended_infos(final_obs, self._observations)),
        )

    def _action_array(self, actions: Mapping[str, Any]) -> Array:
        """Return a dict's actions as an array over all slots, with a possible one where an agent has left."""
        try:
            values = [actions[agent] for agent in self._agents]
        except KeyError as missing:
            raise ActionError(
                f"no action for {missing.args[0]!r}; all {len(self._agents)} agents in env.agents need one"
            ) from None
        if len(actions) != len(values):
            here = set(self._agents)
            extra = next(agent for agent in actions if agent not in here)
            why = "its episode has ended" if extra in self._known else "there is no such agent"
            raise ActionError(f"an action for {extra!r}, but {why}; only agents in env.agents act")
        try:
            array = np.array(values)
        except ValueError:  # some are sequences
            array = np.empty(0)
        if array.shape != (len(values), *self._action_shape) or array.dtype.kind not in self._action_kinds:
            raise refuse_first(self._agents, values, self._action_space)
        if len(values) == len(self._live):
            return array
        whole = np.full((len(self._live), *self._action_shape), self._idle, array.dtype)
        whole[self._live] = array
        return whole
