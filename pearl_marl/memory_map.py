"""The address map of the Comm-BRAM, computed once for host and hardware.

Everything is a function of ``(spec, n_envs, pe_num, data_wl)``. The host's codec reads it, and the
RTL computes the same (``rtl/pearl_map_pkg.sv``).

Three rules shape it:

- *What a step writes is contiguous, and so is what it reads*: actions, then the doorbell that
  starts the step; results, then the status that ends it. So a step is one transfer each way. The
  reset mask stands right before the actions, so a step with a mask is one transfer too.
- *No bit is wasted between slots.* A region is one stream of bits in which slot ``i`` owns bits
  ``i * slot_bits`` and up, least significant first. Only a region's end is padded, to a whole
  word of ``data_wl`` bits.
- *Except in the memories that the hardware takes a group of slots from at a time*: initial states,
  current states and elapsed steps. They are a stream per group, and every group starts at a multiple
  of a power of two words, so that the hardware splits an address into group and word by its bits.
  The padding reads as zero and takes no space in the hardware.

::

    control | initial states | current states | elapsed | reset mask | actions | doorbell ||
    --------------------- once, at a reset, for checkpoints --------- --- every step ----

    || observations | rewards | ters | status
       ------------ every step -------------

A slot of actions, observations and rewards is those of its agents, side by side. A slot of ``ters`` is a bit
for each agent, whether it has ended in this episode, and one more, whether the time limit is over. A slot of
the current states is its state word and, above it, these bits of its last step. Control, initial and current
states, elapsed, reset mask and actions can be written and (but for control) read only while no step runs;
results and status are read-only. A refused access, and one to a hole in the map, is answered with an error.
The one word that can be written at any time is ``RESET`` of control.

A build with a policy engine (:class:`Engine`) has two more regions behind the status: ``statistics``, which
can be read at any time and says what engine it is, too; and ``policy``, which is written before a rollout and
reads as zero. A word of ``policy`` holds a number of 32 bits, however wide it is.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum, IntFlag
from typing import TYPE_CHECKING, Any, NamedTuple

from pearl_marl.errors import ArgumentError, DeviceError
from pearl_marl.spec import EnvSpec, check_slots, word_bits

if TYPE_CHECKING:
    from pearl_marl.policies.golden_policy import GoldenPolicy

PROTOCOL_VERSION = 3
MAGIC = 0x4C524150  # "PARL", little-endian

DATA_WIDTHS = (32, 64, 128, 256, 512, 1024)
ELAPSED_BITS = 32

REGION_NAMES = (
    "control",
    "initial_states",
    "current_states",
    "elapsed",
    "reset_mask",
    "actions",
    "doorbell",
    "observations",
    "rewards",
    "ters",
    "status",
)

ENGINE_REGION_NAMES = ("statistics", "policy")
"""Regions behind these where there is a policy engine."""


class Control(IntEnum):
    """The 32-bit words of the control region, by index; the first eight are read-only identity.

    Writing anything but zero to ``RESET``, also during a step, resets the hardware. It reads as zero. Once
    the reset is over, the status says :attr:`StatusError.RESET`; until then it is all zeros.
    """

    MAGIC = 0
    PROTOCOL_VERSION = 1
    """In its upper half, what policy engine there is: the place of its kind in :data:`ENGINE_KINDS`."""
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
    RESET = 14
    STEPS = 15
    """How many steps a rollout has, where there is a policy engine; otherwise 0 and not to be written."""


class Doorbell(IntEnum):
    """The 32-bit words of the doorbell, by index.

    A step starts when ``SEQUENCE`` is written and differs from that of the step before.
    """

    MODE = 0
    SEQUENCE = 1


class Mode(IntFlag):
    """The bits of the doorbell's ``MODE``: how this step treats resets."""

    NEXT_STEP = 1
    """A slot that ended spends this step resetting; if not set, it steps from its start state."""
    STORED = 2
    """Start states come from the initial states region; if not set, from random draws."""
    RESET_ALL = 4
    """Every slot steps from its start state."""
    RESET_MASK = 8
    """So does every slot whose bit in the reset mask is set."""
    ROLLOUT = 16
    """Make ``STEPS`` steps, whose actions the policy engine chooses. The reset mask is ignored, and no
    results are written. Without an engine, this bit has no meaning."""


