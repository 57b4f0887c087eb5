"""The PettingZoo interface: the agents of a batch as those of one ``ParallelEnv``, and their dicts."""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Self

import numpy as np
import numpy.typing as npt
import pettingzoo
from gymnasium.spaces import Box, Dict, Space

from pearl_marl.base.arrays import Array
from pearl_marl.batch.config import worlds_of
from pearl_marl.batch.results import check_memory
from pearl_marl.batch.step import on_host
from pearl_marl.checks import checked_flag
from pearl_marl.compiler.packing import observed_as
from pearl_marl.devices import BatchConfig, BatchStep, Device, make_device
from pearl_marl.envs import get_spec
from pearl_marl.errors import ActionError, ArgumentError, OrderError, renamed
from pearl_marl.interfaces.agent_dict import (
    AgentDict,
    AgentList,
    AgentSpaces,
    Names,
    ended_infos,
    observations_in,
)
from pearl_marl.interfaces.batch import Batch, DeviceBatch
from pearl_marl.interfaces.view import BatchView
from pearl_marl.interfaces.world import Mask
from pearl_marl.spec import EnvSpec, Role, snake_case


class PearlParallelEnv(BatchView, pettingzoo.ParallelEnv):  # type: ignore[misc]  # pettingzoo has no types
    """The agents of a batch as those of a PettingZoo ``ParallelEnv``, in wrappers or without.

    A slot of a device holds a *world*, which has one agent, or several that share its state. ``agent_i`` is
    in world ``i // K``, where a world has ``K`` agents.

    Make one with :func:`parallel_env`. The five results of :meth:`step` are dicts that are filled
    on first use (:class:`pearl_marl.interfaces.agent_dict.AgentDict`); their ``.array`` is what the device
    returned, a row an agent. Programs that need no dict at all call :meth:`step_batch`.

    With ``autoreset=True`` agents stay: one whose episode ended finds itself at the start of the
    next, and ``infos[agent]["final_obs"]`` holds where the old one ended. With ``autoreset=False``
    it leaves ``agents`` until the next :meth:`reset`, as PettingZoo's own environments do.

    A world starts over when all its agents have ended. With ``autoreset=True``, an agent that has ended
    before its world stays in ``agents``, but is not ``in_episode`` until then: its action is ignored, its
    observation is zeros and its reward 0.

    Attributes
    ----------
    batch
        What steps: see :class:`pearl_marl.interfaces.batch.Batch`. Wrappers change it.
    env
        The environment without the outermost wrapper; only where there is one.
    possible_agents
        The names of all agents, in the order of their rows.
    names
        The same, made when they are read and never changed.
    """

    def __init__(self, batch: Batch, inside: Self | None = None) -> None:
        self.batch = batch
        self.inside = inside
        count, observation_space = batch.batch_size, batch.observation_space
        self.names = Names(count)
        self.possible_agents: list[str] = AgentList(self.names)
        # Those of a world's agents, one after the other; or the one of all agents.
        self._roles = batch.world.roles or (Role("agent", observation_space, batch.action_space),)
        spaces = [self._observation_space(role) for role in self._roles]
        self._observation_spaces = [spaces[self._roles.index(role)] for role in self._roles]
        self._from_rows = observations_in(observation_space)
        self._tensors = batch.innermost.device.tensors
        # The names of present agents: those that steps may keep, and the public list. As `present` is another
        # array whenever it changes, it says whether they are out of date.
        self._named: Mask = np.zeros(0, np.bool_)
        self._present_agents = Names(0)
        self._agents: list[str] = []
        spec = self.spec
        self.metadata = {
            "name": f"{snake_case(spec.name)}_v{spec.version}",
            "render_modes": list(spec.render_modes),
            "render_fps": spec.render_fps,
            "is_parallelizable": True,
        }

    def __repr__(self) -> str:
        of = f"{self.spec.id}, n_agents={self.batch_size}, device={self.device.name}"
        return f"{type(self).__name__}({of})"

    def around(self, batch: Batch) -> PearlParallelEnv:
        """Return an environment like this one of a batch that changes this one's."""
        return PearlParallelEnv(batch, self)

    @property
    def spec(self) -> EnvSpec:
        """The environment's :class:`pearl_marl.spec.EnvSpec`."""
        return self.batch.innermost.spec

    @property
    def render_mode(self) -> str | None:
        """What :meth:`render` makes."""
        return self.batch.innermost.render_mode

    @property
    def batch_size(self) -> int:
        """Number of agents."""
        return self.batch.batch_size

    @property
    def autoreset(self) -> bool:
        """Whether agents stay and start over, or leave when their episode ends."""
        return self.batch.autoreset

    @property
    def present(self) -> Mask:
        """Which agents are present: none before the first reset. Shape ``(n_agents,)``."""
        return self.batch.present

    @property
    def in_episode(self) -> Mask:
        """Which agents take part in the next step: all but those that ended before their world."""
        return self.batch.in_episode

    live, alive = renamed("live", "present"), renamed("alive", "in_episode")

    @property
    def agents(self) -> list[str]:
        """The names of present agents, in the order of their rows."""
        self._present_names()
        return self._agents

    @functools.cached_property
    def rows(self) -> dict[str, int]:
        """Each agent's row in arrays."""
        return {agent: row for row, agent in enumerate(self.names)}

    slots = renamed("slots", "rows")

    @property
    def agents_per_world(self) -> int:
        """How many agents share a state. Agent ``i`` is in world ``i // agents_per_world``."""
        return self.batch.world.agents

    @property
    def n_worlds(self) -> int:
        """How many states there are."""
        return self.batch.n_worlds

    def role(self, agent: str) -> str:
        """Return the name of an agent's role; ``"agent"`` where all are alike."""
        return self._roles[self._index_in_world(agent)].name

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
        return self._observation_spaces[self._index_in_world(agent)]

    def action_space(self, agent: str) -> Space[Any]:
        """Return an agent's action space, one object for all agents of its role."""
        return self._roles[self._index_in_world(agent)].action_space

    def _index_in_world(self, agent: str) -> int:
        """Return which of its world's agents one is; 0 where all are alike."""
        return self.row_of(agent) % len(self._roles)

    def row_of(self, agent: str) -> int:
        """Return an agent's row; refuse a name that no agent has."""
        try:
            return self.names.row(agent)
        except KeyError:
            raise ArgumentError(
                f"there is no agent {agent!r}; agents are agent_0 to agent_{self.batch_size - 1}"
            ) from None

    def _observation_space(self, role: Role) -> Space[Any]:
        if not self.batch.world.masked:
            return role.observation_space
        n: Any = getattr(role.action_space, "n", 0)
        return Dict({"observation": role.observation_space, "action_mask": Box(0, 1, (n,), np.int8)})

    def step_batch(self, actions: npt.ArrayLike) -> BatchStep:
        """Step every world once, without any dict.

        Parameters
        ----------
        actions
            Shape ``(n_agents, *action_space.shape)``; integers cost least in ``spec.action_dtype``.
            What they hold for agents that have left, or have ended before their world, is ignored.

        Returns
        -------
        :class:`pearl_marl.devices.BatchStep`, its rows in the order of ``possible_agents``. Without
        autoreset, the slots of agents that left run on, and their rows have no meaning; in the step in
        which an agent ends, ``obs`` is already its slot's next start (``arrivals()`` is where it ended).
        """
        return self.batch.step_batch(actions)

    def reset_batch(self, seed: int | None = None) -> Array:
        """Begin an episode for every agent; return observations of shape ``(n_agents, ...)``."""
        return self.batch.reset_batch(seed)

    def reset_slots(self, mask: Mask) -> Array:
        """Begin an episode in the masked worlds, shape ``(n_worlds,)``; return all observations.

        With ``autoreset=False``, agents of those worlds that have left are back in ``agents``. Observations
        of others that have left have no meaning.
        """
        return self.batch.reset_slots(mask)

    def send(self, actions: npt.ArrayLike) -> None:
        """Start a step and return immediately; :meth:`recv` returns its results. Not in wrappers.

        With two environments of half the worlds each, one steps while the other's results are used.
        Takes and raises what :meth:`step_batch` does.
        """
        self.unchanged.send(actions)

    def recv(self) -> BatchStep:
        """Wait for the step that :meth:`send` started and return its results."""
        return self.unchanged.recv()

    def state(self) -> Array:
        """Return the state of every world, shape ``(n_worlds, fields)``, within ``state_space``."""
        return self.device.state()

    @property
    def state_space(self) -> Box:
        """The space of :meth:`state`."""
        return self.batch.innermost.state_space

    def save_state(self) -> bytes:
        """Return everything that what follows depends on; :meth:`load_state` takes it, on any device."""
        return self.batch.save_state()

    def load_state(self, blob: bytes) -> Array:
        """Continue from what :meth:`save_state` returned, bit for bit; return every agent's observation.

        Raises
        ------
        SavedStateError
            The bytes are damaged, of another version, environment, size or mode. Nothing has changed.
        """
        return self.batch.load_state(blob)

    def set_rewards(self, table: npt.ArrayLike) -> None:
        """Replace the reward table, as many finite numbers as ``spec.rewards`` has, from the next step on."""
        self.device.set_rewards(table)

    def render(self, agent: str | None = None) -> Any:
        """Draw an agent's world, now and later (``"agent_0"``'s at first), with the renderer of the oracle.

        Returns an image of shape ``(height, width, 3)`` for ``"rgb_array"``, a string for ``"ansi"``, and
        ``None`` for ``"human"``, which draws by itself after every step.
        """
        innermost = self.batch.innermost
        if agent is None or innermost.render_mode is None:  # which it refuses
            return innermost.render()
        row = self.row_of(agent)
        if not innermost.present[row]:
            raise OrderError(f"render({agent!r}): its episode has ended, and it has left until reset()")
        return innermost.render(row // self.agents_per_world)

    def close(self) -> None:
        """Release the device and the window. Safe to call twice."""
        self.batch.innermost.close()

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
            self.batch.innermost.start_from(state)
        obs = on_host(self.reset_batch(seed))
        masks = on_host(self.action_masks) if self.batch.world.masked else None
        none_ended = np.zeros(len(obs), np.bool_)
        return (
            AgentDict.of(self._present_names(), obs, self._observations(masks)),
            AgentDict.of(self.possible_agents, none_ended, ended_infos(obs, self._last_observations)),
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
        agents = self._present_names()
        present = self._named
        batch_actions: Any = actions
        if isinstance(actions, Mapping) and self.batch.ready:
            values = self._values(agents, actions)
            if not values:  # PettingZoo's convention, which SuperSuit's black_death needs
                return {}, {}, {}, {}, {}
            batch_actions = self._action_array(agents, values)
        result = self.batch.step_batch(batch_actions)
        if self._tensors:
            result = result.on_host()
        obs, rewards, terminations, truncations, final_obs = result
        ended, masks, rows = terminations | truncations, result.action_masks, None
        if not self.autoreset:
            # Here an agent that ended sees its last observation, and nothing of what its slot does next.
            obs = result.arrivals()
            if masks is not None:
                masks = np.where(ended[:, None], np.int8(0), masks)
            ended = np.zeros(len(agents), np.bool_)
            if len(agents) < len(present):
                rows = np.flatnonzero(present)
                obs, rewards, terminations, truncations = (a[rows] for a in (obs, *result[1:4]))
                masks = None if masks is None else masks[rows]
        return (
            AgentDict.of(agents, obs, self._observations(masks, rows)),
            AgentDict.of(agents, rewards, np.ndarray.tolist),
            AgentDict.of(agents, terminations, np.ndarray.tolist),
            AgentDict.of(agents, truncations, np.ndarray.tolist),
            AgentDict.of(agents, ended, ended_infos(final_obs, self._last_observations)),
        )

    def _observations(
        self, masks: Array | None, agents: Array | None = None
    ) -> Callable[[Array], Sequence[Any]]:
        """Return a function that makes observations of the rows of all agents, or of those numbered."""
        if masks is None and len(self._roles) == 1:
            return self._from_rows
        # A role's observation may be the first elements of the row, and its actions those of the mask.
        elements = [_first(role.observation_space, self.batch.observation_space) for role in self._roles]
        allowed = [slice(getattr(role.action_space, "n", 0)) for role in self._roles]

        def by_agent(slices: list[Any], count: int) -> list[Any]:
            if agents is None:
                return slices * (count // len(slices))
            return [slices[agent % len(slices)] for agent in agents.tolist()]

        def observations(rows: Array) -> Sequence[Any]:
            values = self._from_rows(rows)
            if any(elements):
                pairs = zip(values, by_agent(elements, len(rows)), strict=True)
                values = [value if chosen is None else value[chosen] for value, chosen in pairs]
            if masks is None:
                return values
            return [
                {"observation": value, "action_mask": mask[chosen]}
                for value, mask, chosen in zip(values, masks, by_agent(allowed, len(rows)), strict=True)
            ]

        return observations

    def _last_observations(self, rows: Array, agents: Array) -> Sequence[Any]:
        """Return the last observations of agents, by their rows and numbers; no action is allowed then."""
        n: Any = getattr(self.batch.action_space, "n", 0)
        masks = np.zeros((len(rows), n), np.int8) if self.batch.world.masked else None
        return self._observations(masks, agents)(rows)

    def _action_array(self, agents: Sequence[str], values: list[Any]) -> Array:
        """Return actions of agents as an array over all rows; those of agents that left hold anything."""
        rules = self.batch.action_rules
        array = rules.array(values)
        if array is None and self.batch.world.agents > 1:
            # What agents give whose episode is over, whatever it is, is ignored.
            array = rules.array(rules.with_idle(values, ~on_host(self.in_episode)[self._named]))
        if array is None:
            raise rules.refusal_of(agents, values)
        if len(values) == self.batch_size:
            return array
        whole = np.empty((self.batch_size, *rules.shape), array.dtype)
        whole[self._named] = array
        return whole

    def _values(self, agents: Sequence[str], actions: Mapping[str, Any]) -> list[Any]:
        """Return the actions of present agents; refuse one for a name that no agent has."""
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

    def _present_names(self) -> Names:
        """Return the names of present agents; dicts keep these, whatever is done to the public list."""
        present = self.present
        if present is not self._named:
            self._present_agents = self.names.of(present)
            self._agents = AgentList(self._present_agents)
            self._named = present
        return self._present_agents


def _first(own: Space[Any], whole: Space[Any]) -> slice | None:
    """Return which elements of a row are a role's; ``None`` for all."""
    return None if own.shape == whole.shape else slice((own.shape or (0,))[0])


def parallel_env(
    env_id: str,
    n_agents: int | None = None,
    *,
    device: str | Device = "native",
    autoreset: bool = True,
    max_cycles: int | None = None,
    rewards: npt.ArrayLike | None = None,
    initial_states: str = "random",
    render_mode: str | None = None,
    copy: bool = True,
    observations: str = "whole",
    **options: Any,
) -> PearlParallelEnv:
    """Make an environment whose agents are those of a PettingZoo ``ParallelEnv``.

    Parameters
    ----------
    env_id
        A name of :func:`pearl_marl.list_envs`, in any case.
    n_agents
        How many agents, a multiple of how many share a world; by default those of one world.
    device
        A name or a configured device of :mod:`pearl_marl.devices`.
    autoreset
        Whether agents stay and start over (``True``), or leave when their episode ends.
    max_cycles
        Steps after which an episode is truncated: ``None`` for Gymnasium's default, 0 for no limit.
    rewards
        Replaces the reward table.
    initial_states
        ``"random"``, Gymnasium's distribution; ``"stored"``, each slot repeats its first start.
    render_mode
        ``"human"``, ``"rgb_array"`` or ``"ansi"``, where Gymnasium has it.
    copy
        Whether results are yours to keep. If not, the next step overwrites them.
    observations
        ``"packed"`` delivers planes as the bytes of the words that they are made of, ``uint8``, for
        :func:`pearl_marl.unpacked` to make planes of. By default they are ``"whole"``.
    **options
        The environment's own arguments, named as Gymnasium names them.

    Raises
    ------
    ArgumentError
        An argument is not possible: names it, its value and what is.
    DeviceError
        The device is not available.
    """
    spec = get_spec(env_id).with_options(inspect.signature(parallel_env).parameters, **options)
    checked_flag("autoreset", autoreset)
    config = BatchConfig(
        spec=observed_as(spec, observations),
        n_envs=worlds_of(spec, n_agents),
        max_cycles=max_cycles,
        initial_states=initial_states,
        copy=copy,
    )
    check_memory(config)
    leaves = not autoreset
    return PearlParallelEnv(
        DeviceBatch(
            config, make_device(device), rewards, autoreset=autoreset, leaves=leaves, render_mode=render_mode
        )
    )
