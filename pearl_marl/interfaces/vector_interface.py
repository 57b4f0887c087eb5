"""Gymnasium's tuples around a batch of arrays: what an environment and its wrappers have in common."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt
from gymnasium.spaces import Box, Discrete, Space, Tuple
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from pearl_marl.batch.config import checked_mask
from pearl_marl.batch.step import Array, BatchStep, on_host
from pearl_marl.deferral import uninterrupted
from pearl_marl.errors import ArgumentError, OrderError
from pearl_marl.interfaces.agent_dict import observations_in
from pearl_marl.interfaces.batch import Batch, Mask, World

Observations = Array | tuple[Array, ...]
"""Of all slots, as Gymnasium batches them: those of a ``Tuple`` space are a tuple of arrays."""

Shown = tuple[Observations, Array, Array, Array, dict[str, Any]]
"""Observations, rewards (``float32``), terminations, truncations, infos."""


_NO_PICTURES = (
    "a VectorEnv of this package draws nothing: make the environment with pearl_marl.parallel_env and a "
    "render_mode"
)


def checked_mode(given: AutoresetMode | str, render_mode: str | None) -> AutoresetMode:
    """Return an autoreset mode by its value, or by its name as Gymnasium or the command line writes it."""
    if render_mode is not None:
        raise ArgumentError(_NO_PICTURES)
    try:
        return AutoresetMode(given)
    except ValueError:
        name = given.upper().replace("-", "_") if isinstance(given, str) else ""
        if name in AutoresetMode.__members__:
            return AutoresetMode[name]
        possible = ", ".join(f"{mode.name!r} or {mode.value!r}" for mode in AutoresetMode)
        raise ArgumentError(f"autoreset_mode is {given!r}; possible are {possible}") from None


def slot_autoreset_mode(mode: AutoresetMode) -> AutoresetMode:
    """Return when a device's slots begin again under a mode: in DISABLED mode at once, but nobody sees it."""
    return AutoresetMode.SAME_STEP if mode is AutoresetMode.DISABLED else mode


class VectorInterface(VectorEnv[Any, Any, Any], Batch):
    """A ``VectorEnv`` made of a batch's methods; ``mode`` is what it does with those that ended."""

    def __init__(
        self,
        num_envs: int,
        observation_space: Space[Any],
        action_space: Discrete | Box,
        mode: AutoresetMode,
        world: World,
    ) -> None:
        self.num_envs = self.batch_size = num_envs
        self.world = world
        self.metadata = {"autoreset_mode": mode, "render_modes": []}
        self.single_observation_space = self.slot_observation_space = observation_space
        self.single_action_space: Space[Any] = action_space
        self.slot_action_space = action_space
        self.observation_space = batch_space(observation_space, num_envs)
        self.action_space = batch_space(action_space, num_envs)
        self.slot_autoreset_mode = slot_autoreset_mode(mode)
        self.autoreset = mode is not AutoresetMode.DISABLED
        self._everybody: Mask = np.ones(num_envs, np.bool_)
        self._observations = observations_in(observation_space)
        self._mode = mode
        # DISABLED mode only: who waits for a reset, and what everyone saw last.
        self._waiting = np.zeros(num_envs, np.bool_)
        self._seen: Array = np.zeros(0)

    @property
    def autoreset_mode(self) -> AutoresetMode:
        """What becomes of sub-environments that ended; Gymnasium's own environments have it, too."""
        return self._mode

    @property
    def live(self) -> Mask:
        """Everybody: nobody leaves."""
        return self._everybody

    @property
    def alive(self) -> Mask:
        """Everybody: a slot has one agent."""
        return self._everybody

    @abstractmethod
    def reset_batch(self, seed: int | None = None, mask: npt.ArrayLike | None = None) -> Array:
        """Begin new episodes, in the masked slots only if there is a mask; return all observations."""

    def began(self, obs: Array, mask: npt.ArrayLike | None) -> Array:
        """Take note of new episodes, in the masked slots or all; return ``obs``, all observations."""
        if self._mode is AutoresetMode.DISABLED:
            seen = on_host(obs).copy()
            if mask is None:
                self._waiting = np.zeros(self.num_envs, np.bool_)
            else:
                others = ~np.asarray(mask)
                self._waiting = self._waiting & others
                if len(self._seen):  # or the device was restored, and nobody has seen anything here yet
                    seen[others] = self._seen[others]
            self._seen = seen
        return obs

    def reset_slots(self, mask: Mask) -> Array:
        """Begin an episode in the masked slots; return all observations."""
        if mask is None:
            raise ArgumentError("mask is None; reset_batch() begins an episode in every slot")
        return self.reset_batch(mask=mask)

    @abstractmethod
    def start_from(self, state: object) -> None:
        """Let the next reset set fields of states: ``options["state"]`` of :meth:`reset`."""

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
            self.start_from(options["state"])
        obs = on_host(self.reset_batch(seed, mask))
        if self._mode is AutoresetMode.DISABLED:
            obs = self._seen.copy()
        return self._batched(obs), {}

    @uninterrupted
    def step(self, actions: Any) -> Shown:
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
        self.check_nobody_waits()
        return self.shown(self.step_batch(actions))

    def render(self) -> tuple[Any, ...] | None:
        """Refuse to draw."""
        raise OrderError(_NO_PICTURES)

    def check_nobody_waits(self) -> None:
        """Refuse a step in DISABLED mode while one that ended has not been reset."""
        if self._mode is AutoresetMode.DISABLED and self._waiting.any():
            first = int(np.argmax(self._waiting))
            raise OrderError(
                f"sub-environment {first} has ended and was not reset; in DISABLED mode call "
                "reset(options={'reset_mask': terminations | truncations}) before the next step"
            )

    def shown(self, result: BatchStep) -> Shown:
        """Return a step's results as Gymnasium has them."""
        result = result.on_host()
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

    def _batched(self, obs: Array) -> Observations:
        return tuple(obs.T) if isinstance(self.single_observation_space, Tuple) else obs
