"""The Gymnasium interface: every slot is a sub-environment of one ``gymnasium.vector.VectorEnv``."""

from __future__ import annotations

import inspect
from copy import deepcopy
from typing import Any

import numpy.typing as npt
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode

from pearl_marl.batch.starts import checked_start
from pearl_marl.batch.step import Array
from pearl_marl.deferral import uninterrupted
from pearl_marl.devices import BatchConfig, BatchStep, Device, make_device
from pearl_marl.errors import ArgumentError
from pearl_marl.interfaces.batch import World
from pearl_marl.interfaces.vector_interface import Shown, VectorInterface, checked_mode, slot_autoreset_mode
from pearl_marl.packing import observed_as
from pearl_marl.registry import get_spec
from pearl_marl.spec import check_slots


class PearlVectorEnv(VectorInterface):
    """Many slots of one environment as a ``gymnasium.vector.VectorEnv``.

    Make one with :func:`make_vec`. In each autoreset mode it returns what Gymnasium's own
    ``SyncVectorEnv`` returns, with these differences: rewards are ``float32``, one seed serves the
    whole batch, and ``infos`` hold nothing but final observations.

    ``SAME_STEP``
        Where a sub-environment ended, ``obs`` is the first observation of its next episode, and
        ``infos["final_obs"]`` (with its mask ``_final_obs``) the last of the old one.
    ``NEXT_STEP``
        It spends its next step resetting: the action is ignored, the reward 0.
    ``DISABLED``
        It has to be reset before the next step: ``reset(options={"reset_mask": ended})``.

    ``device`` is the :class:`pearl_marl.devices.Device` that steps the slots.
    """

    def __init__(
        self,
        config: BatchConfig,
        device: Device,
        rewards: npt.ArrayLike | None,
        autoreset_mode: AutoresetMode,
    ) -> None:
        spec = config.spec
        self.device = device.open(config, rewards)
        self._start: dict[str, Array] | None = None
        # Copies, or seeding one environment's spaces would seed another's.
        spaces = deepcopy(spec.observation_space), deepcopy(spec.action_space)
        super().__init__(config.n_envs, *spaces, autoreset_mode, World.of(spec))

    def start_from(self, state: object) -> None:
        """Let the next reset set fields of states: see :meth:`reset`, whose ``options["state"]`` this is."""
        self._start = checked_start(self.device.config.spec, state, self.device.config.n_envs)

    @uninterrupted
    def reset_batch(self, seed: int | None = None, mask: npt.ArrayLike | None = None) -> Array:
        """See :class:`VectorInterface`."""
        start, self._start = self._start, None
        obs = self.device.reset(seed, mask)
        if start:
            obs = self.device.put(start, mask)
        if seed is not None:
            self._np_random, self._np_random_seed = seeding.np_random(int(seed))
        return self.began(obs, mask)

    def step_batch(self, actions: npt.ArrayLike) -> BatchStep:
        """See :class:`VectorInterface`."""
        return self.device.step(actions)

    @uninterrupted
    def send(self, actions: npt.ArrayLike) -> None:
        """Start a step and return at once; :meth:`recv` has its results. Takes what :meth:`step` does."""
        self.check_nobody_waits()
        self.device.send(actions)

    @uninterrupted
    def recv(self) -> Shown:
        """Wait for the step that :meth:`send` started and return what :meth:`step` would have."""
        return self.shown(self.device.recv())

    @property
    def max_cycles(self) -> int:
        """See :class:`pearl_marl.PearlParallelEnv`."""
        return self.device.config.limit

    @max_cycles.setter
    def max_cycles(self, value: int | None) -> None:
        self.device.set_max_cycles(value)

    def recover(self) -> None:
        """See :meth:`pearl_marl.PearlParallelEnv.recover`."""
        self.device.recover()

    @property
    def action_masks(self) -> Array | None:
        """Which actions may be taken in the next step: see :class:`pearl_marl.devices.BatchStep`."""
        return self.device.action_masks

    @property
    def ready(self) -> bool:
        """See :class:`pearl_marl.interfaces.batch.Batch`."""
        return self.device.ready

    def close_extras(self, **kwargs: Any) -> None:
        """Release the device."""
        self.device.close()


def make_vec(
    env_id: str,
    num_envs: int = 1,
    *,
    autoreset_mode: AutoresetMode | str = AutoresetMode.SAME_STEP,
    device: str | Device = "native",
    max_cycles: int | None = None,
    rewards: npt.ArrayLike | None = None,
    initial_states: str = "random",
    copy: bool = True,
    observations: str = "whole",
    **options: Any,
) -> PearlVectorEnv:
    """Make a ``gymnasium.vector.VectorEnv``.

    Parameters
    ----------
    env_id
        A name of :func:`pearl_marl.envs`, in any case.
    num_envs
        How many slots.
    autoreset_mode
        A ``gymnasium.vector.AutoresetMode``, or its name or value: see :class:`PearlVectorEnv`.
    device, max_cycles, rewards, initial_states, copy, observations, **options
        As in :func:`pearl_marl.parallel_env`.

    Raises
    ------
    ArgumentError
        An argument is not possible: names it, its value and what is. Or agents share worlds.
    DeviceError
        The device is not available.
    """
    mode = checked_mode(autoreset_mode, options.pop("render_mode", None))
    check_slots("num_envs", num_envs)
    spec = get_spec(env_id).with_options(inspect.signature(make_vec).parameters, **options)
    if spec.agents > 1:
        raise ArgumentError(
            f"{spec.name} has worlds of {spec.agents} agents, and a VectorEnv cannot represent those: "
            f"call pearl_marl.parallel_env({spec.name!r}, n_agents=...) instead"
        )
    config = BatchConfig(
        spec=observed_as(spec, observations),
        n_envs=num_envs,
        autoreset_mode=slot_autoreset_mode(mode),
        max_cycles=max_cycles,
        initial_states=initial_states,
        copy=copy,
    )
    return PearlVectorEnv(config, make_device(device), rewards, mode)
