"""The address map of the Comm-BRAM, computed once for host and hardware.

Everything is a function of ``(spec, n_envs, pe_num, data_wl)``. The host's codec reads it, the
RTL gets the same numbers as parameters, and a test compares the two.

Two rules shape it:

- *What a step writes is contiguous, and so is what it reads*: actions, then the doorbell that
  starts the step; results, then the status that ends it. So a step is one transfer each way.
- *No bit is wasted between slots.* A region is one stream of bits in which slot ``i`` owns bits
  ``i * slot_bits`` and up, least significant first. Only a region's end is padded, to a whole
  word of ``data_wl`` bits.

::

    control | initial states | reset mask | actions | doorbell || observations | rewards | ters | status
    ------------- once, or at a reset ----- ---- every step --    ------------ every step -------------
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

from pearl_marl.errors import ArgumentError
from pearl_marl.spec import EnvSpec, word_bits

PROTOCOL_VERSION = 1
MAGIC = 0x4C524150  # "PARL", little-endian

DATA_WIDTHS = (32, 64, 128, 256, 512, 1024)


class Control(IntEnum):
    """The 32-bit words of the control region, by index; the first eight are read-only identity."""

    MAGIC = 0
    PROTOCOL_VERSION = 1
    ENV_HASH = 2
    N_ENVS = 3
    PE_NUM = 4
    DATA_WL = 5
    STATE_BITS = 6
    RESULT_BITS = 7
    SEED_0 = 8
    SEED_1 = 9
    TICK_LOW = 10
    TICK_HIGH = 11
    FIRST_SLOT = 12
    MAX_CYCLES = 13
    MODE = 14
    RESERVED = 15


class Doorbell(IntEnum):
    """The 32-bit words of the doorbell, by index."""

    MODE = 0
    SEQUENCE = 1


class Status(IntEnum):
    """The 32-bit words of the status, by index."""

    ERROR = 0
    CYCLES = 1
    SEQUENCE = 2


@dataclass(frozen=True, slots=True)
class Region:
    """One contiguous piece of the address space.

    Parameters
    ----------
    name
        As in the diagram above.
    offset
        Byte address of the first word.
    words
        How many words of ``data_wl`` bits it has.
    slot_bits
        Bits a slot owns in it; 0 for the registers.
    """

    name: str
    offset: int
    words: int
    slot_bits: int


@dataclass(frozen=True, slots=True)
class MemoryMap:
    """Every address and width of one build; made by :func:`memory_map`.

    ``regions`` lists them in the order of their addresses. All sizes are in bytes.
    """

    n_envs: int
    pe_num: int
    data_wl: int
    groups: int
    regions: tuple[Region, ...]

    def __getitem__(self, name: str) -> Region:
        return next(region for region in self.regions if region.name == name)

    def end(self, name: str) -> int:
        """Return the byte address after the last word of a region."""
        return self[name].offset + self.size(name)

    def size(self, name: str) -> int:
        """Return the bytes of a region."""
        return self[name].words * self.data_wl // 8

    @property
    def step_write(self) -> tuple[int, int]:
        """Byte address and length of what a step writes: actions and doorbell."""
        start = self["actions"].offset
        return start, self.end("doorbell") - start

    @property
    def step_read(self) -> tuple[int, int]:
        """Byte address and length of what a step reads: results and status."""
        start = self["observations"].offset
        return start, self.end("status") - start


def memory_map(spec: EnvSpec, n_envs: int, pe_num: int, data_wl: int) -> MemoryMap:
    """Lay out the Comm-BRAM for one build.

    Parameters
    ----------
    spec
        Gives the widths.
    n_envs
        Slots, at least 1.
    pe_num
        Processing elements, ``1 .. n_envs``; the last group may be partly empty.
    data_wl
        Bits of a word, one of :data:`DATA_WIDTHS`.

    Raises
    ------
    ArgumentError
        Names the parameter that is out of range and its limits.
    """
    if n_envs < 1:
        raise ArgumentError(f"n_envs is {n_envs}; a memory map needs at least 1 slot")
    if not 1 <= pe_num <= n_envs:
        raise ArgumentError(f"pe_num is {pe_num}; possible are 1 to n_envs = {n_envs}")
    if data_wl not in DATA_WIDTHS:
        raise ArgumentError(f"data_wl is {data_wl}; possible are {', '.join(map(str, DATA_WIDTHS))}")
    register_regions = {"control": len(Control), "doorbell": len(Doorbell), "status": len(Status)}
    slot_regions = {
        "initial_states": word_bits(spec.state),
        "reset_mask": 1,
        "actions": spec.action.bits,
        "observations": word_bits(spec.observation),
        "rewards": spec.reward.bits,
        "ters": 2,
    }
    regions = []
    offset = 0
    for name in (
        "control",
        "initial_states",
        "reset_mask",
        "actions",
        "doorbell",
        "observations",
        "rewards",
        "ters",
        "status",
    ):
        slot_bits = slot_regions.get(name, 0)
        bits = slot_bits * n_envs if slot_bits else 32 * register_regions[name]
        words = -(-bits // data_wl)
        regions.append(Region(name, offset, words, slot_bits))
        offset += words * data_wl // 8
    return MemoryMap(n_envs, pe_num, data_wl, -(-n_envs // pe_num), tuple(regions))
