"""What steps behind either interface: a batch of agents, a device's or one with a change around it."""

from __future__ import annotations

import functools
from abc import ABC, abstractmethod
from copy import deepcopy
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt
from gymnasium.spaces import Box, Space
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode

from pearl_marl.base.arrays import Array
from pearl_marl.base.deferral import uninterrupted
from pearl_marl.batch.actions import ActionRules
from pearl_marl.batch.rollout import Rollout
from pearl_marl.batch.saved_state import SavedState
from pearl_marl.batch.slot_memory import state_dtype
from pearl_marl.batch.starts import checked_start
from pearl_marl.batch.step import BatchStep, on_host
from pearl_marl.devices import BatchConfig, Device, Phase
from pearl_marl.errors import ArgumentError, OrderError, renamed
from pearl_marl.golden.rng import checked_seed
from pearl_marl.interfaces.world import Mask, World
from pearl_marl.policies.device_policy import DevicePolicy
from pearl_marl.rendering import Renderer, check_render_mode
from pearl_marl.spec.elements import ActionSpace


class Batch(ABC):
    """A batch of agents, stepped at once; what it needs of a subclass is below :meth:`step_batch`.

    Attributes
    ----------
    batch_size
        Number of agents: worlds times agents per world. Arrays have a row for each.
    world
        How agents share states.
    observation_space, action_space
        The spaces of one agent's observation and action.
    slot_autoreset_mode
        When a slot that ended starts over: in the ``SAME_STEP``, or in the ``NEXT_STEP``. That is what
        :meth:`step_batch` does. A ``VectorEnv`` in DISABLED mode and agents that leave only hide it.
    autoreset
        Whether slots that ended start over by themselves and need no reset.
    action_rules
        Which actions its agents may take.
    """

    def __init__(
        self,
        batch_size: int,
        observation_space: Space[Any],
        action_rules: ActionRules,
        autoreset: bool,
        slot_autoreset_mode: AutoresetMode,
        world: World,
    ) -> None:
        self.batch_size, self.world = batch_size, world
        self.observation_space: Space[Any] = observation_space
        self.action_space: ActionSpace = action_rules.space
        self.action_rules = action_rules
        self.autoreset, self.slot_autoreset_mode = autoreset, slot_autoreset_mode
        # Of this array it is known that all agents act: `present` is another one whenever it changes.
        self._all_act: Mask | None = None

    # Two environments that share a device would step each other's agents.
    __copy__ = deepcopy

    @property
    def n_worlds(self) -> int:
        """How many states there are."""
        return self.batch_size // self.world.agents

    def step_batch(self, actions: npt.ArrayLike) -> BatchStep:
        """Step every world once; actions of agents that left or have ended before their world are ignored."""
        if self.present is not self._all_act or self.world.agents > 1:
            actions = self.filled(actions)
        return self.step_rows(actions)

    def filled(self, actions: npt.ArrayLike) -> npt.ArrayLike:
        """Return actions with possible ones for agents that left or have ended before their world."""
        present = self.present
        acting = present if self.world.agents == 1 else present & on_host(self.in_episode)
        if acting.all():
            self._all_act = present
            return actions
        if not self.ready:  # the device says why not
            return actions
        if not present.any():
            raise OrderError("step() with no agent left: every episode has ended, call reset() first")
        filled: npt.ArrayLike = self.action_rules.with_idle(actions, ~acting, self.action_masks)
        return filled

    def reset_slots(self, mask: Mask) -> Array:
        """Begin an episode in the masked worlds, shape ``(worlds,)``; return all observations."""
        if mask is None:
            raise ArgumentError("mask is None; reset_batch() begins an episode in every world")
        return self.reset_batch(mask=mask)

    @property
    @abstractmethod
    def innermost(self) -> DeviceBatch:
        """The batch of the device, inside all changes."""

    @property
    @abstractmethod
    def present(self) -> Mask:
        """Which agents are present, that is, have not left for good. Shape ``(batch_size,)``.

        The array is never written into. When an agent leaves or comes back, it is another one.
        """

    @property
    @abstractmethod
    def in_episode(self) -> Mask:
        """Which agents take part in the next step: see :class:`BatchStep`."""

    live, alive = renamed("live", "present"), renamed("alive", "in_episode")

    @property
    @abstractmethod
    def action_masks(self) -> Array | None:
        """Which actions are allowed in the next step: see :class:`BatchStep`. ``None`` without masks."""

    @property
    @abstractmethod
    def ready(self) -> bool:
        """Whether a step is possible: after the first reset, and until closed."""

    @abstractmethod
    def step_rows(self, actions: npt.ArrayLike) -> BatchStep:
        """Do what :meth:`step_batch` does, with actions that are possible where they are ignored."""

    @abstractmethod
    def reset_batch(self, seed: int | None = None, mask: npt.ArrayLike | None = None) -> Array:
        """Begin an episode in every world, or in those masked; return all observations."""

    @abstractmethod
    def save_state(self) -> bytes:
        """Return everything that what follows depends on."""

    @abstractmethod
    def load_state(self, blob: bytes) -> Array:
        """Continue from what :meth:`save_state` returned; return every agent's observation."""