class Status(IntEnum):
    """The 32-bit words of the status, by index.

    ``SEQUENCE`` becomes that of the doorbell once every result of its step is in place. ``CYCLES``
    are clock cycles from doorbell to then. Results that were read from their first word on, and the status
    after them, belong to its ``SEQUENCE``, unless ``ERROR`` says :attr:`StatusError.TORN_READ`.

    ``SEQUENCE`` stands first because words are read in the order of their addresses, and narrow ones
    some cycles apart: what is read after a new ``SEQUENCE`` is of the same step, or newer.
    """

    SEQUENCE = 0
    CYCLES = 1
    ERROR = 2


class StatusError(IntFlag):
    """The bits of the status's ``ERROR``."""

    BUSY_DOORBELL = 1
    """A doorbell came while a step was running, and was refused. Cleared by the next one that rings."""
    BUSY_WRITE = 2
    """The same of any other write, be it of a part of a word."""
    TORN_READ = 4
    """The first word of results has not been read since the last step: what was read is not of one step, or
    old. So it is set by the doorbell, and whoever polls the status alone finds it."""
    RESET = 8
    """Nothing has been written to the control region since the hardware was reset: it holds no batch."""


class Statistics(IntEnum):
    """The 32-bit words of the statistics of a rollout, by index; sums have two, the lower first.

    ``STEPS`` are those that are done, also while a rollout runs. Everything else is complete when the status
    has the doorbell's sequence number. ``EPISODES`` are agents' episodes that ended, and began with the
    rollout or within it. ``TRUNCATED`` are those of them that the time limit ended, ``LENGTHS`` the sum of
    their steps, and ``RETURNS`` the sum of their rewards, a signed whole number: see ``Section.QUANTA``.
    """

    STEPS = 0
    CYCLES = 2
    EPISODES = 4
    TRUNCATED = 6
    LENGTHS = 8
    RETURNS = 10
    ENGINE = 12
    """From here on, :attr:`Engine.words`; its kind is in the control region."""


STATISTICS_WORDS = 23


class Section(IntEnum):
    """The sections of the policy region; each has as many words as the largest."""

    SETTINGS = 0
    """How actions are chosen; the number of the last layer; the limit of inputs, or the table's first row;
    the shift of the sums of patches; then two for each layer."""
    BIASES = 1
    ACTIVATION = 2
    """The table for the sums of layers that have one: it is the same for all of them."""
    CHANCES = 3
    QUANTA = 4
    """What each category of rewards counts, a signed whole number of 40 bits: its lower 32 bits first."""
    SCALINGS = 5
    """Of each element its offset, and its shift above its multiplier; for a table, its factor; for planes,
    the weights of each filter and its bias."""
    WEIGHTS = 6
    """The weights, or the table."""


SECTION_BITS = 3
ENTRIES = 1024
"""Numbers in a table of activations or chances."""


ENGINE_KINDS = ("none", "table", "network", "golden", "planes")


