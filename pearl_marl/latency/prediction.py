"""How long a step takes with the hardware behind a link: the paper's latency model, with measured inputs.

::

    T1 pack -> T2 write -> T3 words in, T4 compute, T5 words out -> T6 read -> T7 unpack
    host       link        hardware                                link       host

T1 and T7 are measured on this machine, by stepping the host's half of the protocol without hardware
(:func:`measure_host`). T3 to T5 are counted: clock cycles from the memory map and the core's timing
(:func:`step_cycles`), as the simulated device takes them. T2 and T6 come from a :class:`Link`: so much
for a call, so much for a byte.

Where the paper's hardware takes T3, T4 and T5 partly one after the other (its Eq. 2 and 3, see
:class:`Loop`), this one does all three at the same time. Its form without pipeline, which the paper compares
with, is :func:`predict` with ``pipelined=False``.
"""

from __future__ import annotations

import statistics
import time
from dataclasses import asdict, dataclass
from typing import Any, NamedTuple

import numpy as np

from pearl_marl.batch.actions import random_actions
from pearl_marl.batch.config import BatchConfig
from pearl_marl.devices.comm_bram import CommBram, identity
from pearl_marl.devices.transport import Exchange, Transport
from pearl_marl.errors import ArgumentError
from pearl_marl.hardware import elaboration
from pearl_marl.hardware.codec import Stream, pack, stream_bytes
from pearl_marl.memory_map import TER_BITS, MemoryMap, Status, default_map
from pearl_marl.spec import EnvSpec, word_bits

# ---- Clock cycles of the hardware ----

_FIRST_ISSUE = 4
"""Cycles of a step in which the sequencer starts and the first action word comes out of its memory."""

_DRAW_LATENCY = 3
"""Cycles from a slot's number to its random draws (``DRAW_LATENCY`` of ``rtl/pearl_pkg.sv``)."""

_RESULTS = ("observations", "rewards", "ters")
_INPUTS = ("actions", "reset_mask")