class DeviceBatch(Batch):
    """The slots of a device.

    With ``leaves``, agents leave when their episode ends, until the next reset. ``spec`` is the environment's
    :class:`pearl_marl.spec.EnvSpec`, ``device`` the :class:`pearl_marl.devices.Device` that steps the slots.
    """

    def __init__(
        self,
        config: BatchConfig,
        device: Device,
        rewards: Any,
        *,
        autoreset: bool,
        leaves: bool,
        render_mode: str | None = None,
    ) -> None:
        self.spec = spec = config.spec
        check_render_mode(spec, render_mode)
        # Copies, or seeding one environment's spaces would seed another's.
        observations, actions, world = deepcopy((spec.observation_space, spec.action_space, World.of(spec)))
        rules = ActionRules.of(spec, actions, config.n_agents)
        super().__init__(config.n_agents, observations, rules, autoreset, config.autoreset_mode, world)
        self.device = device.open(config, rewards)
        self.render_mode = render_mode
        self._leaves = leaves
        # No agent is present before the first reset. Arrays of `present` are replaced, never written into.
        self._all = np.ones(config.n_agents, np.bool_)
        self._present = ~self._all
        self._random, self.np_random_seed = seeding.np_random()
        self._start: dict[str, Array] | None = None
        self._renderer: Renderer | None = None
        self._rendered_world = 0

    def __getstate__(self) -> dict[str, Any]:
        # A copy opens a window, or makes pictures, by itself.
        return {**self.__dict__, "_renderer": None}

    @property
    def innermost(self) -> DeviceBatch:
        """See :class:`Batch`."""
        return self

    @property
    def present(self) -> Mask:
        """See :class:`Batch`."""
        return self._present

    @property
    def in_episode(self) -> Mask:
        """See :class:`Batch`."""
        return self.device.in_episode

    @property
    def action_masks(self) -> Array | None:
        """See :class:`Batch`."""
        return self.device.action_masks

    @property
    def ready(self) -> bool:
        """See :class:`Batch`."""
        return self.device.phase is Phase.READY

    @property
    def np_random(self) -> np.random.Generator:
        """Random numbers for other packages' wrappers, from the seed of a reset; nothing here draws them."""
        return self._random

    @np_random.setter
    def np_random(self, value: np.random.Generator) -> None:
        self._random, self.np_random_seed = value, -1

    @functools.cached_property
    def state_space(self) -> Box:
        """The space of the states of all worlds."""
        low, high = zip(*((f.low, f.high) for f in self.spec.state), strict=True)
        shape = self.n_worlds, 1
        dtype = state_dtype(self.spec)
        return Box(
            np.tile(np.array(low, dtype), shape), np.tile(np.array(high, dtype), shape), dtype=dtype.type
        )

    def start_from(self, state: object) -> None:
        """Let the next reset set fields of the states that episodes begin with."""
        self._start = checked_start(self.spec, state, self.n_worlds)

    @uninterrupted
    def reset_batch(self, seed: int | None = None, mask: npt.ArrayLike | None = None) -> Array:
        """Begin an episode in every world, or in those masked; return all observations.

        Agents of those worlds that have left are there again. Observations of others that have left have no
        meaning.
        """
        start, self._start = self._start, None
        obs = self.device.reset(seed, mask)
        if start:
            obs = self.device.put(start, mask)
        if seed is not None:
            self._random, self.np_random_seed = np.random.default_rng(checked_seed(seed)), int(seed)
        if mask is None:
            self._present = self._all
            self._show()
        else:
            back = self.world.rows(np.asarray(mask)) & ~self._present
            if back.any():
                self._present = self._present | back
        return obs

    def step_rows(self, actions: npt.ArrayLike) -> BatchStep:
        """See :meth:`Batch.step_rows`."""
        # Where nothing is noted here, the device's step is all that an interrupt could cut in two.
        if not self._leaves and self.render_mode != "human":
            return self.device.step(actions)
        return self._step_noted(actions)

    @uninterrupted
    def _step_noted(self, actions: npt.ArrayLike) -> BatchStep:
        return self._noted(self.device.step(actions))

    def send(self, actions: npt.ArrayLike) -> None:
        """Start a step and return immediately; :meth:`recv` returns its results."""
        self.device.send(self.filled(actions))

    @uninterrupted
    def recv(self) -> BatchStep:
        """Wait for the step that :meth:`send` started and return its results."""
        return self._noted(self.device.recv())

    def rollout(
        self, policy: DevicePolicy, steps: int, record: bool = False, episodes: int | None = None
    ) -> Rollout:
        """Step every slot with a policy's actions: see :meth:`pearl_marl.devices.Device.rollout`."""
        if not self.autoreset:
            raise OrderError(
                "rollout() takes an environment whose agents start over by themselves: make it with "
                "autoreset=True, or in SAME_STEP or NEXT_STEP mode"
            )
        result = self.device.rollout(policy, steps, record, episodes)
        self._show()
        return result

    def _noted(self, result: BatchStep) -> BatchStep:
        """Take note of the agents that leave in a step, and show it."""
        if self._leaves:
            leaving = on_host(result.ended) & self._present
            if leaving.any():
                self._present = self._present & ~leaving
        self._show()
        return result

    @uninterrupted
    def save_state(self) -> bytes:
        """Return everything that what follows depends on; :meth:`load_state` takes it, on any device."""
        self.device.check_idle("save_state", ready=True)
        saved = self.device.shared_snapshot()
        present = self._present if self._leaves else self._present[:0]
        identity = {**self.device.config.identity(), "autoreset": self.autoreset}
        return replace(saved, identity=identity, present=present.view(np.uint8)).to_bytes()

    @uninterrupted
    def load_state(self, blob: bytes) -> Array:
        """See :meth:`Batch.load_state`."""
        self.device.check_idle("load_state")
        saved = SavedState.from_bytes(blob, self.device.config, self.autoreset)
        # A device knows nothing of agents that left.
        obs = self.device.restore(replace(saved, present=saved.present[:0]))
        self._present = saved.present.astype(np.bool_) if self._leaves else self._all
        return obs

    def render(self, world: int | None = None) -> Any:
        """Draw a world, now and later, with the renderer of the oracle."""
        if self.render_mode is None:
            raise OrderError(
                f"render() without a render_mode: make the environment with one of {self.spec.render_modes}"
            )
        if world is not None:
            self._rendered_world = world
        state = self.device.state()[self._rendered_world]
        if self._renderer is None:
            self._renderer = Renderer(self.spec, self.render_mode)
        return self._renderer.render(state)

    def _show(self) -> None:
        """Draw the step that was made, in the mode for people."""
        if self.render_mode == "human":
            self.render()

    @uninterrupted
    def close(self) -> None:
        """Release the device and the window. Safe to call twice."""
        self.device.close()
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None
