"""The Gymnasium interface: every slot is a sub-environment of one ``gymnasium.vector.VectorEnv``."""

from __future__ import annotations

import inspect
from collections.abc import Mapping
from typing import Any, Self

import numpy as np
import numpy.typing as npt
from gymnasium.spaces import Space, Tuple
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from pearl_marl.base.arrays import Array
from pearl_marl.base.deferral import uninterrupted
from pearl_marl.batch.config import checked_mask
from pearl_marl.batch.step import BatchStep, on_host
from pearl_marl.compiler.packing import observed_as
from pearl_marl.devices import BatchConfig, Device, make_device
from pearl_marl.envs import get_spec
from pearl_marl.errors import ArgumentError, OrderError
from pearl_marl.interfaces.agent_dict import observations_in
from pearl_marl.interfaces.batch import Batch, DeviceBatch
from pearl_marl.interfaces.view import BatchView
from pearl_marl.interfaces.world import Mask
from pearl_marl.spec import check_slots

Observations = Array | tuple[Array, ...]
"""Of all slots, as Gymnasium batches them: those of a ``Tuple`` space are a tuple of arrays."""

Results = tuple[Observations, Array, Array, Array, dict[str, Any]]
"""Observations, rewards (``float32``), terminations, truncations, infos."""


_NO_PICTURES = (
    "a VectorEnv of this package draws nothing: make the environment with pearl_marl.parallel_env and a "
    "render_mode"
)


def checked_mode(mode: AutoresetMode | str, render_mode: str | None) -> AutoresetMode:
    """Return an autoreset mode by its value, or by its name as Gymnasium or the command line writes it."""
    if render_mode is not None:
        raise ArgumentError(_NO_PICTURES)
    try:
        return AutoresetMode(mode)
    except ValueError:
        name = mode.upper().replace("-", "_") if isinstance(mode, str) else ""
        if name in AutoresetMode.__members__:
            return AutoresetMode[name]
        possible = ", ".join(f"{mode.name!r} or {mode.value!r}" for mode in AutoresetMode)
        raise ArgumentError(f"autoreset_mode is {mode!r}; possible are {possible}") from None


