"""Slots over processes and machines: each shard of them is an actor of a Ray cluster, with its own device.

::

    this process                                      actors, wherever Ray has placed them

    Ray --+-- slots 0 .. a-1 --> _Shard --actions-->  _Host --> native, cuda, rtl, a board ...
          |                             <--results--
          +-- slots a .. n-1 --> _Shard --actions-->  _Host --> native, cuda, rtl, a board ...
                                        <--results--

It is :class:`~pearl_marl.devices.sharded.Sharded` over parts that are elsewhere. A part keeps a state of its
slots and the calls since. When its actor is lost, the part starts another one, gives it that state, and makes
these calls again, then the one that failed. What comes back is what would have come without it, bit for bit.
"""

from __future__ import annotations

import pickle
import platform
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from gymnasium.vector import AutoresetMode

from pearl_marl.base.arrays import Array
from pearl_marl.batch.config import BatchConfig
from pearl_marl.batch.rewards import categories
from pearl_marl.batch.saved_state import SavedState
from pearl_marl.batch.step import BatchStep, Observed
from pearl_marl.compiler.kernels import kernel_name, kernel_source
from pearl_marl.devices import cluster
from pearl_marl.devices.base import Device, Phase
from pearl_marl.devices.by_name import make_distinct
from pearl_marl.devices.recovery import CHECKPOINT_EVERY, CheckpointLog
from pearl_marl.devices.sharded import Sharded
from pearl_marl.errors import ArgumentError, DeviceError
from pearl_marl.spec import EnvSpec

TRIES = 3
"""How many actors in a row one call may lose until it raises."""

CLOSE_SECONDS = 10.0
"""How long a device may take to close before its actor is ended anyway."""


class _ShardLogs(CheckpointLog):
    """The logs of all shards: a call has succeeded only if it has on all of them."""

    def before(self, device: Any, call: str) -> None:
        """Mark the moment to go back to, unless there is one already."""
        if device.phase is not Phase.FAILED:
            for part in device.parts:
                part.recovery.mark()

    def after(self, device: Any, call: str, *arguments: Any) -> None:
        """Every shard has noted it in its own log."""

    def recover(self, device: Any) -> None:
        """Bring every shard to the mark; see :meth:`Device.recover`."""
        if device.phase is Phase.OPEN:
            raise DeviceError(
                f"the {device.name} device keeps nothing to recover from, as no reset has succeeded: "
                "call reset(), or load a saved state"
            )
        self.before(device, "recover")
        device.fail()
        device.on_all(lambda part, _: part.recovery.rewind(part))
        device.phase = Phase.READY


class Ray(Sharded):
    """Slots shared among actors of a Ray cluster: see :func:`pearl_marl.devices.cluster.connect`.

    An actor that is lost is replaced, and its slots go on as if nothing had happened. Where
    that is not possible the call raises DeviceError, and :meth:`recover` goes on once it is.

    Parameters
    ----------
    shards
        The devices, names or configured, in the order of the slots: one actor each.
    sizes
        How many slots each has; ``None`` for equal shares, where the first ones may have one more.
    resources
        What an actor holds while it lives, by Ray's names: ``{"fpga": 1}``, ``{"GPU": 1}``, ``{"CPU": 2}``.
        One for all shards, or a list with one (or ``None``) for each. ``None`` holds nothing.
    checkpoint_every
        Steps between two states that are kept of a shard, in this process; ``None`` keeps nothing, and
        what is lost stays lost.
    """

    recovery_type = _ShardLogs

    def __init__(
        self,
        shards: Sequence[str | Device],
        sizes: Sequence[int] | None = None,
        resources: Mapping[str, float] | Sequence[Mapping[str, float] | None] | None = None,
        checkpoint_every: int | None = CHECKPOINT_EVERY,
    ) -> None:
        made = make_distinct("shards", shards, "each is for one actor")
        if any(isinstance(device, Ray) for device in made):
            raise ArgumentError("a shard of a Ray device is a Ray device itself: list its shards instead")
        if resources is None or isinstance(resources, Mapping):
            resources = [resources] * len(made)
        elif isinstance(resources, str) or not isinstance(resources, Sequence) or len(resources) != len(made):
            raise ArgumentError(
                f"resources is {resources!r}; it must be one for all, or a list of one for each of the "
                f"{len(made)} shards"
            )
        checked = map(cluster.checked_resources, resources)
        parts = [_Shard(device, needs) for device, needs in zip(made, checked, strict=True)]
        super().__init__(parts, sizes, checkpoint_every)
        # Each keeps its own, so that only what is lost has to be done again.
        self.part_checkpoint_every = self.checkpoint_every
        self.name = f"ray({', '.join(device.name for device in made)})"

    def _open_parts(self, config: BatchConfig) -> None:
        cluster.connect()
        self.on_all(partial(self.open_part, config))


