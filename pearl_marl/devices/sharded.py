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
from collections.abc import Callable, Sequence
from concurrent.futures import wait
from dataclasses import replace
from typing import TypeVar

import numpy as np
import numpy.typing as npt

from pearl_marl.base.arrays import Array
from pearl_marl.batch.config import BatchConfig
from pearl_marl.batch.results import ResultArrays
from pearl_marl.batch.rollout import Rollout
from pearl_marl.batch.saved_state import SavedState
from pearl_marl.batch.step import BatchStep, Observed
from pearl_marl.checks import checked_count_or_none
from pearl_marl.devices.base import Device, Phase
from pearl_marl.devices.by_name import make_distinct
from pearl_marl.devices.recovery import CHECKPOINT_EVERY, CheckpointLog
from pearl_marl.devices.threads import Threads
from pearl_marl.errors import ArgumentError, DeviceError
from pearl_marl.policies.device_policy import DevicePolicy

T = TypeVar("T")


class Sharded(Device):
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

    recovery_type = CheckpointLog

    part_checkpoint_every: int | None = None
    """The same of each part, for what that keeps itself."""

    def __init__(
        self,
        parts: Sequence[str | Device],
        sizes: Sequence[int] | None = None,
        checkpoint_every: int | None = CHECKPOINT_EVERY,
    ) -> None:
        self.checkpoint_every = checked_count_or_none("checkpoint_every", checkpoint_every)
        self.parts = make_distinct("parts", parts, "each takes up one share of slots")
        if sizes is not None and not _are_sizes(sizes, len(self.parts)):
            raise ArgumentError(f"sizes is {sizes!r}; it must be {len(self.parts)} positive integers")
        self.name = " + ".join(part.name for part in self.parts)
        self._sizes = None if sizes is None else [int(size) for size in sizes]

    @property
    def remedy(self) -> str:
        """See :class:`Device`; with a seed, as the parts may not agree on where they are."""
        return "call recover(), or reset() with a seed, or load a saved state, to go on"

    def check_not_failed(self) -> None:
        """Refuse to go on where a call has failed on some parts."""
        if self.phase is Phase.FAILED:
            raise DeviceError(f"a call of {self.name} failed on some parts before; {self.remedy}")

    def on_all(self, call: Callable[[Device, slice], T]) -> list[T]:
        """Call for all parts at the same time, each with its slots; return when all are done."""
        tasks = [
            self._threads.submit(call, part, slots)
            for part, slots in zip(self.parts, self._slots, strict=True)
        ]
        try:
            wait(tasks)
        except BaseException:  # Ctrl-C, and no part may be left at work
            wait(tasks)
            raise
        return [task.result() for task in tasks]

    def _open(self, config: BatchConfig) -> None:
        n, count = config.n_envs, len(self.parts)
        sizes = self._sizes or [n // count + (i < n % count) for i in range(count)]
        if sum(sizes) != n or min(sizes) < 1:
            raise ArgumentError(
                f"{n} slots do not fall to {count} parts of {', '.join(map(str, sizes))} slots; sizes= "
                "says how many each has"
            )
        edges = [0, *itertools.accumulate(sizes)]
        self._slots = [slice(a, b) for a, b in itertools.pairwise(edges)]
        self._results = ResultArrays(config)
        self._threads = Threads(count, "pearl-sharded")
        try:
            self._open_parts(config)
        except BaseException:
            for part in self.parts:
                if part.phase is not Phase.NEW:
                    part.close()
            raise

    def _open_parts(self, config: BatchConfig) -> None:
        for part, slots in zip(self.parts, self._slots, strict=True):
            self.open_part(config, part, slots)

    def open_part(self, config: BatchConfig, part: Device, slots: slice) -> None:
        """Open one part for its slots of the batch."""
        part.checkpoint_every = self.part_checkpoint_every
        first_slot, size = config.first_slot + slots.start, slots.stop - slots.start
        part.open(replace(config, n_envs=size, first_slot=first_slot, copy=False))

    def _reset(self, mask: Array | None, seed: int | None) -> Observed:
        if seed is None:
            self.check_not_failed()
        return self._restart(lambda part, slots: part.reset(seed, None if mask is None else mask[slots]))

    def _step(self, actions: Array) -> BatchStep:
        done = self.on_all(lambda part, slots: part.step_words(actions[self.rows(slots)]))
        results = self._results.take()
        for slots, step in zip(self._slots, done, strict=True):
            for whole, share in zip(results.arrays, step.arrays, strict=True):
                whole[self.rows(slots)] = share
        return results

    def _may_have_moved(self) -> bool:
        return True  # those of other parts

    @property
    def has_engine(self) -> bool:  # type: ignore[override]
        """Whether all parts have a policy engine."""
        return all(part.has_engine for part in self.parts)

    def _rollout_alone(
        self, policy: DevicePolicy, steps: int, record: bool, episodes: int | None
    ) -> Rollout | None:
        if not self.has_engine or record or episodes is not None:
            return None
        for part in self.parts:  # before any has moved
            part.check_engine(policy, steps)
        try:
            shares = self.on_all(lambda part, _: part.rollout(policy, steps))
        except BaseException:
            if any(part.phase is Phase.FAILED or part.tick != self.tick for part in self.parts):
                self.fail()
            raise
        self.tick = self.parts[0].tick
        _, self.action_masks, self.in_episode = self._gathered()
        return Rollout.total(shares)

    def rows(self, slots: slice) -> slice:
        """Return the rows that the agents of some slots have."""
        agents = self.config.spec.agents
        return slice(slots.start * agents, slots.stop * agents)

    def _read(self) -> tuple[Array, Array]:
        saved = SavedState.join(self.config.spec, self.on_all(lambda part, _: part.snapshot()))
        return saved.memory, saved.stored

    def _write(self, memory: Array, stored: Array) -> Observed:
        saved, spec = self.saved(memory, stored), self.config.spec

        def write(part: Device, slots: slice) -> Array:
            # It may have got a new time limit since the state that recover() goes back to.
            part.config = replace(part.config, max_cycles=self.config.max_cycles)
            return part.restore(saved.cut(spec, slots))

        return self._restart(write)

    def _apply_rewards(self, table: npt.ArrayLike) -> None:
        self.check_not_failed()
        self._change(lambda part, _: part.set_rewards(table))

    def _apply_limit(self, config: BatchConfig) -> None:
        self.check_not_failed()
        self._change(lambda part, _: part.set_max_cycles(config.max_cycles))

    def _close(self) -> None:
        try:
            self.on_all(lambda part, _: part.close())
        finally:
            self._threads.close()

    def _change(self, call: Callable[[Device, slice], T]) -> list[T]:
        """Do what moves slots. Should it fail on one part, the others may have moved."""
        try:
            return self.on_all(call)
        except BaseException:
            self.fail()
            raise

    def _restart(self, call: Callable[[Device, slice], Array]) -> Observed:
        """Reset or restore all parts; return what agents see."""
        shares = self._change(call)
        observed = self._gathered()
        for slots, share in zip(self._slots, shares, strict=True):
            observed.obs[self.rows(slots)] = share
        return observed

    def _gathered(self) -> Observed:
        """Return which agents are in an episode, and their masks, with room for what they observe."""
        results = self._results.take()
        for part, slots in zip(self.parts, self._slots, strict=True):
            rows = self.rows(slots)
            if results.action_masks is not None:
                results.action_masks[rows] = part.action_masks
            if self.config.spec.agents > 1:
                results.in_episode[rows] = part.in_episode
        return results.observed


def _are_sizes(sizes: object, count: int) -> bool:
    """Return whether these are so many positive integers."""
    if isinstance(sizes, np.ndarray):
        sizes = sizes.tolist()
    return (
        isinstance(sizes, Sequence)
        and len(sizes) == count
        and all(isinstance(size, (int, np.integer)) and size >= 1 for size in sizes)
    )
