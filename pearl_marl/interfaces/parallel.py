"""The PettingZoo interface: one ``ParallelEnv`` whose agents are those of all slots."""

from __future__ import annotations

import functools
import inspect
from copy import deepcopy
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt
from gymnasium.spaces import Box

from pearl_marl.batch.config import worlds_of
from pearl_marl.batch.results import check_memory
from pearl_marl.batch.saved_state import SavedState
from pearl_marl.batch.slot_memory import state_dtype
from pearl_marl.batch.starts import checked_start
from pearl_marl.batch.step import Array, on_host
from pearl_marl.deferral import uninterrupted
from pearl_marl.devices import BatchConfig, BatchStep, Device, make_device
from pearl_marl.errors import ArgumentError, OrderError
from pearl_marl.interfaces.batch import Mask, World
from pearl_marl.interfaces.parallel_interface import ParallelInterface
from pearl_marl.packing import observed_as
from pearl_marl.registry import get_spec
from pearl_marl.rendering import Renderer, check_render_mode, renderer
from pearl_marl.rng import checked_seed
from pearl_marl.spec import snake_case


class PearlParallelEnv(ParallelInterface):
    """Many slots of one environment, with their agents as the agents of a PettingZoo ``ParallelEnv``.

    A slot is a *world*: it has one agent, or several that share its state. Agents ``agent_0`` to
    ``agent_{K-1}`` are in the first, ``world`` is ``i // K``.

    Make one with :func:`parallel_env`. The five results of :meth:`step` are dicts that are filled
    on first use (:class:`pearl_marl.interfaces.agent_dict.AgentDict`); their ``.array`` is what the device
    returned, a row an agent. Whoever needs no dict at all calls :meth:`step_batch`.

    With ``autoreset=True`` agents stay: one whose episode ended finds itself at the start of the
    next, and ``infos[agent]["final_obs"]`` holds where the old one ended. With ``autoreset=False``
    it leaves ``agents`` until the next :meth:`reset`, as PettingZoo's own environments do.

    A world starts over when all its agents have ended. With ``autoreset=True``, one that has ended before
    its world stays in ``agents`` and is *dead* until then: its action is ignored, its observation zeros and
    its reward 0, as ``alive`` says.

    ``spec`` is its :class:`pearl_marl.spec.EnvSpec`, ``device`` the :class:`pearl_marl.devices.Device` that
    steps the slots. ``np_random`` is a ``numpy.random.Generator`` from the seed of :meth:`reset`, for other
    packages' wrappers: nothing here draws from it.
    """

    def __init__(
        self, config: BatchConfig, device: Device, rewards: Any, autoreset: bool, render_mode: str | None
    ) -> None:
        spec = config.spec
        check_render_mode(spec, render_mode)
        check_memory(config)
        super().__init__(
            config.n_agents,
            # Copies, or seeding one environment's spaces would seed another's.
            *deepcopy((spec.observation_space, spec.action_space)),
            "iuf" if isinstance(spec.action_space, Box) else "iu",
            autoreset,
            deepcopy(World.of(spec)),
        )
        self.spec = spec
        self.device = device.open(config, rewards)
        self.render_mode = render_mode
        self.metadata = {
            "name": f"{snake_case(spec.name)}_v{spec.version}",
            "render_modes": list(spec.render_modes),
            "render_fps": spec.render_fps,
            "is_parallelizable": True,
        }
        # Nobody is there before the first reset. Arrays of `live` are replaced, never written into.
        self._all = np.ones(config.n_agents, np.bool_)
        self._live = ~self._all
        self.np_random = np.random.default_rng()
        self._start: dict[str, Array] | None = None
        self._renderer: Renderer | None = None
        self._rendered_world = 0

    def __getstate__(self) -> dict[str, Any]:
        # A copy opens a window, or makes pictures, by itself.
        return {**self.__dict__, "_renderer": None}

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.spec.id}, n_agents={self.batch_size}, device={self.device.name})"

    @property
    def max_cycles(self) -> int:
        """Steps after which an episode is truncated, 0 for never. Assigning takes effect at the next step.

        ``None`` is the environment's own limit. Episodes under way count from their beginning, and those that
        are too long already end with that step. Where there was no limit, no steps were counted: they are
        from then on.
        """
        return self.device.config.limit

    @max_cycles.setter
    def max_cycles(self, value: int | None) -> None:
        self.device.set_max_cycles(value)

    def start_from(self, state: object) -> None:
        """Let the next reset set fields of states: see :meth:`reset`, whose ``options["state"]`` this is."""
        self._start = checked_start(self.spec, state, self.n_worlds)

    @uninterrupted
    def reset_batch(self, seed: int | None = None) -> Array:
        """Begin an episode for every agent; return observations of shape ``(n_agents, ...)``."""
        start, self._start = self._start, None
        obs = self.device.reset(seed)
        if start:
            obs = self.device.put(start)
        if seed is not None:
            self.np_random = np.random.default_rng(checked_seed(seed))
        self._live = self._all
        if self.render_mode == "human":
            self.render()
        return obs

    @property
    def live(self) -> Mask:
        """Which agents are present: none before the first reset; see :class:`Batch`."""
        return self._live

    @property
    def alive(self) -> Mask:
        """Which agents take part in the next step: all that are not dead. Shape ``(n_agents,)``."""
        return self.device.alive

    @property
    def action_masks(self) -> Array | None:
        """Which actions are allowed in the next step: see :class:`pearl_marl.devices.BatchStep`."""
        return self.device.action_masks

    @property
    def ready(self) -> bool:
        """Whether a step is possible: after the first reset, and until closed."""
        return self.device.ready

    def step_slots(self, actions: npt.ArrayLike) -> BatchStep:
        """See :meth:`ParallelInterface.step_slots`."""
        # Where nothing is noted here, the device's step is all that an interrupt could cut in two.
        if self.autoreset and self.render_mode != "human":
            return self.device.step(actions)
        return self._step_noted(actions)

    @uninterrupted
    def _step_noted(self, actions: npt.ArrayLike) -> BatchStep:
        return self._stepped(self.device.step(actions))

    @uninterrupted
    def reset_slots(self, mask: Mask) -> Array:
        """Begin an episode in the masked worlds, shape ``(n_worlds,)``; return all observations.

        With ``autoreset=False``, agents of those worlds that have left are back in ``agents``. Observations
        of others that have left have no meaning.
        """
        if mask is None:
            raise ArgumentError("mask is None; reset_batch() begins an episode in every world")
        obs = self.device.reset(mask=mask)
        back = self.world.rows(np.asarray(mask)) & ~self._live
        if back.any():
            self._live = self._live | back
        return obs

    def send(self, actions: npt.ArrayLike) -> None:
        """Start a step and return immediately; :meth:`recv` returns its results.

        With two environments of half the slots each, one steps while the other's results are used.
        Takes and raises what :meth:`step_batch` does.
        """
        self.device.send(self.filled(actions))

    @uninterrupted
    def recv(self) -> BatchStep:
        """Wait for the step that :meth:`send` started and return its results."""
        return self._stepped(self.device.recv())

    def _stepped(self, result: BatchStep) -> BatchStep:
        """Take note of who leaves in a step, and show it."""
        if not self.autoreset:
            leaving = on_host(result.ended) & self._live
            if leaving.any():
                self._live = self._live & ~leaving
        if self.render_mode == "human":
            self.render()
        return result

    def state(self) -> Array:
        """Return the state of every world, shape ``(n_worlds, fields)``, within ``state_space``."""
        return self.device.state()

    @functools.cached_property
    def state_space(self) -> Box:
        """The space of :meth:`state`."""
        low, high = zip(*((f.low, f.high) for f in self.spec.state), strict=True)
        shape = self.n_worlds, 1
        dtype = state_dtype(self.spec)
        return Box(
            np.tile(np.array(low, dtype), shape), np.tile(np.array(high, dtype), shape), dtype=dtype.type
        )

    @uninterrupted
    def save_state(self) -> bytes:
        """Return everything that what follows depends on; :meth:`load_state` takes it, on any device."""
        self.device.check_idle("save_state", ready=True)
        saved = self.device.shared_snapshot()
        live = self._live[:0] if self.autoreset else self._live
        return replace(saved, identity=self._identity(), live=live.view(np.uint8)).to_bytes()

    @uninterrupted
    def load_state(self, blob: bytes) -> Array:
        """Continue from what :meth:`save_state` returned, bit for bit; return every agent's observation.

        Raises
        ------
        SavedStateError
            The bytes are damaged, of another version, environment, size or mode. Nothing has changed.
        """
        self.device.check_idle("load_state")
        saved = SavedState.from_bytes(blob, self.device.config, self.autoreset)
        obs = self.device.restore(replace(saved, live=saved.live[:0]))  # which a device knows nothing of
        self._live = self._all if self.autoreset else saved.live.astype(np.bool_)
        return obs

    def recover(self) -> None:
        """After a DeviceError, continue from where the last successful call left every agent.

        Raises
        ------
        DeviceError
            The device is still not available; call again when it is.
        """
        self.device.recover()

    def set_rewards(self, table: npt.ArrayLike) -> None:
        """Replace the reward table, as many finite numbers as ``spec.rewards`` has, from the next step on."""
        self.device.set_rewards(table)

    def render(self, agent: str | None = None) -> Any:
        """Draw an agent's world, now and later (``"agent_0"``'s at first), with the renderer of the oracle.

        Returns an image of shape ``(height, width, 3)`` for ``"rgb_array"``, a string for ``"ansi"``, and
        ``None`` for ``"human"``, which draws by itself after every step.
        """
        if self.render_mode is None:
            raise OrderError(
                f"render() without a render_mode: make the environment with one of {self.spec.render_modes}"
            )
        if agent is not None:
            slot = self.slot_of(agent)
            if not self._live[slot]:
                raise OrderError(f"render({agent!r}): its episode has ended, and it has left until reset()")
            self._rendered_world = slot // self.world.agents
        state = self.device.state()[self._rendered_world]
        if self._renderer is None:
            self._renderer = renderer(self.spec, self.render_mode)
        return self._renderer.render(state)

    @uninterrupted
    def close(self) -> None:
        """Release the device and the window. Safe to call twice."""
        self.device.close()
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None

    def _identity(self) -> dict[str, Any]:
        return {**self.device.config.identity(), "autoreset": self.autoreset}


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
        A name of :func:`pearl_marl.envs`, in any case.
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
    if not isinstance(autoreset, bool):
        raise ArgumentError(f"autoreset is {autoreset!r}; it must be True or False")
    config = BatchConfig(
        spec=observed_as(spec, observations),
        n_envs=worlds_of(spec, n_agents),
        max_cycles=max_cycles,
        initial_states=initial_states,
        copy=copy,
    )
    return PearlParallelEnv(config, make_device(device), rewards, autoreset, render_mode)
