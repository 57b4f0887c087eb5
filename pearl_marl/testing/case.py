"""One environment on one device, the sizes that it is tested at, and comparisons of what it returns."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any, TypeVar

import numpy as np
import pytest
from gymnasium.spaces import Box, Dict, Discrete, Space
from gymnasium.vector import AutoresetMode

from pearl_marl import devices
from pearl_marl.base.arrays import Array
from pearl_marl.batch.actions import random_actions
from pearl_marl.devices import BatchConfig, BatchStep, Device, Lockstep, Rtl
from pearl_marl.envs import get_spec
from pearl_marl.errors import DeviceError
from pearl_marl.hardware import toolchain
from pearl_marl.interfaces.parallel import PearlParallelEnv, parallel_env
from pearl_marl.interfaces.vector import PearlVectorEnv, make_vec
from pearl_marl.spec import EnvSpec
from pearl_marl.spec.elements import action_counts, bounds

T = TypeVar("T", Device, PearlParallelEnv, PearlVectorEnv)

SIZE, STEPS = 70, 40
"""What a test uses where size is not its subject: just over a cache line of slots."""

HALF = SIZE // 2
"""And where it needs a second size."""

SIZES = {"native": (1, 7, SIZE, 1000, 43008), "rtl": (SIZE,)}
"""The sizes that must begin with one another; not so many where slots are slow to step or to build."""

SPLITS: dict[str, tuple[int, ...]] = {"native": (1, HALF, 64), "rtl": ()}
"""Where a batch of :data:`SIZE` slots is cut in two."""

by_mode = pytest.mark.parametrize(
    "mode", [AutoresetMode.SAME_STEP, AutoresetMode.NEXT_STEP], ids=lambda mode: str(mode.name)
)
"""For tests of both modes of a device."""


def make_device(name: str, spec: EnvSpec, n: int = SIZE, **options: Any) -> Device:
    """Return a fresh device; skip the test, and say why, where this machine or environment has none.

    ``"lockstep"`` is the native device in lockstep with the reference. ``options`` are the device's own.
    """
    if name == "lockstep":
        return Lockstep("native", "reference", **options)
    if name == "rtl":
        try:
            for program in ("verilator", "g++", "make", "perl"):
                toolchain.find(program)
        except DeviceError as error:
            pytest.skip(str(error))
        # Few processing elements, as wide cores take long to compile. Three leave a last group that is
        # not full, one takes slot after slot.
        return Rtl(**{"pe_num": 3 if n > HALF else 1, **options})
    device = devices.make_device(name)
    return type(device)(**options) if options else device


class Case:
    """One environment on one device, by the names that :func:`make_device` takes; closes what it made."""

    def __init__(self, env_id: str, device_name: str) -> None:
        self.env_id, self.device_name = env_id, device_name
        self.spec = get_spec(env_id)
        self.agents = self.spec.agents
        self._open: list[Any] = []

    @property
    def sizes(self) -> tuple[int, ...]:
        """The sizes of :data:`SIZES` for this device."""
        return SIZES.get(self.device_name, (1, SIZE, 1000))

    @property
    def splits(self) -> tuple[int, ...]:
        """The places of :data:`SPLITS` for this device."""
        return SPLITS.get(self.device_name, (HALF,))

    def device(self, n: int = SIZE, **options: Any) -> Device:
        """Return a fresh device for ``n`` slots, not open yet."""
        return _any_action(make_device(self.device_name, self.spec, n, **options))

    def open(
        self,
        n_envs: int = SIZE,
        rewards: Any = None,
        device: Device | None = None,
        seed: int | None = None,
        **config: Any,
    ) -> Device:
        """Return an open device, reset if there is a seed; ``config`` is for :class:`BatchConfig`."""
        config = {"spec": self.spec, **config}
        opened = _any_action(device or self.device(n_envs))
        opened.open(BatchConfig(n_envs=n_envs, **config), rewards)
        return self._made(opened, seed)

    def parallel(self, n_worlds: int = SIZE, seed: int | None = None, **arguments: Any) -> PearlParallelEnv:
        """Return a new environment in PettingZoo's form, reset if there is a seed."""
        arguments = {"device": self.device(n_worlds), **arguments}
        return self._made(parallel_env(self.env_id, n_worlds * self.agents, **arguments), seed)

    def vector(self, num_envs: int = SIZE, seed: int | None = None, **arguments: Any) -> PearlVectorEnv:
        """Return a new environment in Gymnasium's form, reset if there is a seed.

        Skips the test of worlds of several agents, which have no such form.
        """
        if self.agents > 1:
            pytest.skip(f"worlds of {self.agents} agents have no Gymnasium form")
        arguments = {"device": self.device(num_envs), **arguments}
        return self._made(make_vec(self.env_id, num_envs, **arguments), seed)

    def _made(self, thing: T, seed: int | None) -> T:
        self._open.append(thing)
        if seed is not None:
            thing.reset(seed=seed)
        return thing

    def actions(self, steps: int = STEPS, n: int = SIZE, seed: int = 0) -> Array:
        """Return random actions of ``n`` slots, a batch a step; those of fewer are the first columns."""
        agents = self.spec.agents
        flat = random_actions(self.spec, np.random.default_rng(seed), n * steps * agents)
        by_slot = flat.reshape(n, steps, agents, *flat.shape[1:]).swapaxes(0, 1)
        return np.ascontiguousarray(by_slot.reshape(steps, n * agents, *flat.shape[1:]))

    def habits(self, steps: int = STEPS, n: int = SIZE) -> Array:
        """Return actions that favour one for each slot, so that episodes of many lengths end."""
        space, actions = self.spec.action_space, self.actions(steps, n)
        n_agents = n * self.spec.agents
        habit: Array
        if isinstance(space, Discrete):
            most = [action_counts(role.action_space)[0] for role in self.spec.roles] or [int(space.n)]
            habit = (np.arange(n_agents) % np.resize(most, n_agents)).astype(actions.dtype)
        else:
            habit = np.linspace(*bounds(space), n_agents, dtype=actions.dtype)
        chosen = np.random.default_rng(1).random((steps, n_agents)) < 0.5
        return np.where(chosen.reshape(steps, n_agents, *(1,) * (actions.ndim - 2)), habit, actions)

    def close(self) -> None:
        """Close all that was made here."""
        for thing in self._open:
            thing.close()


