"""The host's half of the protocol: whatever stands behind a Comm-BRAM becomes a device.

::

    actions -> codec -> [reset mask | actions | doorbell] --one write-->  hardware
    results <- codec <- [observations | rewards | ters | status] <--one read--

The hardware is lazy where :class:`~pearl_marl.devices.native.Native` is eager: it begins a slot's
next episode within the next step, because only then it knows the action. So what a device shows of
that beginning, first observations and the states of a snapshot, is computed here, by the same
kernel as the native device's, from the seed and the tick.
"""

from __future__ import annotations

import itertools
import mmap
import time
from abc import abstractmethod

import numpy as np
import numpy.typing as npt
from gymnasium.vector import AutoresetMode

from pearl_marl import rng
from pearl_marl.batch.config import BatchConfig
from pearl_marl.batch.results import ResultArrays
from pearl_marl.batch.slot_memory import SlotMemory
from pearl_marl.batch.step import Array, BatchStep, Seen
from pearl_marl.compiler.kernels import compile_kernels
from pearl_marl.devices.base import Device
from pearl_marl.devices.identity import check_identity
from pearl_marl.devices.transport import STAGES, Exchange, Transport, word
from pearl_marl.errors import DeviceError
from pearl_marl.hardware.build import Build
from pearl_marl.hardware.codec import Stream, pack, pack_region, stream_bytes, unpack, unpack_region
from pearl_marl.memory_map import (
    ELAPSED_BITS,
    Control,
    Doorbell,
    MemoryMap,
    Mode,
    Status,
    StatusError,
    ter_bits,
)
from pearl_marl.spec import EnvSpec, Field, word_bits

_ELAPSED = Field("elapsed", ELAPSED_BITS)
_UNSET = (0, 0, -1, 0, 0)  # settings with a tick that there is none of


