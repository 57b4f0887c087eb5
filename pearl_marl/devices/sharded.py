"""Several devices as one: each steps its share of the slots, at the same time as the others.

::

    actions --+-- slots 0 .. a-1 --> parts[0] --+--> results, a row a slot
              +-- slots a .. b-1 --> parts[1] --+
              +-- slots b .. n-1 --> parts[2] --+

Slots keep their global numbers, on which random draws depend, so results are those of one device that
has them all.
"""

from __future__ import annotations

import itertools
import os
import secrets
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor, wait
from dataclasses import replace
from typing import Self, TypeVar

import numpy as np
import numpy.typing as npt

from pearl_marl.batch import slot_memory
from pearl_marl.batch.config import BatchConfig
from pearl_marl.batch.results import ResultArrays
from pearl_marl.batch.saved_state import SavedState
from pearl_marl.batch.step import Array, BatchStep
from pearl_marl.devices.base import Device
from pearl_marl.devices.by_name import make_host_device
from pearl_marl.devices.recovery import CHECKPOINT_EVERY, Recoverable
from pearl_marl.errors import ArgumentError, DeviceError

T = TypeVar("T")


class Sharded(Recoverable):
    """Several devices that share the slots of one batch.

    Parameters
    ----------
    parts
        The devices, names or configured, in the order of the slots. They need not be of one kind. What
        is kept for :meth:`recover` is kept here, for all of them.
    sizes
        How many slots each has; ``None`` for equal shares, where the first ones may have one more.
    checkpoint_every
        Steps between two states that are kept on the host for :meth:`recover`; ``None`` keeps nothing.
    """

    _known = True

    def __init__(
        self,
        parts: Sequence[str | Device],
        sizes: Sequence[int] | None = None,
        checkpoint_every: int | None = CHECKPOINT_EVERY,
    ) -> None:
        super().__init__(checkpoint_every)
        if isinstance(parts, (str, Device)) or not len(parts):
            raise ArgumentError(f"parts is {parts!r}; it must be a list of at least one device")
        self.parts = [make_host_device(part) for part in parts]
        if len(set(map(id, self.parts))) < len(self.parts):
            raise ArgumentError("the same device is among the parts twice; each takes up one share of slots")
        if sizes is not None and (len(sizes) != len(self.parts) or min(sizes) < 1):
            raise ArgumentError(f"sizes is {sizes!r}; it must be {len(self.parts)} positive integers")
        for part in self.parts:
            if isinstance(part, Recoverable):
                part.checkpoint_every = None
        self.name = " + ".join(part.name for part in self.parts)
        self._sizes = sizes

    def open(self, config: BatchConfig, rewards: npt.ArrayLike | None = None) -> Self:
        """Take up a batch of slots, a share on each part; see :meth:`Device.open`."""
        super().open(config, rewards)
        if rewards is not None:
            self._on_all(lambda part, _: part.set_rewards(rewards))
        return self

    def reset(self, seed: int | None = None, mask: npt.ArrayLike | None = None) -> Array:
        """Begin new episodes; see :meth:`Device.reset`."""
        if seed is None and mask is None and not self._ready:
            seed = secrets.randbits(64)  # the same for all
        self._reset_seed = seed
        return super().reset(seed, mask)

    def set_rewards(self, table: npt.ArrayLike) -> None:
        """Replace every part's reward table; see :meth:`Device.set_rewards`."""
        self._check_idle("set_rewards")
        self._check_known()
        before = self._table
        Device.set_rewards(self, table)
        try:
            self._change(lambda part, _: part.set_rewards(table))
        except BaseException:
            self._table = before
            raise
        self._note("set_rewards", np.array(table))

    def set_max_cycles(self, max_cycles: int | None) -> None:
        """Replace every part's time limit; see :meth:`Device.set_max_cycles`."""
        self._check_idle("set_max_cycles")
        self._check_known()
        config = replace(self.config, max_cycles=max_cycles)
        self._change(lambda part, _: part.set_max_cycles(max_cycles))
        self.config = config
        self._note("set_max_cycles", max_cycles)

    def _open(self, config: BatchConfig) -> None:
        n, count = config.n_envs, len(self.parts)
        sizes = self._sizes or [n // count + (i < n % count) for i in range(count)]
        if sum(sizes) != n or min(sizes) < 1:
            raise ArgumentError(
                f"{n} slots do not fall to {count} parts of {', '.join(map(str, sizes))} slots; sizes= "
                "says how many each has"
            )
        edges = [0, *itertools.accumulate(int(size) for size in sizes)]
        self._slots = [slice(a, b) for a, b in itertools.pairwise(edges)]
        self._results = ResultArrays(config)
        self._pool: ThreadPoolExecutor | None = None
        self._pool_process = 0
        try:
            self._open_parts(config)
        except BaseException:
            for part in self.parts:
                if hasattr(part, "config"):
                    part.close()
            raise

    def _open_parts(self, config: BatchConfig) -> None:
        for part, slots in zip(self.parts, self._slots, strict=True):
            self._open_part(config, part, slots)

    def _open_part(self, config: BatchConfig, part: Device, slots: slice) -> None:
        first_slot, size = config.first_slot + slots.start, slots.stop - slots.start
        part.open(replace(config, n_envs=size, first_slot=first_slot, copy=False))

    def _reset(self, mask: Array | None) -> Array:
        seed = self._reset_seed
        if mask is not None or seed is None:
            self._check_known()
        return self._joined_obs(
            self._change(lambda part, slots: part.reset(seed, None if mask is None else mask[slots]))
        )

    def _step(self, actions: Array) -> BatchStep:
        self._check_known()
        done = self._change(lambda part, slots: part.step_words(actions[slots]))
        results = self._results.take()
        for slots, step in zip(self._slots, done, strict=True):
            for whole, share in zip(results, step, strict=True):
                whole[slots] = share
        return results

    def _read(self) -> tuple[Array, Array]:
        self._check_known()
        saved = self._on_all(lambda part, _: part.snapshot())
        spec, sizes = self.config.spec, [slots.stop - slots.start for slots in self._slots]
        memory = slot_memory.join(spec, [share.memory for share in saved], sizes)
        return memory, slot_memory.join(spec, [share.stored for share in saved], sizes)

    def _write(self, memory: Array, stored: Array) -> Array:
        def write(part: Device, slots: slice) -> Array:
            # It may have got a new time limit since the state that recover() goes back to.
            part.config = replace(part.config, max_cycles=self.config.max_cycles)
            return part.restore(
                SavedState(
                    identity=part.config.identity(),
                    seed=self._seed,
                    tick=self._tick,
                    rewards=rewards,
                    memory=slot_memory.cut(spec, n, memory, slots),
                    stored=slot_memory.cut(spec, n, stored, slots),
                    live=memory[:0],
                )
            )

        rewards = tuple(self.rewards.tolist())
        spec, n = self.config.spec, self.config.n_envs
        return self._joined_obs(self._change(write))

    def _close(self) -> None:
        try:
            self._on_all(lambda part, _: part.close())
        finally:
            if self._pool is not None:
                self._pool.shutdown(wait=True)

    def _change(self, call: Callable[[Device, slice], T]) -> list[T]:
        """Do what moves slots. Should it fail on one part, the others may have moved."""
        self._known = False
        results = self._on_all(call)
        self._known = True
        return results

    def _check_known(self) -> None:
        if not self._known:
            raise DeviceError(
                f"a call of {self.name} failed on some parts before; call recover(), or reset() with a seed, "
                "or load a saved state, to go on"
            )

    def _on_all(self, call: Callable[[Device, slice], T]) -> list[T]:
        """Call for all parts at the same time; return when all are done."""
        if self._pool is None or self._pool_process != os.getpid():  # threads do not survive a fork
            self._pool_process = os.getpid()
            self._pool = ThreadPoolExecutor(len(self.parts), thread_name_prefix="pearl-sharded")
        tasks = [
            self._pool.submit(call, part, slots) for part, slots in zip(self.parts, self._slots, strict=True)
        ]
        try:
            wait(tasks)
        except BaseException:  # Ctrl-C, and nobody may find a part at work
            wait(tasks)
            raise
        return [task.result() for task in tasks]

    def _joined_obs(self, shares: list[Array]) -> Array:
        obs = self._results.take().obs
        for slots, share in zip(self._slots, shares, strict=True):
            obs[slots] = share
        return obs
