"""The Gymnasium interface: every slot is a sub-environment of one ``gymnasium.vector.VectorEnv``."""

from __future__ import annotations

import inspect
from copy import deepcopy
from typing import Any

import numpy as np
import numpy.typing as npt
from gymnasium.spaces import Space, Tuple
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from pearl_marl.agent_dict import observations_in
from pearl_marl.devices import BatchConfig, Device, make_device
from pearl_marl.errors import ArgumentError, OrderError
from pearl_marl.registry import get_spec

Array = npt.NDArray[Any]


class PearlVectorEnv(VectorEnv[Any, Any, Any]):
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

    Attributes
    ----------
    device
        The :class:`pearl_marl.devices.Device` that steps the slots.
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
        self.num_envs = int(config.n_envs)
        self.metadata = {"autoreset_mode": autoreset_mode, "render_modes": []}
        # Copies, or seeding one environment's spaces would seed another's.
        self.single_observation_space: Space[Any] = deepcopy(spec.observation_space)
        self.single_action_space: Space[Any] = deepcopy(spec.action_space)
        self.observation_space = batch_space(spec.observation_space, self.num_envs)
        self.action_space = batch_space(spec.action_space, self.num_envs)
        self._observations = observations_in(spec.observation_space)
        self._mode = autoreset_mode
        # DISABLED mode only: who waits for a reset, and what everyone saw last.
        self._waiting = np.zeros(self.num_envs, np.bool_)
        self._seen: Array | None = None

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Array | tuple[Array, ...], dict[str, Any]]:
        """Begin new episodes.

        Parameters
        ----------
        seed
            A non-negative integer for the whole batch. ``None`` goes on with the random numbers in use.
        options
            ``{"reset_mask": bool array of shape (num_envs,)}`` resets those sub-environments only.

        Returns
        -------
        The observations of all sub-environments, and infos (empty).
        """
        options = options or {}
        unknown = [name for name in options if name != "reset_mask"]
        if unknown:
            raise ArgumentError(f"unknown reset option {unknown[0]!r}; the only one is 'reset_mask'")
        mask = options.get("reset_mask")
        if mask is not None and not (mask := np.asarray(mask)).any():
            raise ArgumentError("reset_mask resets nothing: at least one element must be True")
        obs = self.device.reset(seed, mask)
        if seed is not None:
            self._np_random_seed = int(seed)
        if self._mode is AutoresetMode.DISABLED:
            if mask is None:
                self._waiting[:] = False
            else:
                assert self._seen is not None
                self._waiting &= ~mask
                obs[~mask] = self._seen[~mask]
            self._seen = obs.copy()
        return self._batched(obs), {}

    def step(self, actions: Any) -> tuple[Array | tuple[Array, ...], Array, Array, Array, dict[str, Any]]:
        """Step every sub-environment once.

        Parameters
        ----------
        actions
            Of shape ``(num_envs, *single_action_space.shape)``.

        Returns
        -------
        Observations, rewards (``float32``), terminations, truncations, infos.

        Raises
        ------
        ActionError
            Names the first agent whose action is not in the action space. Nothing has stepped.
        OrderError
            Before ``reset``, after ``close``, or in DISABLED mode while one that ended has not been reset.
        """
        if self._mode is AutoresetMode.DISABLED and self._waiting.any():
            first = int(np.argmax(self._waiting))
            raise OrderError(
                f"sub-environment {first} has ended and was not reset; in DISABLED mode call "
                "reset(options={'reset_mask': terminations | truncations}) before the next step"
            )
        result = self.device.step(actions)
        obs, rewards, terminations, truncations, final_obs = result
        infos: dict[str, Any] = {}
        if self._mode is AutoresetMode.DISABLED:
            obs = result.arrivals()
            self._waiting, self._seen = result.ended, obs.copy()
        elif self._mode is AutoresetMode.SAME_STEP and (ended := result.ended).any():
            # One object an element, as Gymnasium has it, so that wrappers can replace each by another shape.
            final = np.full(self.num_envs, None, object)
            slots = np.flatnonzero(ended)
            for slot, observation in zip(slots.tolist(), self._observations(final_obs[slots]), strict=True):
                final[slot] = observation
            infos = {"final_obs": final, "_final_obs": ended, "final_info": {}, "_final_info": ended.copy()}
        return self._batched(obs), rewards, terminations, truncations, infos

    def _batched(self, obs: Array) -> Array | tuple[Array, ...]:
        """Return observations as Gymnasium batches them: those of a ``Tuple`` space as a tuple of arrays."""
        return tuple(obs.T) if isinstance(self.single_observation_space, Tuple) else obs

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
        A ``gymnasium.vector.AutoresetMode`` or its value: see :class:`PearlVectorEnv`.
    device, max_cycles, rewards, initial_states, copy, **options
        As in :func:`pearl_marl.parallel_env`.

    Raises
    ------
    ArgumentError
        An argument is not possible: names it, its value and what is.
    DeviceError
        The device is not available.
    """
    try:
        mode = AutoresetMode(autoreset_mode)
    except ValueError:
        possible = ", ".join(repr(mode.value) for mode in AutoresetMode)
        raise ArgumentError(f"autoreset_mode is {autoreset_mode!r}; possible are {possible}") from None
    spec = get_spec(env_id).with_options(inspect.signature(make_vec).parameters, **options)
    config = BatchConfig(
        spec=spec,
        n_envs=num_envs,
        autoreset_mode=AutoresetMode.SAME_STEP if mode is AutoresetMode.DISABLED else mode,
        max_cycles=max_cycles,
        initial_states=initial_states,
        copy=copy,
    )
    return PearlVectorEnv(config, make_device(device), rewards, mode)