class Engine(NamedTuple):
    """The policy engine of a build: what is the largest policy that it takes, and how fast it is."""

    kind: str = "network"
    """``"network"``, ``"table"``, ``"golden"``: a golden function, which is a part of the design; or
    ``"planes"``: a network behind filters of pictures whose elements are 0 and 1."""
    drawn: bool = False
    """Of a network or a table: whether it is able to draw actions; if not, it takes the best."""
    table_rows: int = 1
    """Of a table: how many observations it tells apart."""
    logit_bits: int = 32
    """Of a table: the width of its numbers, sign included."""
    products: int = 1
    """Of a network, as all that follows: products of each agent in a cycle."""
    side: int = 1
    """Groups of slots that are computed side by side."""
    rounds: int = 1
    """Batches of these that a layer takes one after the other."""
    hidden: int = 1
    """The most outputs of a layer but the last."""
    layers: int = 1
    weight_bits: int = 8
    value_bits: int = 12
    """Width of what weights are multiplied by, sign included: inputs, and outputs of layers."""
    filters: int = 1
    """Of a network on planes: the most filters."""
    function: GoldenPolicy | None = None
    """The policy of a golden function that hardware is built of."""
    stated: int = 0
    """The number of a golden function without its policy: all that hardware states of it."""

    @property
    def number(self) -> int:
        """The number of its golden function; 0 of an engine of another kind."""
        return self.stated if self.function is None else self.function.number

    @property
    def draws(self) -> int:
        """How many random draws it takes for an agent's action; of a golden function its policy says so."""
        return int(self.drawn) if self.function is None else self.function.draws

    @property
    def words(self) -> list[int]:
        """What hardware states of it beside its kind: 32 bits each, all that is numbers in their order.

        The first is ``drawn`` and, above this bit, the number of the golden function.
        """
        return [self.drawn | self.number << 1, *self[2:-2]]

    def as_json(self) -> dict[str, Any]:
        """Return it as JSON has it, with the number of its golden function."""
        sizes = self._asdict()
        del sizes["stated"]
        return {**sizes, "function": self.number}

    @classmethod
    def of_words(cls, kind: int, words: Sequence[int]) -> Engine:
        """Return the engine that hardware states: the number of its kind, and its words in the statistics."""
        first, name = words[0], ENGINE_KINDS[kind]
        sizes: list[Any] = list(words[1:])
        drawn, number = first & 1, first >> 1
        if (drawn if name == "golden" else number) or not all(1 <= size < 1 << 24 for size in sizes):
            raise DeviceError(
                f"the hardware states an impossible policy engine: {', '.join(map(str, words))}"
            )
        return cls(name, bool(drawn), *sizes)._replace(stated=number)

    @property
    def is_network(self) -> bool:
        """Whether it computes layers, be it of numbers or of planes."""
        return self.kind in ("network", "planes")

    def inputs(self, spec: EnvSpec) -> int:
        """Return how many inputs its first layer has; of planes, filters of a patch fill whole words."""
        if self.kind != "planes":
            return len(spec.observation)
        if len(spec.observation_shape) != 3 or min(spec.observation_shape[:2]) < 3:
            raise ArgumentError(
                f"the policy engine takes pictures of planes, 3 by 3 at least, and observations of {spec.id} "
                f"have the shape {spec.observation_shape}; take another kind of engine"
            )
        rows, columns, _ = spec.observation_shape
        return (rows - 2) * (columns - 2) * -(-self.filters // self.products) * self.products

    def weight_words(self, spec: EnvSpec) -> int:
        """Return how many words of weights it has room for, each with those of ``products`` products."""
        sizes = [self.inputs(spec), *[self.hidden] * (self.layers - 1), sum(spec.action_counts)]
        return sum(-(-sizes[k] // self.products) * sizes[k + 1] for k in range(self.layers))

    def index_bits(self, spec: EnvSpec) -> int:
        """Return the bits of an index of the policy region."""
        actions = sum(spec.action_counts)
        largest = [ENTRIES, len(spec.observation)]
        largest += [2 << spec.reward.bits] if spec.rewards else []
        if self.kind == "table":
            largest.append(self.table_rows << (actions - 1).bit_length())
        elif self.is_network:
            columns = -(-self.products * self.weight_bits // 32)
            largest += [self.weight_words(spec) << (columns - 1).bit_length()]
            if self.kind == "planes":
                words, numbers = -(-self.filters // self.products), 9 * spec.observation_shape[2] + 1
            else:
                words, numbers = -(-len(spec.observation) // self.products), 2
            largest.append(words << (self.products - 1).bit_length() + (numbers - 1).bit_length())
            largest += [(self.layers - 1) * self.hidden + actions, 4 + 2 * self.layers]
        return SECTION_BITS + (max(largest) - 1).bit_length()


@dataclass(frozen=True, slots=True)
class Region:
    """One contiguous piece of the address space: ``rows`` streams, one after the other."""

    name: str
    offset: int
    """Byte address of the first word."""
    rows: int
    """One, or one per group."""
    row_words: int
    """Words of ``data_wl`` bits of a stream."""
    row_slots: int
    """How many slots a stream has room for; 0 for the registers."""
    slot_bits: int
    """Bits that a slot owns; 0 for the registers."""

    @property
    def words(self) -> int:
        """How many words of ``data_wl`` bits it has."""
        return self.rows * self.row_words


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
    engine: Engine | None = None

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


def ter_bits(spec: EnvSpec) -> int:
    """Return the bits by which a slot's ends are told: one for each agent, and one for the time limit."""
    return spec.agents + 1


def stream_bits(spec: EnvSpec) -> dict[str, int]:
    """Return the bits that a slot has in the regions of every step."""
    return {
        "actions": spec.agents * word_bits(spec.action_fields),
        "observations": spec.agents * word_bits(spec.agent_fields),
        "rewards": spec.agents * spec.reward.bits,
        "ters": ter_bits(spec),
    }


def memory_map(
    spec: EnvSpec, n_envs: int, pe_num: int, data_wl: int, engine: Engine | None = None
) -> MemoryMap:
    """Lay out the Comm-BRAM for one build; raise ArgumentError where a size is out of range.

    That is ``1 .. n_envs`` for ``pe_num``, the processing elements (the last group may be partly empty), and
    :data:`DATA_WIDTHS` for ``data_wl``, the bits of a word.
    """
    check_slots("n_envs", n_envs)
    if n_envs >= 1 << 32:
        raise ArgumentError(
            f"n_envs is {n_envs:,}; hardware tells it in 32 bits: take {(1 << 32) - 1:,} at most"
        )
    if not 1 <= pe_num <= n_envs:
        raise ArgumentError(f"pe_num is {pe_num}; possible are 1 to n_envs = {n_envs}")
    if data_wl not in DATA_WIDTHS:
        raise ArgumentError(f"data_wl is {data_wl!r}; possible are {', '.join(map(str, DATA_WIDTHS))}")
    groups = -(-n_envs // pe_num)
    registers = {"control": len(Control), "doorbell": len(Doorbell), "status": len(Status)}
    streams = {"reset_mask": 1, **stream_bits(spec)}
    by_group = {
        "initial_states": word_bits(spec.state),
        "current_states": word_bits(spec.state) + ter_bits(spec),
        "elapsed": ELAPSED_BITS,
    }
    regions: list[Region] = []

    def add(name: str, rows: int, row_words: int, row_slots: int = 0, slot_bits: int = 0) -> None:
        offset = regions[-1].offset + regions[-1].words * data_wl // 8 if regions else 0
        regions.append(Region(name, offset, rows, row_words, row_slots, slot_bits))

    for name in REGION_NAMES:
        if name in registers:
            add(name, 1, -(-32 * registers[name] // data_wl))
        elif name in streams:
            add(name, 1, -(-n_envs * streams[name] // data_wl), n_envs, streams[name])
        else:
            least_words = -(-pe_num * by_group[name] // data_wl)
            add(name, groups, 1 << (least_words - 1).bit_length(), pe_num, by_group[name])
    if engine is not None:
        sizes = -(-32 * STATISTICS_WORDS // data_wl), 1 << engine.index_bits(spec)
        for name, words in zip(ENGINE_REGION_NAMES, sizes, strict=True):
            add(name, 1, words)
    return MemoryMap(n_envs, pe_num, data_wl, groups, tuple(regions), engine)


MAX_DEFAULT_PE_NUM = 128
"""More processing elements take fewer cycles, but each cycle takes longer to simulate, and the model
longer to compile: 43,008 slots of CliffWalking step fastest with 128, 7 % slower with 64, 40 % with 256."""

MAX_DEFAULT_DRAWS = 128
"""A random draw is two products of 32 bits, and what a core makes of it is hardware, too. So cores that draw
often are fewer: 32 of Blackjack, with three draws each. 64 take minutes to compile, and step no faster."""

DEFAULT_GROUPS = 16
"""With this many groups, a step's constant dozen of cycles no longer matters; so few slots make do
with a small model, which compiles quickly."""


def default_map(
    spec: EnvSpec,
    n_envs: int,
    pe_num: int | None = None,
    data_wl: int | None = None,
    engine: Engine | None = None,
) -> MemoryMap:
    """Lay out the Comm-BRAM, with sizes chosen where none are given.

    Processing elements are the smallest power of two that takes the slots in :data:`DEFAULT_GROUPS`
    groups; but no more than the word (the widest there is, if none is given) can feed or drain in a cycle,
    no more than :data:`MAX_DEFAULT_PE_NUM`, nor than take :data:`MAX_DEFAULT_DRAWS` random draws a cycle. The
    word is the narrowest that keeps up with a group of slots a cycle, or the widest there is.

    What else a core takes is not known here: of one with many multipliers fewer may fit a part, which is what
    :func:`pearl_marl.latency.plan` finds out.
    """
    # Every stream has a bank of its own, so the widest sets the pace.
    widest = max(stream_bits(spec).values())
    draws = spec.reset_draws + spec.step_draws
    if pe_num is None:
        fed = (data_wl or DATA_WIDTHS[-1]) // widest
        most = min(MAX_DEFAULT_PE_NUM, fed, MAX_DEFAULT_DRAWS // max(1, draws))
        least = -(-n_envs // DEFAULT_GROUPS)
        pe_num = min(1 << (max(1, most).bit_length() - 1), 1 << (least - 1).bit_length())
    if data_wl is None:
        data_wl = next((width for width in DATA_WIDTHS if width >= pe_num * widest), DATA_WIDTHS[-1])
    return memory_map(spec, n_envs, pe_num, data_wl, engine)
