"""PettingZoo's dicts around a batch of arrays: what an environment and its wrappers have in common."""

from __future__ import annotations

import functools
from abc import abstractmethod
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
import pettingzoo
from gymnasium.spaces import Box, Dict, Space
from gymnasium.vector import AutoresetMode

from pearl_marl.batch.actions import idle_action, refuse_first
from pearl_marl.batch.step import Array, BatchStep, on_host
from pearl_marl.elements import ActionSpace
from pearl_marl.errors import ActionError, ArgumentError, OrderError
from pearl_marl.interfaces.agent_dict import AgentDict, ended_infos, observations_in, python_values
from pearl_marl.interfaces.agent_spaces import AgentSpaces
from pearl_marl.interfaces.batch import Batch, Mask, World
from pearl_marl.interfaces.names import AgentList, Names
from pearl_marl.spec import Role


class ParallelInterface(pettingzoo.ParallelEnv, Batch):  # type: ignore[misc]
    """A ``ParallelEnv`` made of a batch's methods, and of :meth:`step_slots`.

    ``possible_agents`` are the names of all, in the order of the slots; ``slots`` has each one's slot.
    ``names`` are the same, made when they are read and never changed; ``action_kinds`` are the kinds of dtype
    that actions may have.
    """

    slot_autoreset_mode = AutoresetMode.SAME_STEP

    def __init__(
        self,
        count: int,
        observation_space: Space[Any],
        action_space: ActionSpace,
        action_kinds: str,
        autoreset: bool,
        world: World,
    ) -> None:
        self.names = Names(count)
        self.possible_agents: list[str] = AgentList(self.names)
        self.batch_size = count
        self.slot_observation_space, self.slot_action_space = observation_space, action_space
        self.autoreset, self.world = autoreset, world
        # One agent's after the other in a world, or the one that is everybody's.
        self._roles = world.roles or (Role("agent", observation_space, action_space),)
        spaces = [self._observation_space(role) for role in self._roles]
        self._observation_spaces = [spaces[self._roles.index(role)] for role in self._roles]
        self._rows = observations_in(observation_space)
        self._action_shape, self._action_kinds = action_space.shape or (), action_kinds
        # An action that is possible, for whom nobody has one.
        self._idle: Any = idle_action(action_space)
        # As `live` is another array whenever it changes, these are known to fit it by which one it is: who is
        # there, as names that steps may keep and as the public list, and an array that says everybody.
        self._named: Mask = np.zeros(0, np.bool_)
        self._here = Names(0)
        self._agents: list[str] = []
        self._everybody: Mask | None = None

    @property
    def agents(self) -> list[str]:
        """The names of those that are there, in the order of the slots."""
        self._name_who_is_there()
        return self._agents

    @functools.cached_property
    def slots(self) -> dict[str, int]:
        """Each agent's slot."""
        return {agent: slot for slot, agent in enumerate(self.names)}

    @property
    def agents_per_world(self) -> int:
        """How many agents share a state. Agent ``i`` is in world ``i // agents_per_world``."""
        return self.world.agents

    @property
    def n_worlds(self) -> int:
        """How many states there are."""
        return self.batch_size // self.world.agents

    def role(self, agent: str) -> str:
        """Return the name of an agent's role; ``"agent"`` where all are alike."""
        return self._roles[self._place(agent)].name

    @functools.cached_property
    def observation_spaces(self) -> Mapping[str, Space[Any]]:
        """Every agent's :meth:`observation_space`: a dict, or of many agents a mapping that acts like one."""
        return AgentSpaces.of(self.names, self._observation_spaces)

    @functools.cached_property
    def action_spaces(self) -> Mapping[str, Space[Any]]:
        """Every agent's :meth:`action_space`, likewise."""
        return AgentSpaces.of(self.names, [role.action_space for role in self._roles])

    def observation_space(self, agent: str) -> Space[Any]:
        """Return an agent's observation space, one object for all agents of its role.

        Where there are masks it is a ``Dict`` of ``"observation"`` and ``"action_mask"``.
        """
        return self._observation_spaces[self._place(agent)]

    def action_space(self, agent: str) -> Space[Any]:
        """Return an agent's action space, one object for all agents of its role."""
        return self._roles[self._place(agent)].action_space

    def _place(self, agent: str) -> int:
        """Return where in its world an agent is, of as many places as there are roles."""
        return self.slot_of(agent) % len(self._roles)

    def slot_of(self, agent: str) -> int:
        """Return an agent's slot; refuse a name that nobody has."""
        try:
            return self.names.slot(agent)
        except KeyError:
            raise ArgumentError(
                f"there is no agent {agent!r}; agents are agent_0 to agent_{self.batch_size - 1}"
            ) from None

    def _observation_space(self, role: Role) -> Space[Any]:
        if not self.world.masked:
            return role.observation_space
        n: Any = getattr(role.action_space, "n", 0)
        return Dict({"observation": role.observation_space, "action_mask": Box(0, 1, (n,), np.int8)})

    def step_batch(self, actions: npt.ArrayLike) -> BatchStep:
        """Step every slot once, without any dict.

        Parameters
        ----------
        actions
            Shape ``(n_agents, *action_space.shape)``; integers cost least in ``spec.action_dtype``.
            What they hold for agents that have left, or are dead, is ignored.

        Returns
        -------
        :class:`pearl_marl.devices.BatchStep`, its rows in the order of ``possible_agents``. Without
        autoreset, the slots of agents that left run on, and their rows have no meaning; in the step in
        which an agent ends, ``obs`` is already its slot's next start (``arrivals()`` is where it ended).
        """
        if self.live is not self._everybody or self.world.agents > 1:
            actions = self.filled(actions)
        return self.step_slots(actions)

    @abstractmethod
    def step_slots(self, actions: npt.ArrayLike) -> BatchStep:
        """Do what :meth:`step_batch` does, with possible actions for agents that have left."""

    def filled(self, actions: npt.ArrayLike) -> npt.ArrayLike:
        """Return actions with a possible one for who has left or is dead: nobody looks at what was there."""
        live = self.live
        acting = live if self.world.agents == 1 else live & on_host(self.alive)
        if acting.all():
            self._everybody = live
            return actions
        if not self.ready:  # the device says why not
            return actions
        if not live.any():
            raise OrderError("step() with no agent left: every episode has ended, call reset() first")
        given: Any = actions
        try:
            array = np.asarray(given.cpu() if hasattr(given, "cpu") else given)
        except ValueError:  # a ragged list, to be refused
            return actions
        if not self._are_actions(array, self.batch_size):
            return actions
        idle = self._idle
        if self.world.masked:  # who has left may be in a world that runs on, and is not to be refused
            idle = on_host(self.action_masks).argmax(1).astype(array.dtype)
        return np.where(acting.reshape(-1, *(1,) * len(self._action_shape)), array, idle)

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Begin an episode for every agent; return observations and infos by agent, the latter empty.

        ``seed`` is a non-negative integer; ``None`` goes on with the random numbers in use.
        ``options={"state": {"field": values}}`` sets fields of the states that episodes begin with: a number,
        or an array of shape ``(n_worlds,)``. Other options are accepted as PettingZoo asks, and not used.
        """
        state = (options or {}).get("state")
        if state is not None:
            self.unwrapped.start_from(state)
        obs = on_host(self.reset_batch(seed))
        masks = on_host(self.action_masks) if self.world.masked else None
        nobody = np.zeros(len(obs), np.bool_)
        return (
            AgentDict.of(self._name_who_is_there(), obs, self._shown(masks)),
            AgentDict.of(self.possible_agents, nobody, ended_infos(obs, self._shown_last)),
        )

    def step(self, actions: Mapping[str, Any] | npt.ArrayLike) -> tuple[dict[str, Any], ...]:
        """Step every agent of ``agents`` once.

        Parameters
        ----------
        actions
            An action for each of ``agents`` by name, or an array of shape ``(n_agents, *action_space.shape)``
            for all of ``possible_agents``. What either says for agents that have left is ignored.

        Returns
        -------
        Observations (NumPy scalars, tuples of them, or arrays; with masks, a dict of ``"observation"`` and
        ``"action_mask"``), rewards (``float``), terminations and truncations (``bool``) and infos, each a
        dict by agent; all empty for a dict once no agent is left. The mask of an agent that ends is 0.

        Raises
        ------
        ActionError
            Names the first agent whose action is missing, out of range, or masked in an environment that
            refuses such; or a name that no agent has. Nothing has moved.
        OrderError
            Before ``reset``, after ``close``, or for an array once every agent has left.
        """
        agents = self._name_who_is_there()
        live = self._named
        given: Any = actions
        if isinstance(actions, Mapping) and self.ready:
            values = self._values(agents, actions)
            if not values:  # PettingZoo's convention, which SuperSuit's black_death needs
                return {}, {}, {}, {}, {}
            given = self._action_array(agents, values)
        result = self.step_batch(given).on_host()
        obs, rewards, terminations, truncations, final_obs = result
        ended, masks, here = result.ended, result.action_masks, None
        if not self.autoreset:
            # Here an agent that ended sees its last observation, and nothing of what its slot does next.
            obs = result.arrivals()
            if masks is not None:
                masks = np.where(ended[:, None], np.int8(0), masks)
            ended = np.zeros(len(agents), np.bool_)
            if len(agents) < len(live):
                here = np.flatnonzero(live)
                obs, rewards, terminations, truncations = (a[here] for a in (obs, *result[1:4]))
                masks = None if masks is None else masks[here]
        return (
            AgentDict.of(agents, obs, self._shown(masks, here)),
            AgentDict.of(agents, rewards, python_values),
            AgentDict.of(agents, terminations, python_values),
            AgentDict.of(agents, truncations, python_values),
            AgentDict.of(agents, ended, ended_infos(final_obs, self._shown_last)),
        )

    def _shown(self, masks: Array | None, slots: Array | None = None) -> Callable[[Array], Sequence[Any]]:
        """Return what makes observations of the rows of all agents, or of those in ``slots``."""
        if masks is None and len(self._roles) == 1:
            return self._rows
        # A role's observation may be the first elements of the row, and its actions those of the mask.
        seen = [_first(role.observation_space, self.slot_observation_space) for role in self._roles]
        allowed = [slice(getattr(role.action_space, "n", 0)) for role in self._roles]

        def each(parts: list[Any], count: int) -> list[Any]:
            if slots is None:
                return parts * (count // len(parts))
            return [parts[slot % len(parts)] for slot in slots.tolist()]

        def shown(rows: Array) -> Sequence[Any]:
            values = self._rows(rows)
            if any(seen):
                pairs = zip(values, each(seen, len(rows)), strict=True)
                values = [value if part is None else value[part] for value, part in pairs]
            if masks is None:
                return values
            return [
                {"observation": value, "action_mask": mask[part]}
                for value, mask, part in zip(values, masks, each(allowed, len(rows)), strict=True)
            ]

        return shown

    def _shown_last(self, rows: Array, slots: Array) -> Sequence[Any]:
        """Return the last observations of those in ``slots``, who may do nothing any more."""
        n: Any = getattr(self.slot_action_space, "n", 0)
        masks = np.zeros((len(rows), n), np.int8) if self.world.masked else None
        return self._shown(masks, slots)(rows)

    def _action_array(self, agents: Sequence[str], values: list[Any]) -> Array:
        """Return actions of agents as an array over all slots; the rows of agents that left hold anything."""
        array = _array(values)
        if not self._are_actions(array, len(values)) and self.world.agents > 1:
            # What the dead give, whatever it is, is ignored.
            acting = on_host(self.alive)[self._named].tolist()
            values = [value if acts else self._idle for value, acts in zip(values, acting, strict=True)]
            array = _array(values)
        if not self._are_actions(array, len(values)):
            raise refuse_first(agents, values, self.slot_action_space)
        if len(values) == self.batch_size:
            return array
        whole = np.empty((self.batch_size, *self._action_shape), array.dtype)
        whole[self._named] = array
        return whole

    def _values(self, agents: Sequence[str], actions: Mapping[str, Any]) -> list[Any]:
        """Return the actions of those that are there; none is to be for an agent that there never was."""
        try:
            values = [actions[agent] for agent in agents]
        except KeyError as missing:
            raise ActionError(
                f"no action for {missing.args[0]!r}; all {len(agents)} agents in env.agents need one"
            ) from None
        if len(actions) != len(values):
            unknown = [agent for agent in actions if agent not in self.names]
            if unknown:
                raise ActionError(
                    f"an action for {unknown[0]!r}, but there is no such agent; agents are agent_0 to "
                    f"agent_{self.batch_size - 1}"
                )
        return values

    def _are_actions(self, array: Array, count: int) -> bool:
        """Return whether an array has the shape and kind of dtype of so many actions."""
        return array.shape == (count, *self._action_shape) and array.dtype.kind in self._action_kinds

    def _name_who_is_there(self) -> Names:
        """Return the agents that are there: whatever is done to the public list, dicts keep these."""
        live = self.live
        if live is not self._named:
            self._here = self.names.of(live)
            self._agents = AgentList(self._here)
            self._named = live
        return self._here


def _array(values: list[Any]) -> Array:
    """Return values as an array; an empty one where some are sequences of other lengths."""
    try:
        return np.array(values)
    except ValueError:
        return np.empty(0)


def _first(own: Space[Any], whole: Space[Any]) -> slice | None:
    """Return which elements of a row are a role's; ``None`` for all."""
    return None if own.shape == whole.shape else slice((own.shape or (0,))[0])