class CommBram(Device):
    """A device behind a Comm-BRAM; a subclass connects to it.

    After a failed step the device's state is unknown, so it refuses to go on until it is reset, given a
    saved state, or recovered. ``cycles`` are those from doorbell to last result.
    """

    _cycles = 0

    patience = 10.0
    """Seconds to wait at a reset for a step that was left under way, before the hardware is reset."""

    _sequence: int
    # What the hardware's settings are: seed, tick, first slot, time limit.
    _held: tuple[int, int, int, int, int]

    @abstractmethod
    def _connect(self, config: BatchConfig) -> tuple[Transport, MemoryMap]:
        """Return the transport to the hardware, and the memory map that it has to have."""

    def _open(self, config: BatchConfig) -> None:
        spec, n = config.spec, config.n_envs
        self._transport, self._layout = self._connect(config)
        try:
            self._synchronise(spec)
        except BaseException:
            self._transport.close()
            raise
        self._kernels = compile_kernels(spec)
        self._results = ResultArrays(config)
        self._next_step = config.autoreset_mode is AutoresetMode.NEXT_STEP
        self._repeats = config.initial_states == "stored"
        self._mode = Mode(0)
        if self._next_step:
            self._mode |= Mode.NEXT_STEP
        if self._repeats:
            self._mode |= Mode.STORED
        # Where each slot starts, if those starts are stored; the kernels get it in any case.
        self._stored = SlotMemory(spec, n)
        # What the next step has to start afresh.
        self._resets_all = False
        self._mask = np.zeros(n, np.bool_)
        self._make_buffers(spec, n)
        # After the last step, as the column of that name in the slots' memory.
        self._ended: Array = np.zeros(n, self._ters.dtype)

    def _make_buffers(self, spec: EnvSpec, n: int) -> None:
        layout = self._layout
        self._write_base, self._actions_base = layout["reset_mask"].offset, layout["actions"].offset
        self._read_base, length = layout.step_read
        # The codec works on whole 64-bit words, which may reach over the end of a region.
        self._written = _pages(layout.end("doorbell") - self._write_base + 8)
        self._answer = _pages(length + 8)

        def stream(buffer: Stream, base: int, name: str) -> Stream:
            region = layout[name]
            start = region.offset - base
            return buffer[start : start + stream_bytes(n, region.slot_bits)]

        self._mask_stream = stream(self._written, self._write_base, "reset_mask")
        self._action_stream = stream(self._written, self._write_base, "actions")
        self._obs_stream = stream(self._answer, self._read_base, "observations")
        self._reward_stream = stream(self._answer, self._read_base, "rewards")
        self._ter_stream = stream(self._answer, self._read_base, "ters")
        doorbell = layout["doorbell"].offset - self._write_base
        self._doorbell = self._written[doorbell : doorbell + 4 * len(Doorbell)].view("<u4")
        self._exchange = Exchange(self._read_base, self._answer[:-8], layout["status"].offset)
        agents = n * spec.agents
        self._obs_words = [np.empty(agents, f.dtype) for f in spec.seen]
        self._reward_words = np.empty(agents, spec.reward.dtype)
        self._ter = Field("ter", ter_bits(spec))
        self._ters = np.empty(n, self._ter.dtype)

    @property
    def cycles(self) -> int:
        """Clock cycles that the last step took, from doorbell to last result."""
        return self._cycles

    def timed(self) -> dict[str, float]:
        """Time every stage of every step from now on: see :meth:`Device.timed`.

        ``"compute"`` lies between the end of the write and the beginning of the read that had the results.
        """
        seconds = super().timed()
        self._transport.timed = True
        return seconds

    def _stages(self, began: float, ended: float) -> dict[str, float]:
        edges = itertools.pairwise((began, *self._transport.times, ended))
        return {stage: end - begin for stage, (begin, end) in zip(STAGES, edges, strict=True)}

    def _reset(self, mask: Array | None, seed: int | None) -> Seen:
        if mask is not None:
            before = self._mask.copy()
            self._mask |= mask
            try:
                return self._slots()[1]
            except BaseException:
                self._mask = before
                raise
        self._synchronise(self.config.spec)
        try:
            self._resets_all = True
            self._mask[:] = False
            if self._repeats:
                every = np.ones(self.config.n_envs, np.bool_)
                self._start(self._stored, every, self._results.take(), use_stored=False)
                self._write_region("initial_states", self.config.spec.state, self._stored.state)
            return self._slots()[1]
        except BaseException:
            self.known = False
            raise

    def _step(self, actions: Array) -> BatchStep:
        self.check_known()
        self._write_settings()
        mode, base = self._mode, self._actions_base
        if self._resets_all:
            mode |= Mode.RESET_ALL
            self._ended[:] = 0
        elif self._mask.any():
            mode |= Mode.RESET_MASK
            self._ended[self._mask] = 0
            base = self._write_base
            pack(self._mask.view(np.uint8), 1, self._mask_stream, 1)
        self._pack(actions)
        self._do_step(base, mode)
        results = self._unpack()
        if self._resets_all or mode & Mode.RESET_MASK:
            self._resets_all = False
            self._mask[:] = False
        return results

    def _pack(self, actions: Array) -> None:
        """Bring actions to what is written, each agent's fields side by side."""
        fields = self.config.spec.action_fields
        offset, stride = 0, word_bits(fields)
        for k, field in enumerate(fields):
            words = actions if len(fields) == 1 else np.ascontiguousarray(actions[:, k])
            pack(words, field.bits, self._action_stream, stride, offset)
            offset += field.bits

    def _do_step(self, base: int, mode: Mode) -> None:
        """Ring the doorbell with what is packed, and come back with the results of that step, or not."""
        sequence = (self._sequence + 1) & 0xFFFFFFFF
        self._doorbell[Doorbell.MODE] = mode
        self._doorbell[Doorbell.SEQUENCE] = sequence
        self.known = False
        step = self._exchange
        step.write_at, step.data, step.sequence = base, self._written[base - self._write_base : -8], sequence
        self._transport.exchange(step)
        error = step.error
        if step.finished != sequence and not error & StatusError.RESET:
            raise DeviceError(
                f"the {self.name} device's results are stale: they belong to step {step.finished}, "
                f"not to {sequence}; {self.way_on}"
            )
        if error:
            raise DeviceError(
                f"the {self.name} device reports {error.name or hex(error)}: {_reason(error)}; {self.way_on}"
            )
        self.known = True
        self._sequence = sequence
        self._held = self._settings(rng.following(self.tick))
        self._cycles = int(step.status[Status.CYCLES])

    def _unpack(self) -> BatchStep:
        config, results = self.config, self._results.take()
        spec, n = config.spec, config.n_envs
        offset, stride = 0, word_bits(spec.seen)
        for field, words in zip(spec.seen, self._obs_words, strict=True):
            unpack(self._obs_stream, field.bits, words, stride, offset)
            offset += field.bits
        unpack(self._reward_stream, spec.reward.bits, self._reward_words, spec.reward.bits)
        unpack(self._ter_stream, self._ter.bits, self._ters, self._ter.bits)
        # What agents that ended before do not get is the host's affair.
        ended: tuple[Array, ...] = ()
        if spec.agents > 1:
            ended = (np.where(self._ended & 1, 0, self._ended).astype(self._ended.dtype),)
        # The episode that begins in the hardware's next step begins here in this one.
        self._kernels.results(
            tuple(self._obs_words), self._reward_words, (self._ters, *ended), self._stored.bytes,
            self.reward_table, tuple(results.arrays), *self.seed, rng.signed(rng.following(self.tick)),
            config.first_slot, self._next_step, self._repeats, n, 0, n,
        )  # fmt: skip
        if self._next_step:
            results.rewards.reshape(n, -1)[self._ended & 1 != 0] = 0
        if self._next_step or spec.agents > 1:
            self._ended = self._ended_after(self._ters)
        return results

    def _over(self, ters: Array) -> npt.NDArray[np.bool_]:
        """Return which slots have ended, by the hardware's bits: by the time limit, or as all agents have."""
        # An only agent's two bits are more than 0 in either case.
        over: npt.NDArray[np.bool_] = ters >= (1 << self.config.spec.agents) - 1
        return over

    def _ended_after(self, ters: Array) -> Array:
        """Return the column ``ended`` of slots with such bits."""
        over = self._over(ters)
        if self.config.spec.agents == 1:
            return (over & self._next_step).view(np.uint8)
        ended: Array = ters << 1
        ended[over] = self._next_step
        return ended

    def _ters_of(self, ended: Array) -> Array:
        """Return such bits of slots with this column: the inverse."""
        ters = ended >> 1
        ters[ended & 1 != 0] = (1 << self.config.spec.agents) - 1
        return ters

    def _start(self, memory: SlotMemory, mask: Array, results: BatchStep, *, use_stored: bool) -> None:
        """Begin an episode in the masked slots of ``memory``; observe all of its slots."""
        config = self.config
        n, flags = config.n_envs, mask.view(np.uint8)
        memory.elapsed[mask] = 0
        self._kernels.reset(
            memory.bytes, self._stored.bytes, flags, (results.obs, *results.arrays[5:]), *self.seed,
            rng.signed(self.tick), config.first_slot, use_stored, n, 0, n,
        )  # fmt: skip

    def _slots(self) -> tuple[Array, Seen]:
        """Return the slots' memory as the native device would have it now, and what agents see."""
        self.check_known()
        spec, n = self.config.spec, self.config.n_envs
        memory = SlotMemory(spec, n)
        starting = np.ones(n, np.bool_)
        if not self._resets_all:
            ters = np.empty(n, self._ter.dtype)
            self._read_region("current_states", (*spec.state, self._ter), [*memory.state, ters])
            self._read_region("elapsed", (_ELAPSED,), [memory.elapsed])
            if not self.config.limit:
                memory.elapsed[:] = 0
            starting = self._mask if self._next_step else self._mask | self._over(ters)
            memory.ended[:] = self._ended_after(ters)
        results = self._results.take()
        self._start(memory, starting, results, use_stored=self._repeats)
        return memory.bytes, results.seen

    def _read(self) -> tuple[Array, Array]:
        stored = self._stored.bytes
        return self._slots()[0], stored if self._repeats else stored[:0]

    def _write(self, memory: Array, stored: Array) -> Seen:
        spec, slots = self.config.spec, SlotMemory(self.config.spec, self.config.n_envs, memory)
        self._synchronise(spec)
        try:
            if stored.size:
                self._stored.bytes[:] = stored
                self._write_region("initial_states", spec.state, self._stored.state)
            ters = self._ters_of(slots.ended)
            self._write_region("current_states", (*spec.state, self._ter), [*slots.state, ters])
            self._write_region("elapsed", (_ELAPSED,), [slots.elapsed])
            self._resets_all = False
            self._mask[:] = False
            self._ended = slots.ended.copy()
            return self._slots()[1]
        except BaseException:
            self.known = False
            raise

    def _write_region(self, name: str, fields: tuple[Field, ...], columns: list[Array]) -> None:
        region = self._layout[name]
        self._transport.write(region.offset, pack_region(self._layout, region, fields, columns))

    def _read_region(self, name: str, fields: tuple[Field, ...], columns: list[Array]) -> None:
        region, data = self._layout[name], np.empty(self._layout.size(name), np.uint8)
        self._transport.read(region.offset, data)
        unpack_region(self._layout, region, data, fields, columns)

    def _write_settings(self) -> None:
        """Bring seed, tick, first slot and time limit to the hardware where it has others."""
        wanted = self._settings(self.tick)
        if wanted == self._held:
            return
        seed_0, seed_1, tick, first_slot, limit = wanted
        # From SEED_0 to MAX_CYCLES, as the control region has them.
        words = np.array([seed_0, seed_1, tick & 0xFFFFFFFF, tick >> 32, first_slot, limit], "<u4")
        self._held = _UNSET  # should the write fail half way
        self._transport.write(4 * Control.SEED_0, words.view(np.uint8))
        self._held = wanted

    def _settings(self, tick: int) -> tuple[int, int, int, int, int]:
        return (*self.seed, tick, self.config.first_slot, self.config.limit)

    def _synchronise(self, spec: EnvSpec) -> None:
        """Make sure that the hardware is there and idle, and take up its sequence number.

        Who calls this writes the whole batch afterwards, so a step that does not end may be thrown away.
        """
        self.known = False
        self._transport.reconnect()
        check_identity(self.name, self._transport, Build(spec, self._layout))
        self._held = _UNSET
        deadline = time.monotonic() + self.patience
        while (rung := self._word("doorbell", Doorbell.SEQUENCE)) != self._word("status", Status.SEQUENCE):
            if time.monotonic() > deadline:
                self._reset_hardware(rung)
                rung = 0
                break
            time.sleep(1e-3)
        self._sequence = rung
        self.known = True

    def _reset_hardware(self, rung: int) -> None:
        """End step ``rung``, which does not end by itself: a core of one's own may be at fault."""
        self._transport.write(4 * Control.RESET, np.array([1], "<u4").view(np.uint8))
        deadline = time.monotonic() + self.patience
        while not self._word("status", Status.ERROR) & StatusError.RESET:
            if time.monotonic() > deadline:
                raise DeviceError(
                    f"the {self.name} device has been busy with step {rung} for {self.patience:g} s, and "
                    "does not answer a reset; end other programs that use it, check that its clock runs, "
                    "and try again"
                )
            time.sleep(1e-3)

    def _word(self, region: str, index: int) -> int:
        return word(self._transport, self._layout[region].offset + 4 * index)

    def _close(self) -> None:
        self._transport.close()


def _reason(error: StatusError) -> str:
    if error & StatusError.RESET:
        return "it was reset since the last call, and has lost the batch"
    if error & StatusError.TORN_READ:
        return "results were read while a step ran"
    return "something else wrote to it while a step ran"


def _pages(size: int) -> Stream:
    """Return zeroed bytes in memory pages of their own, as direct memory access likes them."""
    return np.frombuffer(mmap.mmap(-1, size, mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS), np.uint8)
