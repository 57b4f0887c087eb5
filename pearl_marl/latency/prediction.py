"""T2 and T6, the link; how long a step takes behind one, and two half-batches that take turns."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

from pearl_marl.errors import ArgumentError
from pearl_marl.hardware import elaboration
from pearl_marl.latency.cycles import (
    RESULTS,
    read_cycles,
    step_cycles,
    transfer_cycles,
    write_cycles,
)
from pearl_marl.latency.host import HostTimes
from pearl_marl.memory_map import MemoryMap
from pearl_marl.spec import EnvSpec, word_bits


@dataclass(frozen=True, slots=True)
class Link:
    """What lies between host and hardware, as ``pearl plan --link`` takes it by name.

    ``call`` is what a transfer takes besides its bytes, in seconds; the rates to the hardware and from it are
    in bytes per second. ``source`` says where the figures are from.
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
    def link(self) -> float:
        """What the link takes of a step."""
        return self.write + self.read

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
        return {**asdict(self), "total": self.total, "rate": self.rate, "bottleneck": self.bottleneck}


def predict(
    spec: EnvSpec,
    layout: MemoryMap,
    link: Link,
    host: HostTimes,
    clock: float,
    pipelined: bool = True,
    burst: int | None = None,
) -> Prediction:
    """Predict a step of a build, with the host's times for so many slots and a clock in hertz.

    The core is one for that clock, on the 7 series, as is the XDMA core at the end of the link.

    Not pipelined is what the paper calls PEARL without pipeline, with one processing element in ``layout``:
    no group overlaps with another, and the states are not kept in the hardware, but go to it with the
    actions and come back with the results, packed, at no cost to the host.

    What is predicted holds for bursts of any length, if the link queues them. ``burst`` is for one that waits
    for the answer to each: the most bytes that it moves in one.
    """
    target = elaboration.clocked("xc7", clock / 1e6)
    timing = elaboration.core_timing(spec, target)
    states = 0 if pipelined else -(-layout.n_envs * word_bits(spec.state) // 8)
    # A link can be no faster than the port at its end.
    moved = transfer_cycles(0, states, layout.data_wl // 8, burst)
    written, came = write_cycles(layout, burst) + moved, read_cycles(layout, burst) + moved
    write = max((layout.step_write[1] + states) / link.write_rate, written / clock)
    read = max((layout.step_read[1] + states) / link.read_rate, came / clock)
    compute = (layout.groups - 1) * (timing.interval if pipelined else timing.latency) + timing.latency
    return Prediction(
        layout.n_envs,
        layout.pe_num,
        layout.data_wl,
        pack=host.pack,
        write=link.call + write,
        words_in=layout["actions"].words / clock,
        compute=compute / clock,
        words_out=max(layout[name].words for name in RESULTS) / clock,
        device=step_cycles(spec, layout, pipelined, target) / clock,
        read=link.call + read,
        unpack=host.unpack,
    )


@dataclass(frozen=True, slots=True)
class Overlap:
    """Two half-batches that take turns: while the link moves one, the host works on the other.

    ``half`` is a step of a device with half of the slots.
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
        sums = {name: getattr(self, name) for name in ("loads", "total", "rate", "bottleneck")}
        return {"half": self.half.as_json(), **sums}
