"""The way to a Comm-BRAM and back: what moves bytes, how long a step's stages take, and the protocol."""

from __future__ import annotations

import itertools
import mmap
import time
from abc import ABC, abstractmethod
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from pearl_marl.devices.identity import check_identity
from pearl_marl.errors import DeviceError
from pearl_marl.hardware.build import Build
from pearl_marl.hardware.codec import Stream, pack, pack_region, stream_bytes, unpack, unpack_region
from pearl_marl.memory_map import Control, Doorbell, MemoryMap, Mode, Status, StatusError, ter_bits
from pearl_marl.spec import EnvSpec, Field, word_bits

STAGES = {"pack": "T1", "write": "T2", "compute": "T3-T5", "read": "T6", "unpack": "T7"}
"""The stages of a step, in their order, with the paper's names for their times."""


class Exchange:
    """A step on its way: what is written, where the answer goes, and whether that is the step's own.

    Results and status are read from byte address ``read_at`` on, the status at ``status_at``.
    """

    write_at: int
    """The byte address from which on ``data`` is written."""
    data: Stream
    sequence: int

    def __init__(self, read_at: int, answer: Stream, status_at: int) -> None:
        self.read_at, self.answer, self.status_at = read_at, answer, status_at
        start = status_at - read_at
        self.status_bytes = answer[start : start + 4 * len(Status)]
        self.status = self.status_bytes.view("<u4")

    @property
    def finished(self) -> int:
        """The sequence number of the step that the answer belongs to."""
        return int(self.status[Status.SEQUENCE])

    @property
    def error(self) -> StatusError:
        """What the hardware reports."""
        return StatusError(int(self.status[Status.ERROR]))

    @property
    def ended(self) -> bool:
        """Whether there is nothing to wait for: the status is this step's, or the hardware was reset."""
        return self.finished == self.sequence or bool(self.error & StatusError.RESET)

    @property
    def done(self) -> bool:
        """Whether none of the answer was read before the step had ended."""
        return self.ended and not self.error & StatusError.TORN_READ


class Transport(ABC):
    """Moves bytes to and from a Comm-BRAM; all of its methods raise DeviceError when they cannot."""

    timed = False
    """Whether to do a step in its stages, so that :attr:`times` are those of the last one."""

    recoverable = False
    """Whether a device is open on it, so that ``recover()`` is the way on after a failure."""

    times: tuple[float, float, float, float]
    """Begin and end of the write, then of the read that had the results, by ``time.perf_counter``."""

    @abstractmethod
    def write(self, offset: int, data: Stream) -> None:
        """Write all of ``data`` from byte address ``offset`` on."""

    @abstractmethod
    def read(self, offset: int, data: Stream) -> None:
        """Fill all of ``data`` from byte address ``offset`` on."""

    def begin(self) -> None:  # noqa: B027, as not every link keeps anything
        """Forget what is left of earlier steps, before another one is written."""

    @abstractmethod
    def wait(self, step: Exchange) -> None:
        """Return once a step has ended, or as soon as that is likely."""

    def pause(self) -> None:
        """Let some time pass while the hardware is busy with more than a step."""
        time.sleep(1e-4)

    def unfinished(self, step: Exchange, waited: float) -> bool:
        """Return whether to read again, ``waited`` seconds after the write; may pause, or raise."""
        return False

    def exchange(self, step: Exchange) -> None:
        """Do a whole step: write, wait, and read for as long as it is :meth:`unfinished`.

        Most steps have ended when they are first looked for, so all is read at once. Of one that has not,
        the status alone is read until it has, and then all once more.
        """
        self.begin()
        began = time.perf_counter()
        self.write(step.write_at, step.data)
        written = time.perf_counter()
        self.wait(step)
        while True:
            reading = time.perf_counter()
            self.read(step.read_at, step.answer)
            read = time.perf_counter()
            if not self.unfinished(step, read - written):
                break
            while not step.ended:
                self.read(step.status_at, step.status_bytes)
                if not step.ended:
                    self.unfinished(step, time.perf_counter() - written)
        self.times = began, written, reading, read

    def reconnect(self) -> None:  # noqa: B027, as not every connection can fail
        """Make the connection anew if it has failed."""

    @abstractmethod
    def close(self) -> None:
        """Release everything. Called once."""


def word(transport: Transport, offset: int) -> int:
    """Return the 32-bit word at a byte address."""
    found: Any = np.empty(4, np.uint8)
    transport.read(offset, found)
    return int(found.view("<u4")[0])