def _any_action(device: Device) -> Device:
    """Return a device that takes masked actions too, as golden functions do."""
    device.refuses = False
    return device


def shown_space(spec: EnvSpec, k: int) -> Space[Any]:
    """Return the observation space of agent ``k`` of a world, as PettingZoo has it."""
    observations, actions = spec.observation_space, spec.action_space
    if spec.roles:
        _, observations, actions = spec.roles[k]
    if not spec.mask_fields or not isinstance(actions, Discrete):
        return observations
    return Dict({"observation": observations, "action_mask": Box(0, 1, (int(actions.n),), np.int8)})


def rows_of(values: Iterable[Any], like: Array) -> Array:
    """Return the values of a dict by agent as an array, those of roles padded with zeros, without masks."""
    result = np.zeros_like(like)
    for row, value in enumerate(values):
        plain = value["observation"] if isinstance(value, dict) else value
        if result.ndim == 2:
            result[row, : len(plain)] = plain
        else:
            result[row] = plain
    return result


def sampled(env: Any, agent: str, observation: Any) -> Any:
    """Return a random action that an agent may take."""
    mask = observation["action_mask"] if isinstance(observation, dict) else None
    return env.action_space(agent).sample(mask)


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
    for mine, other in zip(ours.arrays[5:], theirs.arrays[5:], strict=True):
        assert mine.dtype == other.dtype, where
        np.testing.assert_array_equal(mine, other, f"{where} action_masks or alive")


def assert_same_trajectory(first: list[BatchStep], second: list[BatchStep]) -> None:
    """Compare two trajectories bit for bit, where their arrays have a meaning."""
    assert len(first) == len(second)
    for t, (a, b) in enumerate(zip(first, second, strict=True)):
        assert_same_step(a, b, f"step {t}")


def rows(results: list[BatchStep], start: int, stop: int, agents: int = 1) -> list[BatchStep]:
    """Return the part of a trajectory that belongs to slots ``start .. stop - 1``, of so many agents each."""
    return [step.map(lambda array: array[start * agents : stop * agents]) for step in results]


def names_of(n: int) -> list[str]:
    """Return the names of the first ``n`` agents."""
    return [f"agent_{i}" for i in range(n)]
