"""What the tests share: the devices there are, the sizes they bear, and one (environment, device) pair."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from gymnasium.spaces import Discrete

import pearl_marl
from pearl_marl import hardware, toolchain
from pearl_marl.actions import random_actions
from pearl_marl.devices import BatchConfig, BatchStep, Device, Lockstep, Native, Reference, Rtl
from pearl_marl.errors import DeviceError
from pearl_marl.spec import EnvSpec

from .toy import TOYS

Array = np.ndarray[Any, Any]

DEVICES = ("native", "reference", "lockstep", "rtl")
"""Every device that the contract runs on. Add its maker to :func:`make_device` and its sizes below."""

LARGEST = {"native": 43008, "reference": 43008, "lockstep": 43008, "rtl": 1000}
"""More slots than this take a device too long for the everyday suite."""

SIZE, STEPS = 70, 40
"""What a contract test uses where size is not its subject: just over a cache line of slots."""

ENVIRONMENTS = (*pearl_marl.envs(), *(spec.name for spec in TOYS))


def make_device(name: str, spec: EnvSpec, **options: Any) -> Device:
    """Return a fresh device, or skip the test and say why this machine or environment cannot."""
    if name == "native":
        return Native(**options)
    if name == "reference":
        return Reference(**options)
    if name == "lockstep":
        return Lockstep("native", "reference", **options)
    if name == "rtl":
        try:
            hardware.core_path(spec)
            toolchain.find("verilator")
            toolchain.find("g++")
        except DeviceError as error:
            pytest.skip(str(error))
        return Rtl(**options)
    pytest.skip(f"no device {name!r} on this machine")


class Case:
    """One environment on one device; closes what it made."""

    def __init__(self, env_id: str, device_name: str) -> None:
        self.env_id, self.device_name = env_id, device_name
        self.spec = pearl_marl.get_spec(env_id)
        self._open: list[Any] = []

    def device(self, **options: Any) -> Device:
        return make_device(self.device_name, self.spec, **options)

    def open(
        self, n_envs: int = SIZE, rewards: Any = None, device: Device | None = None, **config: Any
    ) -> Device:
        """Return an open device."""
        config = {"spec": self.spec, **config}
        return self._closing((device or self.device()).open(BatchConfig(n_envs=n_envs, **config), rewards))

    def parallel(self, n_agents: int = SIZE, **arguments: Any) -> pearl_marl.PearlParallelEnv:
        arguments = {"device": self.device(), **arguments}
        return self._closing(pearl_marl.parallel_env(self.env_id, n_agents, **arguments))

    def vector(self, num_envs: int = SIZE, **arguments: Any) -> pearl_marl.PearlVectorEnv:
        arguments = {"device": self.device(), **arguments}
        return self._closing(pearl_marl.make_vec(self.env_id, num_envs, **arguments))

    def actions(self, steps: int = STEPS, n: int = SIZE, seed: int = 0) -> Array:
        """Return random actions, a batch a step; those of fewer slots are the first columns."""
        flat = random_actions(self.spec, np.random.default_rng(seed), n * steps)
        return np.ascontiguousarray(flat.reshape(n, steps, *flat.shape[1:]).swapaxes(0, 1))

    def habits(self, steps: int = STEPS, n: int = SIZE) -> Array:
        """Return actions that favour one for each slot, so that episodes of many lengths end."""
        space, actions = self.spec.action_space, self.actions(steps, n)
        if isinstance(space, Discrete):
            habit = (np.arange(n) % space.n).astype(actions.dtype)
        else:
            habit = np.linspace(space.low, space.high, n, dtype=actions.dtype)
        chosen = np.random.default_rng(1).random((steps, n)) < 0.5
        return np.where(chosen.reshape(steps, n, *(1,) * (actions.ndim - 2)), habit, actions)

    def close(self) -> None:
        for thing in self._open:
            thing.close()

    def _closing(self, thing: Any) -> Any:
        self._open.append(thing)
        return thing


def trajectory(device: Any, actions: Array) -> list[BatchStep]:
    """Step through all rows of ``actions``. Works on a device and on an environment with ``step_batch``."""
    step: Callable[[Array], BatchStep] = getattr(device, "step_batch", None) or device.step
    return [step(row) for row in actions]


def assert_same_step(ours: BatchStep, theirs: BatchStep, where: str = "") -> None:
    """Compare everything that has a meaning, dtypes included."""
    ended = theirs.terminations | theirs.truncations
    for name in ("obs", "rewards", "terminations", "truncations"):
        mine, other = getattr(ours, name), getattr(theirs, name)
        assert mine.dtype == other.dtype, f"{where} {name}"
        np.testing.assert_array_equal(mine, other, f"{where} {name}")
    np.testing.assert_array_equal(ours.final_obs[ended], theirs.final_obs[ended], f"{where} final_obs")


def assert_same_trajectory(first: list[BatchStep], second: list[BatchStep]) -> None:
    """Compare two trajectories bit for bit, where their arrays have a meaning."""
    assert len(first) == len(second)
    for t, (a, b) in enumerate(zip(first, second, strict=True)):
        assert_same_step(a, b, f"step {t}")


def rows(results: list[BatchStep], start: int, stop: int) -> list[BatchStep]:
    """Return the part of a trajectory that belongs to slots ``start .. stop - 1``."""
    return [BatchStep(*(array[start:stop] for array in step)) for step in results]
