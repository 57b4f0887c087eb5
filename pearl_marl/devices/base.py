"""What every device is: an array of actions in, arrays of results out.

::

    Device(...)  --open(spec, n_envs, ...)-->  open  --reset(seed)-->  ready  --step(actions)-->  ...

:class:`Device` does what all devices share (order of calls, checks, seeds, saved states, ``send``
and ``recv``); a subclass moves the slots.
"""

from __future__ import annotations

import operator
import os
import secrets
from abc import ABC, abstractmethod
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace
from typing import Any, Self

import numpy as np
import numpy.typing as npt

from pearl_marl import rng
from pearl_marl.batch import slot_memory
from pearl_marl.batch.actions import encode
from pearl_marl.batch.config import BatchConfig
from pearl_marl.batch.saved_state import SavedState
from pearl_marl.batch.step import Array, BatchStep
from pearl_marl.errors import ArgumentError, OrderError
from pearl_marl.spec import EnvSpec


class Device(ABC):
    """A place where slots are stepped. Usable on its own, or given to an environment as ``device=``.

    One object serves one batch: :meth:`open` it once, :meth:`close` it at the end. It is not to be
    used from two threads at the same time.
    """

    name: str
    """As users write it, for example ``"native"``."""

    config: BatchConfig
    _closed = False
    _ready = False

    def open(self, config: BatchConfig, rewards: npt.ArrayLike | None = None) -> Self:
        """Take up a batch of slots.

        Parameters
        ----------
        config
            What to step.
        rewards
            Replaces the environment's reward table: see :meth:`set_rewards`.

        Raises
        ------
        OrderError
            This device has been opened before.
        DeviceError
            The device is not available.
        """
        if self._closed or hasattr(self, "config"):
            raise OrderError(f"this {self.name} device has been opened before; make another one")
        self._made_with = dict(self.__dict__)
        table = _reward_table(config.spec, config.spec.rewards if rewards is None else rewards)
        self._open(config)
        self.config = config
        self._table = table
        self._seed = (0, 0)
        self._tick = 0
        self._actions = np.empty(config.n_envs, config.spec.action.dtype)
        self._worker: ThreadPoolExecutor | None = None
        self._worker_pid = 0
        self._pending: Future[BatchStep] | None = None
        return self

    def reset(self, seed: int | None = None, mask: npt.ArrayLike | None = None) -> Array:
        """Begin new episodes and return every slot's observation.

        Parameters
        ----------
        seed
            A non-negative integer of any size. ``None`` goes on with the random numbers in use, or
            takes fresh ones from the operating system at the first reset.
        mask
            ``bool`` of shape ``(n,)``: the slots to reset, ``None`` for all. A slot that has not
            stepped since its episode began keeps its initial state.

        Raises
        ------
        ArgumentError
            The seed or the mask is not one.
        OrderError
            A mask at the first reset, or the device is closed or busy.
        """
        self._check_idle("reset")
        chosen: Array | None = None
        if mask is not None:
            chosen = np.asarray(mask)
            if chosen.shape != (self.config.n_envs,) or chosen.dtype != np.bool_:
                raise ArgumentError(
                    f"a reset mask is bool of shape ({self.config.n_envs},), "
                    f"not {chosen.dtype} of shape {chosen.shape}"
                )
            if seed is not None:
                raise ArgumentError("a seed restarts every slot, so it cannot come with a reset mask")
            if not self._ready:
                raise OrderError("the first reset starts every slot: call reset() without a mask first")
        before = self._seed, self._tick, self._ready
        if seed is not None:
            self._seed, self._tick = rng.seed_words(_checked_seed(seed)), 0
        elif not self._ready:
            self._seed = rng.seed_words(secrets.randbits(64))
        elif chosen is None:
            self._tick += 1  # or every reset would begin the same episodes
        self._ready = True
        try:
            return self._reset(chosen)
        except BaseException:
            self._seed, self._tick, self._ready = before
            raise

    def step(self, actions: npt.ArrayLike) -> BatchStep:
        """Step every slot once.

        Parameters
        ----------
        actions
            Of shape ``(n, *action_space.shape)``, each in the action space.

        Raises
        ------
        ActionError
            Names the first agent whose action is not in the action space. No slot has stepped.
        OrderError
            Before the first reset, after ``close``, or between ``send`` and ``recv``.
        """
        if not self._ready or self._pending is not None:
            self._check_idle("step", ready=True)
        return self.step_words(encode(actions, self.config.spec, self._actions, self.config.first_slot))

    def step_words(self, words: Array) -> BatchStep:
        """Step every slot once by its action's word, shape ``(n,)`` in ``spec.action.dtype``; unchecked."""
        result = self._step(words)
        self._tick += 1
        return result

    def send(self, actions: npt.ArrayLike) -> None:
        """Start a step and return at once; :meth:`recv` has its results. Raises as :meth:`step` does."""
        self._check_idle("send", ready=True)
        encoded = encode(actions, self.config.spec, self._actions, self.config.first_slot)
        if encoded is not self._actions:
            self._actions[:] = encoded  # the caller may change his before the step is done
        if self._worker is None or self._worker_pid != os.getpid():  # threads do not survive a fork
            self._worker_pid = os.getpid()
            self._worker = ThreadPoolExecutor(1, thread_name_prefix=f"pearl-{self.name}")
        self._pending = self._worker.submit(self._step, self._actions)

    def recv(self) -> BatchStep:
        """Wait for the step that :meth:`send` started and return its results."""
        if getattr(self, "_pending", None) is None:
            raise OrderError("recv() without a step under way: call send() first")
        assert self._pending is not None
        pending = self._pending
        try:
            result = pending.result()
        finally:
            if pending.done():  # or Ctrl-C came first, and the step is still under way
                self._pending = None
        self._tick += 1
        return result

    def set_rewards(self, table: npt.ArrayLike) -> None:
        """Replace the reward table, from the next step on.

        Parameters
        ----------
        table
            Finite numbers, as many as the environment has reward categories.
        """
        self._check_idle("set_rewards")
        self._table = _reward_table(self.config.spec, table)

    @property
    def rewards(self) -> Array:
        """The reward table in use, ``float32``; empty where rewards are not categories."""
        self._check_idle("rewards")
        return self._table[: len(self.config.spec.rewards or ())].copy()

    @property
    def ready(self) -> bool:
        """Whether the slots have been reset, and not closed, so that they can step."""
        return self._ready and not self._closed

    def state(self) -> Array:
        """Return every slot's state, shape ``(n, fields)``: what the next step starts from.

        Integers in the narrowest dtype that holds all fields, or ``float64`` values where a field
        has a fraction.
        """
        self._check_idle("state", ready=True)
        return slot_memory.state_values(self.config.spec, self.config.n_envs, self._read()[0])

    def snapshot(self) -> SavedState:
        """Return all that the continuation depends on; :meth:`restore` of any device takes it."""
        self._check_idle("snapshot", ready=True)
        memory, stored = self._read()
        return self._saved(memory.copy(), stored.copy())

    def restore(self, saved: SavedState) -> Array:
        """Continue from a snapshot of a batch like this one; return every slot's observation.

        Raises
        ------
        SavedStateError
            Names what differs between the two batches. Nothing has changed.
        """
        self._check_idle("restore")
        saved.check(self.config.identity())
        before = self._seed, self._tick, self._table, self._ready
        self._seed, self._tick = saved.seed, saved.tick
        self._table = padded_rewards(self.config.spec, saved.rewards)
        self._ready = True
        try:
            return self._write(saved.memory, saved.stored)
        except BaseException:
            self._seed, self._tick, self._table, self._ready = before
            raise

    def recover(self) -> None:
        """Go on from the last call that succeeded, after one that raised DeviceError.

        The connection is made anew, and the state and every call since are as they were; the call that
        failed may be made again. A device that cannot fail under way has nothing to do.

        Raises
        ------
        DeviceError
            The device is still not available; call again when it is.
        """
        self._check_idle("recover")

    def set_max_cycles(self, max_cycles: int | None) -> None:
        """Replace the time limit, from the next step on; see :class:`BatchConfig`.

        Steps are counted only while there is a limit: where there was none, every episode counts
        from now.
        """
        self._check_idle("set_max_cycles")
        config = replace(self.config, max_cycles=max_cycles)
        if self._ready and not (self.config.limit and config.limit):
            memory, stored = self._read()
            memory = memory.copy()
            slot_memory.views(config.spec, config.n_envs, memory)["elapsed"][:] = 0
            self._write(memory, stored)
        self.config = config

    def close(self) -> None:
        """Release what the device holds. Safe to call twice."""
        if self._closed:
            return
        self._closed, self._ready = True, False
        if hasattr(self, "config"):
            if self._worker is not None:
                self._worker.shutdown(wait=True)
            self._close()

    def _saved(self, memory: Array, stored: Array) -> SavedState:
        """Return slots' memory and stored initial states as a state saved now."""
        return SavedState(
            identity=self.config.identity(),
            seed=self._seed,
            tick=self._tick,
            rewards=tuple(self.rewards.tolist()),
            memory=memory,
            stored=stored,
            live=memory[:0],
        )

    def _check_idle(self, call: str, ready: bool = False) -> None:
        if self._closed:
            raise OrderError(f"{call}() after close(): make a new environment")
        if not hasattr(self, "config"):
            raise OrderError(f"{call}() before open(): this {self.name} device has no batch yet")
        if ready and not self._ready:
            raise OrderError(f"{call}() before reset(): call reset() first")
        if self._pending is not None:
            raise OrderError(f"{call}() between send() and recv(): call recv() first")

    def __getstate__(self) -> dict[str, Any]:
        # A copy is a device of its own that goes on from here: threads, buffers and compiled code stay.
        if not hasattr(self, "config"):
            return {"settings": self.__dict__}
        saved = self.snapshot() if self._ready else None
        settings = {name: _unopened(value) for name, value in self._made_with.items()}
        return {"settings": settings, "config": self.config, "rewards": self._table, "saved": saved}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state["settings"])
        if "config" in state:
            config = state["config"]
            categories = config.spec.rewards
            self.open(config, None if categories is None else state["rewards"][: len(categories)])
            if state["saved"] is not None:
                self.restore(state["saved"])

    @abstractmethod
    def _open(self, config: BatchConfig) -> None:
        """Get ready to step the slots of ``config``, or raise DeviceError."""

    @abstractmethod
    def _reset(self, mask: Array | None) -> Array:
        """Start the masked slots (all, if ``None``) at ``self._tick``; return all observations."""

    @abstractmethod
    def _step(self, actions: Array) -> BatchStep:
        """Step every slot at ``self._tick``; ``actions`` are checked and in the device's width."""

    @abstractmethod
    def _read(self) -> tuple[Array, Array]:
        """Return the slots' memory and the stored initial states (empty if random), as bytes."""

    @abstractmethod
    def _write(self, memory: Array, stored: Array) -> Array:
        """Replace both; return all observations."""

    @abstractmethod
    def _close(self) -> None:
        """Release everything; called once."""