class Settings(NamedTuple):
    """What the hardware is told besides actions, and goes by until it is told otherwise."""

    seed_0: int
    seed_1: int
    tick: int
    first_slot: int
    limit: int


class Protocol:
    """The host's half of the protocol with a Comm-BRAM: settings, steps, and regions read and written.

    Attributes
    ----------
    transport, layout
        The way to the hardware, and the memory map that it has to have.
    written, answer
        What a step writes, from the reset mask to the doorbell; and what it reads. The codec works on whole
        64-bit words, so both go on for 8 bytes.
    doorbell
        The words of the doorbell in ``written``.
    observations, rewards, end_bits
        The last step's results, as words: a column a field; a word an agent; a word a slot.
    sequence, cycles
        The number of the last step that succeeded; its clock cycles, from doorbell to last result.
    settings
        What the hardware's settings are; ``None`` where that is not sure.
    policy
        The policy that the hardware has, likewise.
    """

    policy: object = None

    sequence: int
    settings: Settings | None
    cycles = 0

    def __init__(self, name: str, spec: EnvSpec, transport: Transport, layout: MemoryMap) -> None:
        self.transport, self.layout = transport, layout
        self._name, self._spec = name, spec
        n, agents = layout.n_envs, layout.n_envs * spec.agents
        write_from = layout["reset_mask"].offset
        read_from, length = layout.step_read
        self.written = _pages(layout.end("doorbell") - write_from + 8)
        self.answer = _pages(length + 8)

        def stream(buffer: Stream, base: int, name: str) -> Stream:
            region = layout[name]
            start = region.offset - base
            return buffer[start : start + stream_bytes(n, region.slot_bits)]

        doorbell = layout["doorbell"].offset - write_from
        self.doorbell = self.written[doorbell : doorbell + 4 * len(Doorbell)].view("<u4")
        self._exchange = Exchange(read_from, self.answer[:-8], layout["status"].offset)
        self._mask = stream(self.written, write_from, "reset_mask")
        self._actions = stream(self.written, write_from, "actions"), _bit_ranges(spec.action_fields)
        # What is written of them: from where on, with a reset mask and without.
        starts = write_from, layout["actions"].offset
        self._with_mask, self._without = ((start, self.written[start - write_from : -8]) for start in starts)
        self.observations = [np.empty(agents, field.dtype) for field in spec.agent_fields]
        self.rewards = np.empty(agents, spec.reward.dtype)
        self.end_field = Field("end_bits", ter_bits(spec))
        self.end_bits = np.empty(n, self.end_field.dtype)
        streams = (stream(self.answer, read_from, name) for name in ("observations", "rewards", "ters"))
        columns = (self.observations, [self.rewards], [self.end_bits])
        fields = (spec.agent_fields, (spec.reward,), (self.end_field,))
        self._results = [
            (source, bits, column, stride, offset)
            for source, words, of in zip(streams, columns, fields, strict=True)
            for column, (bits, stride, offset) in zip(words, _bit_ranges(of), strict=True)
        ]

    def step(self, mode: Mode, actions: npt.NDArray[Any], mask: npt.NDArray[np.bool_]) -> str:
        """Write actions, ring the doorbell, and unpack the results of that step.

        The reset mask is written too if ``mode`` says so. Returns what is wrong with the answer, in words;
        empty if nothing is.
        """
        step, target = self._exchange, self._without
        if mode & Mode.RESET_MASK:
            target = self._with_mask
            pack(mask.view(np.uint8), 1, self._mask, 1)
        stream, ranges = self._actions
        for k, (bits, stride, offset) in enumerate(ranges):
            words = actions if len(ranges) == 1 else np.ascontiguousarray(actions[:, k])
            pack(words, bits, stream, stride, offset)
        sequence = (self.sequence + 1) & 0xFFFFFFFF
        self.doorbell[Doorbell.MODE] = mode
        self.doorbell[Doorbell.SEQUENCE] = step.sequence = sequence
        step.write_at, step.data = target
        self.transport.exchange(step)
        error = step.error
        if step.finished != sequence and not error & StatusError.RESET:
            return f"'s results are stale: they belong to step {step.finished}, not to {sequence}"
        if error:
            return f" reports {error.name or hex(error)}: {_reason(error)}"
        for source, bits, words, stride, offset in self._results:
            unpack(source, bits, words, stride, offset)
        return ""

    def confirm(self, settings: Settings, cycles: int | None = None) -> None:
        """Take note that the step, or a rollout of ``cycles``, has succeeded.

        The hardware has counted on to ``settings`` after it.
        """
        self.sequence, self.settings = int(self.doorbell[Doorbell.SEQUENCE]), settings
        self.cycles = int(self._exchange.status[Status.CYCLES]) if cycles is None else cycles

    @property
    def unconfirmed(self) -> bool:
        """Whether a step was asked for that has not succeeded: it may have moved slots, or not."""
        return int(self.doorbell[Doorbell.SEQUENCE]) != self.sequence

    def set(self, settings: Settings) -> None:
        """Write settings where the hardware has others."""
        if settings == self.settings:
            return
        self.settings = None  # should the write fail half way
        seed_0, seed_1, tick, first_slot, limit = settings
        # From SEED_0 to MAX_CYCLES, as the control region has them.
        words = np.array([seed_0, seed_1, tick & 0xFFFFFFFF, tick >> 32, first_slot, limit], "<u4")
        self.transport.write(4 * Control.SEED_0, words.view(np.uint8))
        self.settings = settings

    def write_region(self, name: str, fields: tuple[Field, ...], columns: list[npt.NDArray[Any]]) -> None:
        """Write a column a field to every slot of a region."""
        region = self.layout[name]
        self.transport.write(region.offset, pack_region(self.layout, region, fields, columns))

    def read_region(self, name: str, fields: tuple[Field, ...], columns: list[npt.NDArray[Any]]) -> None:
        """Fill a column a field from every slot of a region."""
        region, data = self.layout[name], np.empty(self.layout.size(name), np.uint8)
        self.transport.read(region.offset, data)
        unpack_region(self.layout, region, data, fields, columns)

    def synchronise(self, patience: float) -> None:
        """Make sure that the hardware is there and idle, and take up its sequence number.

        The whole batch is to be written afterwards, so a step that does not end within ``patience`` seconds
        is thrown away: the hardware is reset. So is a rollout at once, which may take long.
        """
        self.transport.reconnect()
        check_identity(self._name, self.transport.read, Build(self._spec, self.layout))
        self.settings = self.policy = None
        deadline = time.monotonic() + patience
        while (rung := self._word("doorbell", Doorbell.SEQUENCE)) != self._word("status", Status.SEQUENCE):
            endless = self.layout.engine is not None and self._word("doorbell", Doorbell.MODE) & Mode.ROLLOUT
            if endless or time.monotonic() > deadline:
                self._reset_hardware(rung, patience)
                rung = 0
                break
            time.sleep(1e-3)
        self.sequence = self.doorbell[Doorbell.SEQUENCE] = rung

    def _reset_hardware(self, rung: int, patience: float) -> None:
        """End step ``rung``, which does not end by itself: a core of one's own may be at fault."""
        self.transport.write(4 * Control.RESET, np.array([1], "<u4").view(np.uint8))
        deadline = time.monotonic() + patience
        # A status may be from before the doorbell: what rang is forgotten, too.
        while (
            self._word("doorbell", Doorbell.SEQUENCE)
            or not self._word("status", Status.ERROR) & StatusError.RESET
        ):
            if time.monotonic() > deadline:
                raise DeviceError(
                    f"the {self._name} device has been busy with step {rung} for {patience:g} s, and "
                    "does not answer a reset; end other programs that use it, check that its clock runs, "
                    "and try again"
                )
            time.sleep(1e-3)

    def _word(self, region: str, index: int) -> int:
        return word(self.transport, self.layout[region].offset + 4 * index)


def _bit_ranges(fields: tuple[Field, ...]) -> list[tuple[int, int, int]]:
    """Return where each field lies in a stream of them side by side: its bits, the stride, its offset."""
    stride, ends = word_bits(fields), itertools.accumulate(field.bits for field in fields)
    return [(field.bits, stride, end - field.bits) for field, end in zip(fields, ends, strict=True)]


def _reason(error: StatusError) -> str:
    if error & StatusError.RESET:
        return "it was reset since the last call, and has lost the batch"
    if error & StatusError.TORN_READ:
        return "results were read while a step ran"
    return "something else wrote to it while a step ran"


def _pages(size: int) -> Stream:
    """Return zeroed bytes in memory pages of their own, as direct memory access likes them."""
    return np.frombuffer(mmap.mmap(-1, size, mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS), np.uint8)
