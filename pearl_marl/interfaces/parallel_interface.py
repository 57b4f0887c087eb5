"""PettingZoo's dicts around a batch of arrays: what an environment and its wrappers have in common."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt
import pettingzoo
from gymnasium.spaces import Box, Discrete, Space
from gymnasium.vector import AutoresetMode

from pearl_marl.batch.actions import refuse_first
from pearl_marl.batch.step import Array, BatchStep, on_host
from pearl_marl.errors import ActionError, OrderError
from pearl_marl.interfaces.agent_dict import AgentDict, ended_infos, observations_in, python_values
from pearl_marl.interfaces.batch import Batch, Mask


class ParallelInterface(pettingzoo.ParallelEnv, Batch):  # type: ignore[misc]
    """A ``ParallelEnv`` made of a batch's methods, and of :meth:`step_slots`.

    ``possible_agents`` are the names of all, in the order of the slots; ``slots`` has each one's slot.
    ``action_kinds`` are the kinds of dtype that actions may have.
    """

    slot_autoreset_mode = AutoresetMode.SAME_STEP

    def __init__(
        self,
        agents: list[str],
        observation_space: Space[Any],
        action_space: Discrete | Box,
        action_kinds: str,
        autoreset: bool,
    ) -> None:
        self.possible_agents = agents
        self.slots = {agent: slot for slot, agent in enumerate(agents)}
        self.batch_size = len(agents)
        self.slot_observation_space, self.slot_action_space = observation_space, action_space
        self.autoreset = autoreset
        self._observations = observations_in(observation_space)
        self._action_shape, self._action_kinds = action_space.shape or (), action_kinds
        # An action that is possible, for whom nobody has one.
        self._idle: Any = action_space.low if isinstance(action_space, Box) else int(action_space.start)
        # As `live` is another array whenever it changes, these are known to fit it by which one it is: who is
        # there, as a tuple that steps may keep and as the public list, and an array that says everybody.
        self._named: Mask = np.zeros(0, np.bool_)
        self._here: tuple[str, ...] = ()
        self._agents: list[str] = []
        self._everybody: Mask | None = None

    @property
    def agents(self) -> list[str]:
        """The names of those that are there, in the order of the slots."""
        self._name_who_is_there()
        return self._agents

    def observation_space(self, agent: str) -> Space[Any]:
        """Return the observation space, one object for all agents."""
        return self.slot_observation_space

    def action_space(self, agent: str) -> Space[Any]:
        """Return the action space, one object for all agents."""
        return self.slot_action_space

    def step_batch(self, actions: npt.ArrayLike) -> BatchStep:
        """Step every slot once, without any dict.

        Parameters
        ----------
        actions
            Shape ``(n_agents, *action_space.shape)``; integers cost least in the dtype of ``spec.action``.
            What they hold for agents that have left is ignored.

        Returns
        -------
        :class:`pearl_marl.devices.BatchStep`, its rows in the order of ``possible_agents``. Without
        autoreset, the slots of agents that left run on, and their rows have no meaning; in the step in
        which an agent ends, ``obs`` is already its slot's next start (``arrivals()`` is where it ended).
        """
        if self.live is not self._everybody:
            actions = self.filled(actions)
        return self.step_slots(actions)

    @abstractmethod
    def step_slots(self, actions: npt.ArrayLike) -> BatchStep:
        """Do what :meth:`step_batch` does, with possible actions for agents that have left."""

    def filled(self, actions: npt.ArrayLike) -> npt.ArrayLike:
        """Return actions with a possible one where an agent has left: nobody looks at what was there."""
        live = self.live
        if live.all():
            self._everybody = live
            return actions
        if self.ready and not live.any():
            raise OrderError("step() with no agent left: every episode has ended, call reset() first")
        given: Any = actions
        try:
            array = np.asarray(given.cpu() if hasattr(given, "cpu") else given)
        except ValueError:  # a ragged list, to be refused
            return actions
        if not self._are_actions(array, self.batch_size):
            return actions
        return np.where(live.reshape(-1, *(1,) * len(self._action_shape)), array, self._idle)

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Begin an episode for every agent; return observations and infos by agent, the latter empty.

        ``seed`` is a non-negative integer; ``None`` goes on with the random numbers in use. ``options`` are
        accepted as PettingZoo asks, and not used.
        """
        obs = on_host(self.reset_batch(seed))
        nobody = np.zeros(len(obs), np.bool_)
        return (
            AgentDict(self._name_who_is_there(), obs, self._observations),
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
        agents = self._name_who_is_there()
        live = self._named
        given: Any = actions
        if isinstance(actions, Mapping) and self.ready:
            if not agents and not actions:  # PettingZoo's convention, which SuperSuit's black_death needs
                return {}, {}, {}, {}, {}
            given = self._action_array(agents, actions)
        result = self.step_batch(given).on_host()
        obs, rewards, terminations, truncations, final_obs = result
        ended = result.ended
        if not self.autoreset:
            # Here an agent that ended sees its last observation, and nothing of what its slot does next.
            obs = result.arrivals()
            ended = np.zeros(len(agents), np.bool_)
            if len(agents) < len(live):
                obs, rewards, terminations, truncations = (a[live] for a in (obs, *result[1:4]))
        return (
            AgentDict(agents, obs, self._observations),
            AgentDict(agents, rewards, python_values),
            AgentDict(agents, terminations, python_values),
            AgentDict(agents, truncations, python_values),
            AgentDict(agents, ended, ended_infos(final_obs, self._observations)),
        )

    def _action_array(self, agents: tuple[str, ...], actions: Mapping[str, Any]) -> Array:
        """Return a dict's actions as an array over all slots; the rows of agents that left hold anything."""
        values = self._values(agents, actions)
        try:
            array = np.array(values)
        except ValueError:  # some are sequences
            array = np.empty(0)
        if not self._are_actions(array, len(values)):
            raise refuse_first(agents, values, self.slot_action_space)
        if len(values) == self.batch_size:
            return array
        whole = np.empty((self.batch_size, *self._action_shape), array.dtype)
        whole[self._named] = array
        return whole

    def _values(self, agents: tuple[str, ...], actions: Mapping[str, Any]) -> list[Any]:
        """Return the actions of those that are there, who must be the ones that have one."""
        try:
            values = [actions[agent] for agent in agents]
        except KeyError as missing:
            raise ActionError(
                f"no action for {missing.args[0]!r}; all {len(agents)} agents in env.agents need one"
            ) from None
        if len(actions) != len(values):
            here = set(agents)
            extra = next(agent for agent in actions if agent not in here)
            why = "its episode has ended" if extra in self.slots else "there is no such agent"
            raise ActionError(f"an action for {extra!r}, but {why}; only agents in env.agents act")
        return values

    def _are_actions(self, array: Array, count: int) -> bool:
        """Return whether an array has the shape and kind of dtype of so many actions."""
        return array.shape == (count, *self._action_shape) and array.dtype.kind in self._action_kinds

    def _name_who_is_there(self) -> tuple[str, ...]:
        """Return the agents that are there. A tuple: whatever is done to the public list, dicts keep it."""
        live = self.live
        if live is not self._named:
            pairs = zip(self.possible_agents, live.tolist(), strict=True)
            self._here = tuple(agent for agent, here in pairs if here)
            self._agents = list(self._here)
            self._named = live
        return self._here