def _unopened(setting: Any) -> Any:
    """Return a setting of a device as it was when that was made: other devices in it without a batch."""
    if isinstance(setting, list):
        return [_unopened(value) for value in setting]
    if not isinstance(setting, Device) or not hasattr(setting, "config"):
        return setting
    fresh = object.__new__(type(setting))
    fresh.__dict__.update({name: _unopened(value) for name, value in setting._made_with.items()})
    return fresh


def _checked_seed(seed: Any) -> int:
    try:
        value = operator.index(seed)
    except TypeError:
        raise ArgumentError(f"seed is {seed!r}; it must be a non-negative integer or None") from None
    if value < 0 or isinstance(seed, bool):
        raise ArgumentError(f"seed is {seed!r}; it must be a non-negative integer or None")
    return value


def _reward_table(spec: EnvSpec, table: npt.ArrayLike | None) -> npt.NDArray[np.float32]:
    if spec.rewards is None:
        if table is not None:
            raise ArgumentError(f"{spec.name} computes its rewards; it has no table to replace")
        return np.empty(0, np.float32)
    try:
        with np.errstate(over="ignore"):  # infinite then, and refused below
            array = np.array(table, np.float32)
            numbers = np.asarray(table).dtype.kind in "iuf"
    except (TypeError, ValueError, OverflowError):
        numbers = False
    if not numbers:
        raise ArgumentError(f"rewards are {table!r}; {spec.name} takes {len(spec.rewards)} numbers") from None
    if array.shape != (len(spec.rewards),):
        raise ArgumentError(
            f"a reward table of shape {array.shape}; {spec.name} has {len(spec.rewards)} categories, "
            f"by default {spec.rewards}"
        )
    if not np.isfinite(array).all():
        raise ArgumentError(f"rewards are {array.tolist()}; each must be a finite float32")
    return padded_rewards(spec, array)


def padded_rewards(spec: EnvSpec, table: npt.ArrayLike) -> npt.NDArray[np.float32]:
    """Return a table with an entry for every word of the reward field, as the kernels need it.

    Words that mean nothing are worth NaN. Empty where rewards are computed.
    """
    if spec.rewards is None:
        return np.empty(0, np.float32)
    padded = np.full(1 << spec.reward.bits, np.nan, np.float32)
    padded[: len(spec.rewards)] = table
    return padded