class _Shard(Device):
    """A device that is in an actor, which holds ``resources``, as a device here."""

    recovery_type = CheckpointLog

    def __init__(self, device: Device, resources: Mapping[str, float]) -> None:
        self.name = device.name
        self._device, self._resources = device, resources

    def _apply_rewards(self, table: npt.ArrayLike) -> None:
        self._ask("call", "set_rewards", np.array(table))

    def _apply_limit(self, config: BatchConfig) -> None:
        self._ask("call", "set_max_cycles", config.max_cycles)

    def _open(self, config: BatchConfig) -> None:
        self._reviving = False
        self._actor: Any = None
        # The state right after a reset, which comes with it: asked for later, it might be lost by then.
        self._fresh: tuple[Array, Array] | None = None
        self._final_obs = np.zeros(
            (config.n_agents, *config.spec.observation_shape), config.spec.observation_dtype
        )
        try:
            self._start(config, None)
        except cluster.lost() as error:
            raise DeviceError(
                f"the actor of a shard ({self.name}) was lost while it started: {error}"
            ) from error

    def _reset(self, mask: Array | None, seed: int | None) -> Observed:
        keeps = mask is None and self.checkpoint_every is not None
        observed, self._fresh = self._ask("reset", seed, mask, keeps, anew=seed is not None)
        return observed  # type: ignore[no-any-return]

    def _step(self, actions: Array) -> BatchStep:
        # Observations may be of a narrower dtype here; Sharded writes them into arrays of the space's.
        obs, rewards, terminations, truncations, ends, *others = self._ask("step", actions)
        final_obs = obs
        if ends is not None and len(ends):
            final_obs = self._final_obs
            final_obs[terminations | truncations] = ends
        arrays = obs, rewards, terminations, truncations, final_obs, *others
        return BatchStep.of(arrays, bool(self.config.spec.mask_fields))

    def _read(self) -> tuple[Array, Array]:
        fresh, self._fresh = self._fresh, None
        if fresh is None:
            saved = self._ask("call", "snapshot")
            fresh = saved.memory, saved.stored
        return fresh

    def _write(self, memory: Array, stored: Array) -> Observed:
        saved = self.saved(memory, stored)
        return self._ask("restore", self.config.max_cycles, saved, anew=True)  # type: ignore[no-any-return]

    def _close(self) -> None:
        try:
            if self._actor is not None:
                cluster.get(self._actor.call.remote("close"), CLOSE_SECONDS)
        except Exception:  # it is gone, or hangs, or failed: there is nothing to be saved
            pass
        finally:
            self._drop()

    def _ask(self, call: str, *arguments: Any, anew: bool = False) -> Any:
        """Call a method of :class:`_Host` in the actor; if that is lost, in another one.

        ``anew`` says that what comes of it does not depend on what was before.
        """
        for tries_left in reversed(range(TRIES)):
            try:
                if self._actor is None:
                    self._start(self.config, categories(self.config.spec, self.reward_table))
                    if not anew and self.phase is not Phase.OPEN:
                        self._catch_up()
                return cluster.get(getattr(self._actor, call).remote(*arguments))
            except cluster.lost() as error:
                self._drop()
                if self._reviving:  # the call that revives it counts
                    raise
                if not tries_left:
                    first = self.config.first_slot
                    raise DeviceError(
                        f"the actor of slots {first} to {first + self.config.n_envs - 1} ({self.name}) was "
                        f"lost {TRIES} times in a row, at last by: {str(error).strip()}\nLook for what ends "
                        f"it (often memory: `ray status`, `ray memory`), then {self.remedy}"
                    ) from error
        raise AssertionError("unreachable")

    def _start(self, config: BatchConfig, rewards: Array | None) -> None:
        """Start an actor and open the device there."""
        actor = cluster.start_actor(_Host, resources=self._resources)
        try:
            cluster.get(actor.open.remote(pack(config.spec, self._device, config), rewards))
        except BaseException:
            cluster.kill(actor)
            raise
        self._actor = actor

    def _catch_up(self) -> None:
        """Bring a new actor to where the last call that succeeded left the one before."""
        now = self.position  # a call may be under way
        self._reviving = True
        try:
            self.recover()
        except BaseException:
            self._drop()
            raise
        finally:
            self._reviving = False
            self.position = now

    def _drop(self) -> None:
        actor, self._actor = self._actor, None
        if actor is not None:
            cluster.kill(actor)


