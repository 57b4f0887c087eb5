"""What both interfaces are: views of a batch, in wrappers or without."""

from __future__ import annotations

import warnings
from copy import deepcopy
from typing import Any, Self

import numpy as np

from pearl_marl.base.arrays import Array
from pearl_marl.batch.rollout import Rollout
from pearl_marl.devices import Device
from pearl_marl.errors import OrderError
from pearl_marl.interfaces.batch import Batch, DeviceBatch
from pearl_marl.policies.device_policy import DevicePolicy


class BatchView:
    """A batch as another package's environment: ``batch`` is what steps, and wrappers change it."""

    batch: Batch
    inside: Self | None
    """The same without the outermost wrapper; ``None`` where there is none."""

    # Two environments that share a device would step each other's agents.
    __copy__ = deepcopy

    def __getattr__(self, name: str) -> Any:
        if name not in _MOVED:
            raise AttributeError(f"{type(self).__name__!r} object has no attribute {name!r}")
        new = _MOVED[name]
        warnings.warn(f"{name} of an environment is now batch.{new}", DeprecationWarning, stacklevel=2)
        return getattr(self.batch, new)

    @property
    def env(self) -> Self:
        """The environment without the outermost wrapper; no attribute of one that has none."""
        if self.inside is None:
            raise AttributeError(f"{type(self).__name__} has no wrapper, and so no 'env'")
        return self.inside

    @property
    def unwrapped(self) -> Self:
        """The environment without any wrapper."""
        return self if self.inside is None else self.inside.unwrapped

    @property
    def transform(self) -> Any:
        """What the outermost wrapper does: see :class:`pearl_marl.wrappers.transform.Transform`."""
        return self.batch.transform  # type: ignore[attr-defined]  # where there is a wrapper

    @property
    def unchanged(self) -> DeviceBatch:
        """The batch of the device; refused in wrappers, which would not know what happens to it."""
        if not isinstance(self.batch, DeviceBatch):
            raise OrderError(
                "a wrapped environment has no send(), recv() and rollout(): only step() and step_batch()"
            )
        return self.batch

    @property
    def device(self) -> Device:
        """The :class:`pearl_marl.devices.Device` that steps the slots."""
        return self.batch.innermost.device

    @property
    def np_random(self) -> np.random.Generator:
        """Random numbers for other packages' wrappers, from the seed of a reset."""
        return self.batch.innermost.np_random

    @np_random.setter
    def np_random(self, value: np.random.Generator) -> None:
        self.batch.innermost.np_random = value

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

    @property
    def action_masks(self) -> Array | None:
        """Which actions are allowed in the next step: see :class:`pearl_marl.devices.BatchStep`."""
        return self.batch.action_masks

    @property
    def ready(self) -> bool:
        """Whether a step is possible: after the first reset, and until closed."""
        return self.batch.ready

    def rollout(
        self, policy: DevicePolicy, steps: int, record: bool = False, episodes: int | None = None
    ) -> Rollout:
        """Step every agent so many times with the actions of a policy in integers, in one call.

        The device does it all, and the environment is then as after as many steps one by one.

        Parameters
        ----------
        policy
            What :func:`pearl_marl.load_policy` returns.
        steps
            How many, at least 1.
        record
            Whether to return every step, too, and not only the sums of episodes.
        episodes
            How many episodes of each agent count, its first; all, if not given.

        Raises
        ------
        ArgumentError
            The policy is none, or for another environment, or a number is impossible.
        OrderError
            Before the first reset, in a wrapper, or where agents do not start over by themselves.
        """
        return self.unchanged.rollout(policy, steps, record, episodes)

    def recover(self) -> None:
        """After a DeviceError, continue from where the last successful call left every agent.

        Raises
        ------
        DeviceError
            The device is still not available; call again when it is.
        """
        self.device.recover()


_MOVED = {
    **{name: name for name in ("batch_size", "world", "slot_autoreset_mode", "autoreset")},
    "slot_observation_space": "observation_space",
    "slot_action_space": "action_space",
    "live": "present",
    "alive": "in_episode",
}
"""What is a batch's, by the names of before. Some of them are an environment's, too."""