def step_cycles(spec: EnvSpec, layout: MemoryMap, pipelined: bool = True) -> int:
    """Return the clock cycles of a step in the hardware, from doorbell to last result.

    In closed form, from what happens in ``rtl/``: groups are issued one every ``II`` cycles, and not
    before their actions have come, a word a cycle; results leave in three banks, a word a cycle each.
    Not pipelined, a group is issued when the one before has been read, computed and written: with one
    processing element the paper's Eq. 2, ``env_num * (c_r + c_c + c_w)``.
    The random draws are there in time; where a link is as short as a simulated one, see :func:`draws_wait`.

    It is what ``Rtl.cycles`` counts. Where words do not divide into rows, nor rows into words, it may be a
    few per cent too low.
    """
    timing = elaboration.core_timing(spec)
    groups, word = layout.groups, layout.data_wl
    fetch = _DRAW_LATENCY if spec.reset_draws + spec.step_draws else 1
    to_words = fetch + timing.latency + 1

    def row(name: str) -> int:
        return layout.pe_num * layout[name].slot_bits

    interval = timing.interval
    if not pipelined:
        written = max(-(-row(name) // word) for name in _RESULTS)
        interval = max(interval, fetch + timing.latency + written)

    def issued(count: int) -> int:
        """Return the cycle in which that many groups have been issued, were there room for results."""
        came = [min(-(-count * row(name) // word), layout[name].words) for name in _INPUTS]
        first = max(min(-(-row(name) // word), layout[name].words) for name in _INPUTS)
        return _FIRST_ISSUE + max(*came, first + (count - 1) * interval)

    ends = []
    for name in _RESULTS:
        words = layout[name].words
        for_first_word = min(groups, -(-word // row(name)))
        with_last_group = words - (groups - 1) * row(name) // word
        ends += [issued(for_first_word) + words, issued(groups) + with_last_group]
    return to_words + max(ends)


class Loop(NamedTuple):
    """The paper's loop times, T3 to T5 of all slots together, for one build of ours, in clock cycles.

    ``c_r`` and ``c_w`` are a slot's share of the words in and out, ``c_c`` the core's latency.
    """

    serial: float
    """Eq. 2, one unit that computes slot after slot: ``env_num * (c_r + c_c + c_w)``."""
    parallel: float
    """Eq. 3, a unit for each slot: ``env_num * (c_r + c_w) + c_c``."""
    ours: int
    """:func:`step_cycles`: reading, computing and writing overlap, and so do the three result banks."""


def loop_cycles(spec: EnvSpec, layout: MemoryMap) -> Loop:
    """Return the paper's Eq. 2 and Eq. 3 for a build, beside what this hardware takes."""
    moved = layout["actions"].words + sum(layout[name].words for name in _RESULTS)
    compute = elaboration.core_timing(spec).latency
    return Loop(moved + layout.n_envs * compute, moved + compute, step_cycles(spec, layout))


_BURST_BYTES, _BURST_BEATS = 4096, 256
"""AXI4: no burst crosses a multiple of the one, or has more beats than the other."""

_WRITE_BURST, _READ_BURST = 6, 5
"""Cycles of a burst besides its beats: its address, and until the AXI slave has answered."""

_UNTIL_RUNNING = 4
"""Cycles of a step that pass while its write is still being answered."""


def _burst_cycles(start: int, length: int, beat: int, overhead: int) -> int:
    end, cycles = start + length, 0
    while start < end:
        stop = min(end, start + _BURST_BEATS * beat, (start // _BURST_BYTES + 1) * _BURST_BYTES)
        cycles += overhead + -(-(stop - start) // beat)
        start = stop
    return cycles


def write_cycles(layout: MemoryMap) -> int:
    """Return the clock cycles in which what a step writes passes the AXI port, burst after burst."""
    return _burst_cycles(*layout.step_write, layout.data_wl // 8, _WRITE_BURST)


def read_cycles(layout: MemoryMap) -> int:
    """Return the same of what a step reads."""
    return _burst_cycles(*layout.step_read, layout.data_wl // 8, _READ_BURST)


def draws_wait(spec: EnvSpec, layout: MemoryMap) -> int:
    """Return the cycles that a step waits for its random draws, if it follows the last one at once.

    Their keys are made one after the other as soon as a step is done (``rtl/pearl_rng.sv``), while results
    are read and actions written. A link takes longer than they do; the simulated port may not.
    """
    draws = spec.reset_draws + spec.step_draws
    keys = 4 * (4 + draws) + 4 if draws else 0
    return max(0, keys - write_cycles(layout) - read_cycles(layout))


def axi_cycles(spec: EnvSpec, layout: MemoryMap, pipelined: bool = True) -> int:
    """Return the clock cycles of a whole step of ``Rtl(path="axi")``: write, step, read."""
    step = max(1, draws_wait(spec, layout) + step_cycles(spec, layout, pipelined) - _UNTIL_RUNNING)
    return write_cycles(layout) + step + read_cycles(layout)


# ---- The host ----


class HostTimes(NamedTuple):
    """What the host does of a step, in seconds."""

    pack: float
    """T1: check the actions and pack them."""
    unpack: float
    """T7: from packed results to arrays of observations, rewards and ends."""


ENDING = 100
"""One slot in so many ends its episode in a measured step; what follows an end is a part of T7."""


def measure_host(spec: EnvSpec, n_envs: int, rounds: int = 200) -> HostTimes:
    """Measure T1 and T7 on this machine, by stepping the host's code without hardware.

    They are medians of the thread's CPU time, so that other programs on the machine count less.

    Parameters
    ----------
    spec, n_envs
        What is stepped.
    rounds
        How many steps.
    """
    device = _NoHardware().open(BatchConfig(spec=spec, n_envs=n_envs, copy=False))
    answers = device.answers
    device.reset(seed=0)
    actions = random_actions(spec, np.random.default_rng(0), n_envs)
    times = []
    for _ in range(rounds + 2):  # the first ones load the code
        began = time.thread_time()
        device.step(actions)
        ended = time.thread_time()
        times.append((answers.asked - began, ended - answers.answered))
    device.close()
    packs, unpacks = zip(*times[2:], strict=True)
    return HostTimes(statistics.median(packs), statistics.median(unpacks))


class _Answers(Transport):
    """Answers every step at once: observations and rewards of zero, one slot in :data:`ENDING` at its end."""

    def __init__(self, spec: EnvSpec, layout: MemoryMap) -> None:
        self._layout = layout
        self._identity = np.array(identity(spec, layout), "<u4").view(np.uint8)
        slots = np.arange(layout.n_envs) % ENDING == 0
        self._ters = np.zeros(stream_bytes(layout.n_envs, TER_BITS), np.uint8)
        pack(slots.view(np.uint8), TER_BITS, self._ters, TER_BITS)
        self._ters = self._ters[: layout.size("ters")]
        self.asked = self.answered = 0.0

    def write(self, offset: int, data: Stream) -> None:
        """Take everything."""

    def read(self, offset: int, data: Stream) -> None:
        data[:] = 0
        if offset == self._layout["control"].offset:
            data[: self._identity.size] = self._identity[: data.size]

    def wait(self, step: Exchange) -> None:
        """Be done."""

    def exchange(self, step: Exchange) -> None:
        self.asked = time.thread_time()
        ters = self._layout["ters"].offset - step.read_at
        step.answer[ters : ters + self._ters.size] = self._ters
        step.status[Status.SEQUENCE] = step.sequence
        self.answered = time.thread_time()

    def close(self) -> None:
        """Hold nothing."""


class _NoHardware(CommBram):
    """The host's half of the protocol with nothing behind it."""

    name = "nothing"

    def _connect(self, config: BatchConfig) -> tuple[Transport, MemoryMap]:
        layout = default_map(config.spec, config.n_envs)
        self.answers = _Answers(config.spec, layout)
        return self.answers, layout


# ---- The link ----


@dataclass(frozen=True, slots=True)
class Link:
    """What lies between host and hardware.

    Parameters
    ----------
    name
        As ``pearl plan --link`` takes it.
    call
        Seconds that a transfer takes besides those for its bytes.
    write_rate, read_rate
        Bytes per second to the hardware and from it.
    source
        Where the figures are from.
    """

    name: str
    call: float
    write_rate: float
    read_rate: float
    source: str

    def __post_init__(self) -> None:
        for what in ("call", "write_rate", "read_rate"):
            value = getattr(self, what)
            if not value >= 0 or (what != "call" and value == 0):
                raise ArgumentError(f"{what} of the link {self.name!r} is {value}; it must be positive")


_DRIVER = "https://github.com/Xilinx/dma_ip_drivers/issues"
_CALL = 30e-6

LINKS = {
    link.name: link
    for link in (
        Link(
            "gen2x4",
            _CALL,
            1.6e9,
            1.3e9,
            "reported: a K7-325T at 1.6 and 1.3 GB/s (https://github.com/Prandr/dma_ip_drivers/issues/6), "
            f"30 us a call ({_DRIVER}/321)",
        ),
        Link("gen2x8", _CALL, 3.2e9, 2.6e9, "the paper's link: gen2x4 with twice the lanes, 30 us a call"),
        Link(
            "gen3x16",
            _CALL,
            5e9,
            5e9,
            f"reported: 5 to 6 GB/s through the stock driver ({_DRIVER}/293), 30 us a call ({_DRIVER}/321)",
        ),
    )
}
"""Links by name. The figures are of the Xilinx XDMA driver, as its users report them; measure your own."""


# ---- All together ----


@dataclass(frozen=True, slots=True)
class Prediction:
    """The stages of a step, in seconds, named after the paper's times.

    T3, T4 and T5 overlap: :attr:`device` is what they take together. Where they do not, it is their sum
    and what lies between them.
    """

    n_envs: int
    pe_num: int
    data_wl: int
    pack: float
    write: float
    words_in: float
    compute: float
    words_out: float
    device: float
    read: float
    unpack: float

    @property
    def total(self) -> float:
        """A step from actions to arrays, one stage after the other."""
        return self.pack + self.write + self.device + self.read + self.unpack

    @property
    def rate(self) -> float:
        """Slots' steps per second of such steps, one after the other."""
        return self.n_envs / self.total

    @property
    def bottleneck(self) -> str:
        """The longest of the stages that follow each other."""
        return max(("pack", "write", "device", "read", "unpack"), key=lambda name: float(getattr(self, name)))

    def as_json(self) -> dict[str, Any]:
        """Return it as JSON has it."""
        result = asdict(self)
        return {**result, "total": self.total, "rate": self.rate, "bottleneck": self.bottleneck}


def predict(
    spec: EnvSpec, layout: MemoryMap, link: Link, host: HostTimes, clock: float, pipelined: bool = True
) -> Prediction:
    """Predict a step.

    Not pipelined is what the paper calls PEARL without pipeline, with one processing element in ``layout``:
    no group overlaps with another, and the states are not kept in the hardware, but go to it with the
    actions and come back with the results, packed, at no cost to the host.

    Parameters
    ----------
    spec, layout
        The environment and its build.
    link
        The link.
    host
        What the host takes for so many slots.
    clock
        Of the hardware, in hertz.
    pipelined
        Whether groups of slots overlap, and states stay in the hardware.
    """
    if not clock > 0:
        raise ArgumentError(f"the clock is {clock} Hz; it must be positive")
    timing = elaboration.core_timing(spec)
    states = 0 if pipelined else -(-layout.n_envs * word_bits(spec.state) // 8)
    beat = layout.data_wl // 8
    states_in, states_out = (
        _burst_cycles(0, states, beat, overhead) for overhead in (_WRITE_BURST, _READ_BURST)
    )
    # A link can be no faster than the port at its end.
    write = max((layout.step_write[1] + states) / link.write_rate, (write_cycles(layout) + states_in) / clock)
    read = max((layout.step_read[1] + states) / link.read_rate, (read_cycles(layout) + states_out) / clock)
    compute = (layout.groups - 1) * (timing.interval if pipelined else timing.latency) + timing.latency
    return Prediction(
        layout.n_envs,
        layout.pe_num,
        layout.data_wl,
        pack=host.pack,
        write=link.call + write,
        words_in=layout["actions"].words / clock,
        compute=compute / clock,
        words_out=max(layout[name].words for name in _RESULTS) / clock,
        device=step_cycles(spec, layout, pipelined) / clock,
        read=link.call + read,
        unpack=host.unpack,
    )


@dataclass(frozen=True, slots=True)
class Overlap:
    """Two half-batches that take turns: while the link moves one, the host works on the other.

    Parameters
    ----------
    half
        A step of one of them: of a device with half of the slots.
    """

    half: Prediction

    @property
    def loads(self) -> dict[str, float]:
        """Seconds that each part is busy while both halves step once.

        The host is one thread. Each direction of the link is a channel of its own. A half cannot step
        again before its own step is done: ``"round trip"``.
        """
        half = self.half
        return {
            "host": 2 * (half.pack + half.unpack),
            "link, writing": 2 * half.write,
            "link, reading": 2 * half.read,
            "round trip": half.total,
        }

    @property
    def total(self) -> float:
        """Seconds in which both halves step once: the longest of :attr:`loads`."""
        return max(self.loads.values())

    @property
    def rate(self) -> float:
        """Slots' steps per second."""
        return 2 * self.half.n_envs / self.total

    @property
    def bottleneck(self) -> str:
        """The part that is busy longest."""
        return max(self.loads, key=self.loads.__getitem__)

    def as_json(self) -> dict[str, Any]:
        """Return it as JSON has it."""
        return {
            "half": self.half.as_json(),
            "loads": self.loads,
            "total": self.total,
            "rate": self.rate,
            "bottleneck": self.bottleneck,
        }