class _Host:
    """What an actor is: a device, and the calls of a :class:`_Shard`."""

    def open(self, packed: Packed, rewards: Array | None) -> None:
        """Open the device; refuse an environment that is not that of the other side."""
        device, config = unpacked(packed)[1:]
        self._wire_dtype = wire_dtype(config.spec)
        device.checkpoint_every = None  # what is kept here would be lost with the actor
        self._device: Device = device.open(config, rewards)

    def step(self, words: Array) -> tuple[Array | None, ...]:
        """Step; return results in as few bytes as they need.

        Observations come in the dtype of :func:`wire_dtype`, and final ones only of agents that ended, one
        after the other (``None`` in NEXT_STEP mode of one agent, where they are the observations).
        """
        # What came through Ray may be read-only, for which kernels would be compiled once more.
        results = self._device.step_words(words.copy())
        ends = None
        config = self._device.config
        if config.autoreset_mode is AutoresetMode.SAME_STEP or config.spec.agents > 1:
            ends = results.final_obs[results.ended].astype(self._wire_dtype, copy=False)
        obs = results.obs.astype(self._wire_dtype, copy=False)
        return (obs, *results[1:4], ends, *results.arrays[5:])

    def reset(
        self, seed: int | None, mask: Array | None, keeps: bool
    ) -> tuple[Observed, tuple[Array, Array] | None]:
        """Reset; return the state too if it is to be kept."""
        observed = self._observed(self._device.reset(seed, None if mask is None else mask.copy()))
        if not keeps:
            return observed, None
        saved = self._device.snapshot()
        return observed, (saved.memory, saved.stored)

    def _observed(self, obs: Array) -> Observed:
        return Observed(obs, self._device.action_masks, self._device.in_episode)

    def restore(self, max_cycles: int | None, saved: SavedState) -> Observed:
        """Continue from a snapshot, under the time limit of that moment."""
        self._device.config = replace(self._device.config, max_cycles=max_cycles)
        return self._observed(self._device.restore(saved.copy()))

    def call(self, name: str, *arguments: Any) -> Any:
        """Make any other call of the device."""
        return getattr(self._device, name)(*arguments)


def wire_dtype(spec: EnvSpec) -> np.dtype[Any]:
    """Return the narrowest dtype that holds all observations; for integers mostly less than the space's."""
    whole = spec.observation_dtype
    if whole.kind not in "iu" or spec.unpack is not None:
        return whole
    narrow: np.dtype[Any] = np.result_type(*(field.dtype for field in spec.observation))
    return narrow if narrow.kind in "iu" and narrow.itemsize < whole.itemsize else whole


class Packed(NamedTuple):
    """An environment and other things on their way to an actor: see :func:`pack`."""

    content: bytes
    environment: str
    fingerprint: str


def pack(spec: EnvSpec, *others: Any) -> Packed:
    """Return an environment and other things as an actor takes them, on a machine with the same packages."""
    return Packed(cluster.connect().cloudpickle.dumps((spec, *others)), spec.name, fingerprint(spec))


def unpacked(packed: Packed) -> tuple[Any, ...]:
    """Return what was packed, in the actor; refuse an environment that is not that of the other side."""
    name = packed.environment
    try:
        content: tuple[Any, ...] = pickle.loads(packed.content)
    except Exception as error:
        raise DeviceError(
            f"{platform.node()} cannot load the environment {name} or the device: {error!r}; install the "
            "package that has them on every machine of the cluster, or add its folder to PYTHONPATH there"
        ) from None
    if fingerprint(content[0]) != packed.fingerprint:
        raise DeviceError(
            f"{platform.node()} has another {name} than the process that asks for it: install the same "
            "version of its package on every machine of the cluster, and start Ray there again"
        )
    return content


def fingerprint(spec: EnvSpec) -> str:
    """Return a name with a hash of what an environment does."""
    return kernel_name(spec, kernel_source(spec), ())