class PearlVectorEnv(BatchView, VectorEnv[Any, Any, Any]):
    """The slots of a batch as a ``gymnasium.vector.VectorEnv``, in wrappers or without.

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
    batch
        What steps: see :class:`pearl_marl.interfaces.batch.Batch`. Wrappers change it.
    env
        The environment without the outermost wrapper; only where there is one.
    """

    def __init__(self, batch: Batch, mode: AutoresetMode, inside: Self | None = None) -> None:
        self.batch, self._mode, self.inside = batch, mode, inside
        self.num_envs = count = batch.batch_size
        self.metadata = {"autoreset_mode": mode, "render_modes": []}
        self.spec = None if inside is None else inside.spec  # which gymnasium.make_vec notes
        self.single_observation_space: Space[Any] = batch.observation_space
        self.single_action_space: Space[Any] = batch.action_space
        self.observation_space = batch_space(self.single_observation_space, count)
        self.action_space = batch_space(self.single_action_space, count)
        self._observations = observations_in(self.single_observation_space)
        # DISABLED mode only: which wait for a reset, and what all saw last.
        self._waiting = np.zeros(count, np.bool_)
        self._last_obs: Array = np.zeros(0)

    def around(self, batch: Batch) -> PearlVectorEnv:
        """Return an environment like this one of a batch that changes this one's."""
        return PearlVectorEnv(batch, self.autoreset_mode, self)

    @property
    def autoreset_mode(self) -> AutoresetMode:
        """What becomes of sub-environments that ended; Gymnasium's own environments have it, too."""
        return self._mode

    @property
    def np_random_seed(self) -> int:
        """What they were made from; -1 where they were assigned."""
        return self.batch.innermost.np_random_seed

    def step_batch(self, actions: npt.ArrayLike) -> BatchStep:
        """Step every slot once; return arrays, in DISABLED mode those of ``SAME_STEP``."""
        return self.batch.step_batch(actions)

    @uninterrupted
    def reset_batch(self, seed: int | None = None, mask: npt.ArrayLike | None = None) -> Array:
        """Begin new episodes, in the masked slots only if there is a mask; return all observations."""
        return self._began(self.batch.reset_batch(seed, mask), mask)

    def reset_slots(self, mask: Mask) -> Array:
        """Begin an episode in the masked slots; return all observations."""
        return self._began(self.batch.reset_slots(mask), mask)

    def _began(self, obs: Array, mask: npt.ArrayLike | None) -> Array:
        """Take note of new episodes, in the masked slots or all; return ``obs``, all observations."""
        if self.autoreset_mode is AutoresetMode.DISABLED:
            latest = on_host(obs).copy()
            if mask is None:
                self._waiting = np.zeros(self.num_envs, np.bool_)
            else:
                others = ~np.asarray(mask)
                self._waiting = self._waiting & others
                if len(self._last_obs):  # or the device was restored, and nothing has been returned here yet
                    latest[others] = self._last_obs[others]
            self._last_obs = latest
        return obs

    @uninterrupted
    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observations, dict[str, Any]]:
        """Begin new episodes; return the observations of all sub-environments, and empty infos.

        ``seed`` is a non-negative integer for the whole batch; ``None`` goes on with the random numbers in
        use. ``options={"reset_mask": mask}``, ``bool`` of shape ``(num_envs,)``, resets some only, and
        ``options={"state": {"field": values}}`` sets fields of the states that episodes begin with: a number,
        or an array of shape ``(num_envs,)``.
        """
        options = {} if options is None else options
        if not isinstance(options, Mapping):
            raise ArgumentError(
                f"options is {options!r}; it must be a dict, as {{'reset_mask': mask}}, or None"
            )
        unknown = [name for name in options if name not in ("reset_mask", "state")]
        if unknown:
            raise ArgumentError(f"unknown reset option {unknown[0]!r}; there are 'reset_mask' and 'state'")
        mask = options.get("reset_mask")
        if mask is not None and not (mask := checked_mask(mask, self.num_envs)).any():
            raise ArgumentError("reset_mask resets nothing: at least one element must be True")
        if options.get("state") is not None:
            self.batch.innermost.start_from(options["state"])
        obs = on_host(self.reset_batch(seed, mask))
        if self.autoreset_mode is AutoresetMode.DISABLED:
            obs = self._last_obs.copy()
        return self._batched(obs), {}

    @uninterrupted
    def send(self, actions: npt.ArrayLike) -> None:
        """Start a step and return at once; :meth:`recv` has its results. Takes what :meth:`step` does."""
        self.check_none_waits()
        self.unchanged.send(actions)

    @uninterrupted
    def recv(self) -> Results:
        """Wait for the step that :meth:`send` started and return what :meth:`step` would have."""
        return self._results(self.unchanged.recv())

    def close_extras(self, **kwargs: Any) -> None:
        """Release the device."""
        if self.inside is not None:
            self.inside.close(**kwargs)
        self.batch.innermost.close()

    @uninterrupted
    def step(self, actions: Any) -> Results:
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
        self.check_none_waits()
        return self._results(self.batch.step_batch(actions))

    def render(self) -> tuple[Any, ...] | None:
        """Refuse to draw."""
        raise OrderError(_NO_PICTURES)

    def check_none_waits(self) -> None:
        """Refuse a step in DISABLED mode while one that ended has not been reset."""
        if self.autoreset_mode is AutoresetMode.DISABLED and self._waiting.any():
            first = int(np.argmax(self._waiting))
            raise OrderError(
                f"sub-environment {first} has ended and was not reset; in DISABLED mode call "
                "reset(options={'reset_mask': terminations | truncations}) before the next step"
            )

    def _results(self, result: BatchStep) -> Results:
        """Return a step's results as Gymnasium has them."""
        result = result.on_host()
        obs, rewards, terminations, truncations, final_obs = result
        infos: dict[str, Any] = {}
        if self.autoreset_mode is AutoresetMode.DISABLED:
            obs = result.arrivals()
            self._waiting, self._last_obs = result.ended, obs.copy()
        elif self.autoreset_mode is AutoresetMode.SAME_STEP and (ended := result.ended).any():
            # One object an element, as Gymnasium has it, so that wrappers can replace each by another shape.
            final = np.full(self.num_envs, None, object)
            rows = np.flatnonzero(ended)
            for row, observation in zip(rows.tolist(), self._observations(final_obs[rows]), strict=True):
                final[row] = observation
            infos = {"final_obs": final, "_final_obs": ended, "final_info": {}, "_final_info": ended.copy()}
        return self._batched(obs), rewards, terminations, truncations, infos

    def _batched(self, obs: Array) -> Observations:
        return tuple(obs.T) if isinstance(self.single_observation_space, Tuple) else obs


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
        A name of :func:`pearl_marl.list_envs`, in any case.
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
    autoreset = mode is not AutoresetMode.DISABLED
    config = BatchConfig(
        spec=observed_as(spec, observations),
        n_envs=num_envs,
        autoreset_mode=mode if autoreset else AutoresetMode.SAME_STEP,  # at once then, and not shown
        max_cycles=max_cycles,
        initial_states=initial_states,
        copy=copy,
    )
    batch = DeviceBatch(config, make_device(device), rewards, autoreset=autoreset, leaves=False)
    return PearlVectorEnv(batch, mode)
