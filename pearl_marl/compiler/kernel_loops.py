"""The loops of the CPU's kernels, over blocks of slots.

A kernel goes through its slots block by block, and does one thing after the other to all slots of a block: a
short loop without branches becomes SIMD code. Everything here runs once, and writes instructions: see
:mod:`~pearl_marl.compiler.llvm_functions`. A method that is run by ``code.run`` takes all that it works on
from its frame:

- numbers: ``m``, the slots of the block; ``slot_0``, the global number of the first; ``i``, a slot;
- results of the block's agents, as in :class:`pearl_marl.batch.step.BatchStep`, ``codes`` of rewards, and the
  device's ``actions``;
- ``elapsed`` and ``ended``, the columns of :mod:`pearl_marl.batch.slot_memory`;
- ``over``, not 0 for a slot whose episode is over; ``resetting``, 1 for one that spends the step on a reset;
- ``end_bits`` and ``end_bits_before``, in worlds of several agents: see
  :mod:`~pearl_marl.compiler.kernel_ends`;
- ``state_0``, ``state_1``, ... and ``start_0``, ...: the fields of the state and of stored starts, a column
  each, or ``state`` and ``starts``, where all fields are in lanes.

Of more than a few columns LLVM does not check whether they overlap, and leaves a loop scalar; parts of one
array it can tell apart. So the many fields of a large state are copied into *lanes* of scratch space, block
by block. With the 10 fields of LevelBasedForaging with one food, a golden step takes a seventh of the time in
lanes.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any

import numpy as np
from numba import types

from pearl_marl.batch import slot_memory
from pearl_marl.compiler import flag_runs
from pearl_marl.compiler.agents_alike import is_crowded
from pearl_marl.compiler.kernel_ends import Ends
from pearl_marl.compiler.llvm_functions import Code, Compiled, Frame, Value, WordArray
from pearl_marl.compiler.llvm_words import ARITHMETIC
from pearl_marl.compiler.straight_line import maskers, observers, orders
from pearl_marl.golden import rng
from pearl_marl.spec import EnvSpec, Field

BLOCK = 1024
"""Slots of a block: what its loops touch then fits a 32 KiB L1 cache. A multiple of 64, and at most 2040:
flags are counted in bytes."""

LANES_BLOCK = 512
"""Slots of a block whose state is in lanes. Seaquest steps 40 M slots/s like this, with the columns of its 41
fields as they are 6 M."""

MOST_COLUMNS = 8
"""Fields of a state from beyond which on they are copied into lanes."""

MOST_REWARDS = 8
"""Rewards up to which one is found by choices; beyond that looking it up costs less."""

ROWS_AHEAD = 16
"""How many slots ahead the rows are that are fetched while one is unpacked: so the cache misses of many
overlap."""
LONG_ROW = 16
"""Elements of an observation beyond which it is blanked by a loop."""

LARGE = 64
"""Elements above which an observation is large."""

RESULTS = ("observations", "rewards", "terminations", "truncations", "final_observations")
ADDRESSES = ("memory", "stored", "elapsed", *RESULTS, "action_masks", "alive")
"""What the kernel ``step`` takes the addresses of; the last two are 0 where there is no such array."""

SETTINGS = (
    *("seed_0", "seed_1", "tick", "first_slot", "limit", "next_step", "use_stored", "n"),
    # Whether the kernel is all that a step does: where actions are not in the space it does nothing, and
    # otherwise it moves the tick, too.
    "checked",
)
STEP_ARGUMENTS = *ADDRESSES, *SETTINGS
"""What the kernel ``step`` takes in one array, in its order. Numba looks at each argument of a call, and
longest at arrays: for few slots that was most of a step."""

_DRAWN_FROM = "seed_0", "seed_1", "tick", "first_slot"
_RANGE = "n", "lo", "hi"

KERNELS = {
    "reset": ("memory", "stored", "mask", "views", *_DRAWN_FROM, "use_stored", *_RANGE),
    "step": ("arguments", "actions", "table", "lo", "hi"),
    "deliver": ("words", "observations", "n"),
    "results": (
        *("words", "codes", "end_words", "stored", "table", "results"),
        *(*_DRAWN_FROM, "next_step", "use_stored", *_RANGE),
    ),
    "advance": ("memory", "actions", "table", "rewards", "terminations", *_RANGE),
}
"""The kernels of an environment, and what each takes: see :class:`pearl_marl.compiler.kernels.Kernels`."""

Kernel = dict[str, Any]
"""The arguments of a kernel and what it has made of them, by name: arrays of all slots, and numbers."""


def numba_type(dtype: object) -> Any:
    """Return Numba's type of a dtype."""
    return getattr(types, str(np.dtype(dtype)))  # type: ignore[call-overload]


def element(code: Code, word: Value, field: Field, dtype: np.dtype[Any]) -> Value:
    """Return the element of a row that a word of a field is delivered as."""
    number = word.to(numba_type(field.dtype)).to(numba_type(dtype))
    return number * 2.0**-field.fraction if field.fraction else number


class KernelLoops:
    """The kernels of one environment, as functions that write them.

    ``counter`` is the dtype of elapsed steps, ``unpack`` what Numba makes of the author's function, if there
    is one. ``golden`` are the golden functions by the names that :mod:`~pearl_marl.compiler.straight_line`
    gives them; they may come later.
    """

    def __init__(
        self, spec: EnvSpec, counter: str, golden: dict[str, Callable[..., Any]], unpack: Any = None
    ) -> None:
        self.spec, self.golden, self.unpack = spec, golden, unpack
        self.compiled: dict[Any, Compiled | None] = {}
        """The functions that are compiled by themselves, for all kernels that call them."""
        self.agents, self.masks = spec.agents, len(spec.mask_fields)
        self.row = spec.observation_size
        self.dtype = flag_runs.cell_dtype(spec)
        self.whole = self.agents * self.row
        self.reset_draws = range(spec.reset_draws)
        self.step_draws = range(spec.reset_draws, spec.reset_draws + spec.step_draws)
        *self.fields, _, self.ended = slot_memory.columns(spec)
        self.has_lanes = len(spec.state) > MOST_COLUMNS
        self.size = LANES_BLOCK if self.has_lanes else BLOCK
        self.state = [] if self.has_lanes else [f"state_{k}" for k in range(len(self.fields))]
        self.lane = np.dtype(f"uint{8 * max(field.dtype.itemsize for field in spec.state)}")
        self.counter = numba_type(counter)
        self.runs = flag_runs.runs(spec)
        self.crowded = is_crowded(spec)
        self.observers, self.maskers, self.orders = observers(spec), maskers(spec), orders(spec)
        self.takes_turns = self.crowded and self.has_lanes and len(set(self.observers)) < self.agents
        # From about so many on, fewer where a start takes draws, SIMD code for all slots is faster. Not with
        # large observations, of which all would be made anew, nor those of agents that have ended.
        self.one_by_one = unpack is not None or self.agents > 1 or self.whole > LARGE
        self.few = self.size // (16 + 3 * spec.reset_draws)
        self.ends = Ends(self.agents, numba_type(self.ended.dtype), self.counter)
        types_of_arrays = {
            "elapsed": (counter, 1),
            "observations": (self.dtype, self.whole),
            "final_observations": (self.dtype, self.whole),
            "actions": (spec.action_dtype, self.agents * len(spec.action_fields)),
            "rewards": (np.float32, self.agents),
            "terminations": (np.uint8, self.agents),
            "truncations": (np.uint8, self.agents),
            "action_masks": (np.int8, self.agents * self.masks),
            "alive": (np.uint8, self.agents),
            "codes": (spec.reward.dtype, self.agents),
            "end_words": (self.ended.dtype, 1),
            "end_bits_before": (self.ended.dtype, 1),
            "over": (np.uint8, 1),
        }
        self.arrays = {name: (numba_type(t), size) for name, (t, size) in types_of_arrays.items()}
        """The type of an array's elements, and how many a slot has."""

    # The kernels. Each is the body of one of Numba's functions.

    def reset(self, code: Code, kernel: Kernel) -> None:
        """Write the kernel ``reset``."""
        kernel |= {"over": kernel["mask"], **self._views(kernel["views"])}
        lo, hi = kernel["lo"], kernel["hi"]
        with self._scratch(code, "end_bits") as frame:
            frame = self._with_keys(code, frame, kernel, self.reset_draws)
            for f in self._blocks(code, frame, kernel, lo, hi):
                self._load(code, f, kernel)
                self._start_over(code, f)
                code.run(self.forget_all, f, "ended")
                self._observe(code, f)
                if self.agents > 1:
                    code.run(self.ends.bits_at_reset, f)
                    code.run(self.ends.show_alive, f)
                    for i in code.range(f.m):
                        with code.when(f.end_bits[i]):
                            code.run(self.blank, f.with_(i=i))
                self._store(code, f, kernel)

    def step(self, code: Code, kernel: Kernel) -> Value:
        """Write the kernel ``step``."""
        arguments, actions, lo, hi = (kernel[name] for name in ("arguments", "actions", "lo", "hi"))
        for k, name in enumerate(STEP_ARGUMENTS):
            kernel[name] = code.address(arguments[k]) if name in ADDRESSES else arguments[k].to(types.int64)
        possible = self._possible(code, actions, kernel["checked"], lo, hi)
        with code.when(possible[0]):
            self._step(code, kernel, lo, hi)
            # In the same call, so that no interrupt comes between slots and tick.
            with code.when(kernel["checked"]), code.when((hi - lo).equals(kernel["n"])):
                tick = STEP_ARGUMENTS.index("tick")
                arguments[tick] = arguments[tick] + 1
        return possible[0]

    def _possible(self, code: Code, actions: WordArray, checked: Value, lo: Value, hi: Value) -> WordArray:
        """Return a variable: 0 where actions are to be checked, and one is not in the space."""
        possible = code.variable(code.word(types.uint8, 1))
        count = getattr(self.spec.action_space, "n", None)  # numbers are checked before they become words
        if count is not None:
            with code.when(checked):
                largest = code.variable(code.word(actions.type, 0))
                for i in code.range(lo * self.agents, hi * self.agents):
                    largest[0] = code.operation(
                        ARITHMETIC["maximum"], actions.type, actions.type, largest[0], actions[i]
                    )
                possible[0] = largest[0].to(types.int64) < int(count)
        return possible

    def _step(self, code: Code, kernel: Kernel, lo: Value, hi: Value) -> None:
        names = ("codes", "over", "ended_slots", "resetting", "end_bits", "end_bits_before", "changed")
        next_step, tick = kernel["next_step"], kernel["tick"]
        with self._scratch(code, *names) as frame:
            self._clear(code, frame.resetting)
            frame = self._with_keys(code, frame, kernel, self.step_draws)
            # SAME_STEP starts the next episode now, at the next tick; NEXT_STEP starts it within this one.
            kernel["tick"] = code.choose(types.int64, next_step.differs(0), tick, tick + 1)
            frame = self._with_keys(code, frame, kernel, self.reset_draws)
            for f in self._blocks(code, frame, kernel, lo, hi):
                self._load(code, f, kernel)
                self._clear(code, f.over, f.m)
                any_resetting = code.variable(code.word(types.uint8, 0))
                with code.when(next_step):
                    for i in code.range(f.m):
                        f.resetting[i] = resetting = (f.ended[i] & 1).to(types.uint8)
                        any_resetting[0] = any_resetting[0] | resetting
                f = f.with_(any_resetting=any_resetting[0])
                self._draw(code, f, self.step_draws)
                code.run(self.golden_step, f)
                with code.when(f.any_resetting):
                    # These slots have run on unseen; the start of a new episode takes the place of their
                    # step.
                    code.run(self.ends.discard_step, f)
                    self._start_over(code, f)
                self.ends.find(code, f)
                code.run(self.rewards, f)
                if self.agents > 1:
                    code.run(self.ends.blank_rewards, f)
                self._observe(code, f)
                if self.agents > 1:
                    self._blank(code, f)
                with code.when(next_step):
                    code.run(self.ends.mark_over, f)
                    with code.when(f.any_resetting):
                        code.run(self.ends.no_reward, f)
                self._restart(code, f, self._count(code, f.over))
                self._store(code, f, kernel)

    def deliver(self, code: Code, kernel: Kernel) -> None:
        """Write the kernel ``deliver``."""
        words = {f"word_{k}": column for k, column in enumerate(kernel["words"])}
        observations, n = kernel["observations"].view(numba_type(self.dtype)), kernel["n"]
        self._run(code, self.deliver_rows, Frame(m=n, observations=observations, **words), "alone")

    def results(self, code: Code, kernel: Kernel) -> None:
        """Write the kernel ``results``."""
        results = kernel["results"]
        ends = ("end_words", "end_bits_before")[: len(kernel["end_words"])]
        kernel |= dict(zip(ends, kernel["end_words"], strict=True))
        kernel |= dict(zip(RESULTS, results[: len(RESULTS)], strict=True))
        kernel |= self._views([results[0], *results[len(RESULTS) :]])
        lo, hi = kernel["lo"], kernel["hi"]
        fields = list(enumerate(zip(kernel["words"], self.spec.agent_fields, strict=True)))
        with self._scratch(code, "over", "end_bits", "changed", *self.state) as frame:
            frame = self._with_keys(code, frame, kernel, self.reset_draws)
            for f in self._blocks(code, frame, kernel, lo, hi):
                self._load(code, f, kernel)
                delivered = {
                    f"word_{k}": column.view(numba_type(field.dtype), 0, f.b * self.agents)
                    for k, (column, field) in fields
                }
                self._run(code, self.deliver_rows, f.with_(**delivered))
                code.run(self.rewards, f)
                self._clear(code, f.over, f.m)
                code.run(self.ends.take_delivered, f)
                if self.agents > 1:
                    code.run(self.ends.blank_rewards, f)
                    self._blank(code, f)
                with code.when(f.next_step.equals(0)):
                    for i in self._flagged(code, f.over):
                        with code.when(f.over[i]):
                            one = f.with_(i=i)
                            code.run(self.keep_last, one)
                            code.run(self.start_one, one)
                            self._observe_start(code, one)

    def advance(self, code: Code, kernel: Kernel) -> None:
        """Write the kernel ``advance``."""
        lo, hi = kernel["lo"], kernel["hi"]
        zero = code.word(types.int64, 0)
        kernel |= dict.fromkeys(("seed_0", "seed_1", "tick", "first_slot"), zero)
        with self._scratch(code, "codes") as frame:
            frame = self._with_keys(code, frame, kernel, self.step_draws)
            for f in self._blocks(code, frame, kernel, lo, hi):
                self._load(code, f, kernel)
                self._draw(code, f, self.step_draws)
                code.run(self.golden_step, f)
                code.run(self.rewards, f)
                self._store(code, f, kernel)

    # What belongs to a block.

    def _views(self, views: Sequence[WordArray]) -> Kernel:
        """Return the arrays of what agents see, by name."""
        names = ["observations", *["action_masks"] * bool(self.masks), *["alive"] * (self.agents > 1)]
        return dict(zip(names, views, strict=True))

    def _scratch(self, code: Code, *names: str) -> Any:
        """Return scratch space, as a context manager: a frame of the columns with these names, and others."""
        size, ended = self.size, numba_type(self.ended.dtype)
        columns = {
            "keys": (types.uint32, 2 * self.step_draws.stop),
            "codes": (numba_type(self.spec.reward.dtype), self.agents * size),
            "over": (types.uint8, size),
            "ended_slots": (types.uint16, size),
            "resetting": (types.uint8, size),
            "end_bits": (ended, size),
            "end_bits_before": (ended, size),
            "changed": (types.uint8, size),
            **{name: (numba_type(self.fields[k].dtype), size) for k, name in enumerate(self.state)},
            **{
                f"run_{k}_{r}": (numba_type(self.spec.agent_fields[run.word].dtype), size)
                for k in range(self.agents)
                for r, run in enumerate(self.runs)
            },
        }
        space = {name: t for name, t in columns.items() if name in names or name[:3] in ("key", "run")}
        # Words that one loop works on, and that are not of one width, are in spaces of their own: LLVM does
        # not find out by itself that they are apart, and gives up a loop of too many words that might not be.
        alone = {}
        if self.step_draws.stop:
            alone["draws"] = types.uint32, size * self.step_draws.stop
        if self.has_lanes:
            lanes = numba_type(self.lane), size * len(self.fields)
            alone |= {"state": lanes, "starts": lanes}
        if self.takes_turns:
            alone["turns"] = lanes
        return code.scratch(space, alone)

    def _blocks(self, code: Code, frame: Frame, kernel: Kernel, lo: Value, hi: Value) -> Iterator[Frame]:
        """Write a loop over blocks: yields what belongs to one."""
        padded = (kernel["n"] + (slot_memory.ALIGNMENT - 1)) // slot_memory.ALIGNMENT * slot_memory.ALIGNMENT
        for k in code.range((hi - lo + (self.size - 1)) // self.size):
            b = lo + k * self.size
            left = hi - b
            m = code.operation(ARITHMETIC["minimum"], types.int64, types.int64, left, self.size)
            names = "limit", "next_step", "use_stored"
            named = {name: kernel[name].to(types.int64) for name in names if name in kernel}
            for name, (type_, size) in self.arrays.items():
                if name in kernel and name not in frame.named:
                    named[name] = kernel[name].view(type_, 0, b * size)
            if "memory" in kernel:
                named["ended"] = self._column(kernel["memory"], self.ended, padded, b)
            if not self.has_lanes:
                for name, memory in (("state", "memory"), ("start", "stored")):
                    for j, field in enumerate(self.fields) if memory in kernel else ():
                        named[f"{name}_{j}"] = self._column(kernel[memory], field, padded, b)
            if "table" in kernel:
                named["table"] = kernel["table"].view(types.float32)
            yield frame.with_(b=b, m=m, slot_0=kernel["first_slot"] + b, padded=padded, **named)

    @staticmethod
    def _column(memory: WordArray, column: slot_memory.Column, padded: Value, b: Value) -> WordArray:
        return memory.view(numba_type(column.dtype), padded * column.bytes_before, b)

    def _load(self, code: Code, f: Frame, kernel: Kernel) -> None:
        """Copy a block's state, and its stored starts, into lanes, where there are lanes."""
        if self.has_lanes and "memory" in kernel:
            code.run(self.copy_lanes, f.with_(memory=kernel["memory"], lanes=f.state), False)
        if self.has_lanes and "stored" in kernel:
            with code.when(f.use_stored):
                code.run(self.copy_lanes, f.with_(memory=kernel["stored"], lanes=f.starts), False)

    def _store(self, code: Code, f: Frame, kernel: Kernel) -> None:
        """Copy lanes back, where there are lanes."""
        if self.has_lanes:
            code.run(self.copy_lanes, f.with_(memory=kernel["memory"], lanes=f.state), True)

    def copy_lanes(self, code: Code, f: Frame, back: bool) -> None:
        """Copy a block's columns into lanes, or back: a loop over fields of each dtype, and their slots."""
        for dtype in sorted({field.dtype for field in self.fields}, key=str):
            fields = [(k * self.size, f.bytes_before) for k, f in enumerate(self.fields) if f.dtype == dtype]
            lanes, befores = (code.table(np.array(column, np.int64)) for column in zip(*fields, strict=True))
            for k in code.range(len(fields)):
                lane = f.lanes.view(numba_type(self.lane), 0, lanes[k])
                column = f.memory.view(numba_type(dtype), f.padded * befores[k], f.b)
                to, of = (column, lane) if back else (lane, column)
                for i in code.range(f.m):
                    to[i] = of[i]

    def _state(self, f: Frame, name: str = "state") -> list[WordArray]:
        """Return where the fields of the state lie, or those of stored starts."""
        if not self.has_lanes:
            return [getattr(f, f"{name}_{k}") for k in range(len(self.fields))]
        lanes = f.state if name == "state" else f.starts
        return [lanes.behind(k * self.size) for k in range(len(self.fields))]

    def _words(self, f: Frame, i: Value, name: str = "state") -> list[Value]:
        """Return the words of a slot's state, or of its stored start."""
        columns = zip(self._state(f, name), self.fields, strict=True)
        return [column[i].to(numba_type(field.dtype)) for column, field in columns]

    # The start of an episode.

    def _with_keys(self, code: Code, frame: Frame, kernel: Kernel, draws: range) -> Frame:
        """Make the keys of some draws, which are the same for all slots."""
        if not draws:
            return frame
        frame = frame.with_(**{name: kernel[name].to(types.int64) for name in ("seed_0", "seed_1", "tick")})
        code.run(self.make_keys, frame, draws)
        return frame

    def make_keys(self, code: Code, f: Frame, draws: range) -> None:
        """Make the two keys of each of some draws."""
        seed = f.seed_0.to(types.uint32), f.seed_1.to(types.uint32), f.tick.to(types.uint64)
        for d in code.range(draws.start, draws.stop):
            for k, chain in enumerate((rng.CHAIN_A, rng.CHAIN_B)):
                chain_word = code.word(types.uint32, chain)
                f.keys[d * 2 + k] = code.inline(rng.key, chain_word, *seed, d.to(types.uint32))

    def _draw(self, code: Code, f: Frame, draws: range) -> None:
        """Make some draws of all slots of a block."""
        if draws:
            code.run(self.make_draws, f, draws)

    def make_draws(self, code: Code, f: Frame, draws: range) -> None:
        """Make some draws of all slots of a block, if there are any."""
        for d in code.range(draws.start, draws.stop):
            key_a, key_b = f.keys[d * 2], f.keys[d * 2 + 1]
            for i in code.range(f.m):
                slot = (f.slot_0 + i).to(types.uint32)
                f.draws[d * self.size + i] = code.inline(rng.draw, slot, key_a, key_b)

    def _draws(self, f: Frame, i: Value, draws: range) -> list[Value]:
        """Return some draws of a slot."""
        return [f.draws.behind(self.size * d)[i] for d in draws]

    def _start_over(self, code: Code, f: Frame) -> None:
        """Start an episode in the slots of a block that are ``over``."""
        if self.has_lanes:
            for i in code.range(f.m):
                with code.when(f.over[i]):
                    code.run(self.start_one, f.with_(i=i))
            return
        with code.either(f.use_stored) as (stored, fresh):
            with stored:
                code.run(self.start_all, f, True)
            with fresh:
                self._draw(code, f, self.reset_draws)
                code.run(self.start_all, f, False)

    def start_all(self, code: Code, f: Frame, stored: bool) -> None:
        """Start the slots that are ``over``, as it is stored or afresh."""
        for i in code.range(f.m):
            if stored:
                words = self._words(f, i, "start")
            else:
                words = self._call(code, "initial", self._draws(f, i, self.reset_draws))
            over = f.over[i]  # no branch: the loop would stay scalar
            for column, word in zip(self._state(f), words, strict=True):
                column[i] = code.choose(column.type, over, word, column[i])

    def start_one(self, code: Code, f: Frame) -> None:
        """Start slot ``i``."""
        with code.either(f.use_stored) as (stored, fresh):
            with stored:
                code.run(self.write_start, f, True)
            with fresh:
                code.run(self.write_start, f, False)

    def write_start(self, code: Code, f: Frame, stored: bool) -> None:
        """Write the state that slot ``i`` starts in, as it is stored or afresh."""
        if stored:
            words = self._words(f, f.i, "start")
        else:
            slot = (f.slot_0 + f.i).to(types.uint32)
            draws = [code.inline(rng.draw, slot, f.keys[2 * d], f.keys[2 * d + 1]) for d in self.reset_draws]
            words = self._call(code, "initial", draws)
        for column, word in zip(self._state(f), words, strict=True):
            column[f.i] = word

    def forget(self, code: Code, f: Frame) -> None:
        """Forget the last episode of slot ``i``."""
        f.elapsed[f.i] = 0
        if self.agents > 1:
            f.ended[f.i] = 0

    def forget_all(self, code: Code, f: Frame, name: str) -> None:
        """Forget the last episode in a column, ``ended`` or ``elapsed``, where a slot is ``over``."""
        column = getattr(f, name)
        for i in code.range(f.m):
            column[i] = code.choose(column.type, f.over[i], 0, column[i])

    def _restart(self, code: Code, f: Frame, count: Value) -> None:
        """Start over the slots that are ``over``: one by one where they are few, else all at once."""
        with code.when(f.next_step.equals(0)), code.when(count):
            if self.one_by_one:
                self._restart_few(code, f)
                return
            with code.either(count < self.few) as (few, many):
                with few:
                    self._restart_few(code, f)
                with many:
                    code.run(self.keep_all_last, f)
                    self._start_over(code, f)
                    code.run(self.forget_all, f, "elapsed")
                    self._observe(code, f)

    def _restart_few(self, code: Code, f: Frame) -> None:
        found = code.variable(code.word(types.int64, 0))
        for i in self._flagged(code, f.over):
            f.ended_slots[found[0]] = i
            found[0] = found[0] + f.over[i].to(types.int64)
        count = found[0]
        if self.one_by_one:
            for j in code.range(count):
                code.run(self.fetch_last, f.with_(i=f.ended_slots[j].to(types.int64)))
        for j in code.range(count):
            one = f.with_(i=f.ended_slots[j].to(types.int64))
            code.run(self.keep_last, one)
            code.run(self.start_one, one)
            code.run(self.forget, one)
            self._observe_start(code, one)

    def fetch_last(self, code: Code, f: Frame) -> None:
        """Ask for the memory of what slot ``i`` sees last."""
        f.final_observations.prefetch(f.i * self.whole, self.whole)

    def keep_last(self, code: Code, f: Frame) -> None:
        """Keep what slot ``i`` sees last."""
        if self.one_by_one:
            f.final_observations.copy(f.observations, f.i * self.whole, self.whole)
            return
        for e in range(self.row):
            at = _at(f.i, self.row, e)
            f.final_observations[at] = f.observations[at]

    def keep_all_last(self, code: Code, f: Frame) -> None:
        """Keep what all slots see, as if it were the last."""
        for i in code.range(f.m):
            self.keep_last(code, f.with_(i=i))

    # A step.

    def golden_step(self, code: Code, f: Frame) -> None:
        """Step all slots of a block."""
        fields = self.spec.action_fields
        for i in code.range(f.m):
            state, count = self._words(f, i), self.agents * len(fields)
            actions = [
                f.actions[_at(i, count, k)].to(numba_type(field.dtype))
                for k, field in enumerate(self.agents * fields)
            ]
            words = [*state, *actions, *self._draws(f, i, self.step_draws)]
            results = tuple(self._call(code, "golden_step", words))
            for k, column in enumerate(self._state(f)):
                column[i] = results[k]
            codes, ends = results[-2 * self.agents : -self.agents], results[-self.agents :]
            for k in range(self.agents):
                f.codes[_at(i, self.agents, k)] = codes[k]
            for k in range(self.agents):
                f.terminations[_at(i, self.agents, k)] = ends[k]

    def rewards(self, code: Code, f: Frame) -> None:
        """Make rewards of their codes."""
        field, count = self.spec.reward, 1 << self.spec.reward.bits
        are_few = self.spec.rewards is not None and count <= MOST_REWARDS
        known = [f.table[k] for k in range(count)] if are_few else []
        for i in code.range(f.m * self.agents):
            if self.spec.rewards is None:
                reward = element(code, f.codes[i], field, np.dtype(np.float32))
            elif not known:
                reward = f.table[f.codes[i] & (count - 1)]
            else:
                reward = known[0]
                for k in range(1, count):
                    reward = code.choose(types.float32, f.codes[i].equals(k), known[k], reward)
            f.rewards[i] = reward

    def _call(self, code: Code, name: str, words: Iterable[Value]) -> Any:
        """Return what a golden function returns; many results in turn, each written when it is asked for."""
        results = code.inline(self.golden[name], *words)
        return (results,) if isinstance(results, Value) else results

    # What agents see.

    def _observe(self, code: Code, f: Frame) -> None:
        """Observe all slots of a block."""
        self._observe_range(code, f.with_(first=code.word(types.int64, 0), end=f.m))

    def _observe_range(self, code: Code, f: Frame) -> None:
        """Observe the slots from ``first`` to before ``end``."""
        whole = tuple(range(self.agents))
        only_masks = all(run.of_mask for run in self.runs)
        for agents in [(k,) for k in whole] if self.crowded else [whole]:
            own = f
            if self.takes_turns and self.observers[agents[0]] == self.observers[0]:
                own, agents = self._in_place_of_the_first(code, f, agents[0]), whole[:1]
            if self.runs:
                code.run(self.pack, own, agents, only_masks)
                code.run(self.write_packed, own, agents)
            if only_masks:
                self._run(code, self.observe_slots, own, agents)

    def _in_place_of_the_first(self, code: Code, f: Frame, agent: int) -> Frame:
        """Return a frame in which an agent is where the first one is, for the function that observes that."""
        order = self.orders[agent]
        before = self.orders[agent - 1] if agent else [None] * len(order)
        moved = [place for place, field in enumerate(order) if field != before[place]]
        places = (np.array(lanes, np.int64) * self.size for lanes in (moved, [order[k] for k in moved]))
        to, of = (code.table(column) for column in places)
        count = code.word(types.int64, len(moved))
        code.run(self.take_turns, f.with_(to=to, of=of, count=count))
        columns: dict[str, WordArray] = {"state": f.turns}
        for name, size in (("observations", self.row), ("action_masks", self.masks)):
            if name in f.named:
                column = getattr(f, name)
                columns[name] = column.view(column.type, 0, agent * size)
        for r in range(len(self.runs)):
            columns[f"run_0_{r}"] = getattr(f, f"run_{agent}_{r}")
        return f.with_(**columns)

    def take_turns(self, code: Code, f: Frame) -> None:
        """Put lanes to where the function of the first agent looks for them."""
        lane = numba_type(self.lane)
        for k in code.range(f.count):
            to, of = f.turns.view(lane, 0, f.to[k]), f.state.view(lane, 0, f.of[k])
            for i in code.range(f.first, f.end):
                to[i] = of[i]

    def _run(self, code: Code, function: Callable[..., None], f: Frame, *key: object) -> None:
        """Write a function that may call what Numba compiles, and is then part of the kernel."""
        if self.unpack is None:
            code.run(function, f, *key)
        else:
            function(code, f, *key)

    def pack(self, code: Code, f: Frame, agents: tuple[int, ...], only_masks: bool) -> None:
        """Pack what some agents see into words: the flags of a run each."""
        for i in code.range(f.first, f.end):
            state = self._words(f, i)
            for k in agents:
                own = () if only_masks else self._view(code, self.observers, state, k)
                words = itertools.chain(own, self._view(code, self.maskers, state, k))
                for r, run in enumerate(self.runs):
                    packed = next(words).to(numba_type(self.spec.agent_fields[run.word].dtype))
                    for bit, flag in enumerate(itertools.islice(words, run.size - 1), 1):
                        packed = packed | (flag.to(types.uint8) << bit)
                    getattr(f, f"run_{k}_{r}")[i] = packed

    def write_packed(self, code: Code, f: Frame, agents: tuple[int, ...]) -> None:
        """Write what has been packed."""
        for i in code.range(f.first, f.end):
            for k in agents:
                for r, run in enumerate(self.runs):
                    to, width = (f.action_masks, self.masks) if run.of_mask else (f.observations, self.row)
                    at = _at(i, self.agents * width, k * width + run.at)
                    word = getattr(f, f"run_{k}_{r}")[i]
                    if run.size > 1:
                        to.write_flags(at, word, run.size)
                    else:
                        dtype = np.dtype(np.int8) if run.of_mask else self.dtype
                        to[at] = element(code, word, self.spec.agent_fields[run.word], dtype)

    def observe_slots(self, code: Code, f: Frame, agents: tuple[int, ...]) -> None:
        """Write what some agents observe, apart from masks."""
        for i in code.range(f.first, f.end):
            state = self._words(f, i)
            for k in agents:
                row = i * self.agents + k
                if self.unpack is not None:
                    f.observations.prefetch((row + ROWS_AHEAD * self.agents) * self.row, self.row)
                self._write_row(code, f, row, self._view(code, self.observers, state, k))

    def _observe_start(self, code: Code, f: Frame) -> None:
        """Observe slot ``i``, which has just started."""
        if self.crowded and self.has_lanes:
            self._observe_range(code, f.with_(first=f.i, end=f.i + 1))
        else:
            self._run(code, self.observe_start, f)

    def observe_start(self, code: Code, f: Frame) -> None:
        """Observe slot ``i``, which has just started."""
        state = self._words(f, f.i)
        for k in range(self.agents):
            row = f.i * self.agents + k
            self._write_row(code, f, row, self._view(code, self.observers, state, k))
            self._write_masks(f, row, self._view(code, self.maskers, state, k))

    def deliver_rows(self, code: Code, f: Frame, alone: str = "") -> None:
        """Write what agents see, a row each, of words that come from elsewhere; no masks where ``alone``."""
        count = len(self.spec.observation)
        for i in code.range(f.m * (1 if alone else self.agents)):
            words = [
                getattr(f, f"word_{k}")[i] for k in range(count if alone else len(self.spec.agent_fields))
            ]
            self._write_row(code, f, i, words[:count])
            self._write_masks(f, i, words[count:])

    def _view(self, code: Code, names: Sequence[str], state: Sequence[Value], agent: int) -> Any:
        """Return the words that an agent observes, or of its masks, by functions of these names, if any."""
        order = self.orders[agent]
        return self._call(code, names[agent], [state[place] for place in order]) if names else ()

    def _write_row(self, code: Code, f: Frame, row: Value, words: Iterable[Value]) -> None:
        """Write the observation of an agent."""
        fields = self.spec.observation
        if self.unpack is not None:
            narrow = [word.to(numba_type(field.dtype)) for word, field in zip(words, fields, strict=True)]
            code.call_compiled(self.unpack, narrow, f.observations, row * self.row, self.row)
            return
        for e, (word, field) in enumerate(zip(words, fields, strict=True)):
            f.observations[_at(row, self.row, e)] = element(code, word, field, self.dtype)

    def _write_masks(self, f: Frame, row: Value, words: Iterable[Value]) -> None:
        for e, word in enumerate(words):
            f.action_masks[_at(row, self.masks, e)] = word

    def _blank(self, code: Code, f: Frame) -> None:
        """Blank what agents that have ended see; keep what those see that end now."""
        # Few slots have something to blank or to keep in most steps: eight that have not are one comparison.
        # SAME_STEP keeps what was seen last in an episode when it starts the next.
        self._clear(code, f.changed, f.m)
        code.run(self.ends.find_changed, f)
        for i in self._flagged(code, f.changed):
            with code.when(f.changed[i]):
                one = f.with_(i=i)
                with code.either(f.over[i]) as (over, not_over):
                    with over:
                        code.run(self.keep_last, one)
                    with not_over:
                        with code.when(f.end_bits[i].differs(f.end_bits_before[i])):
                            code.run(self.keep_last, one)
                        code.run(self.blank, one)

    def blank(self, code: Code, f: Frame) -> None:
        """Blank what agents of slot ``i`` see that have ended."""
        for k in range(self.agents):
            has_ended = self.ends.bit(f.end_bits[f.i], k)
            for array, size in (("observations", self.row), ("action_masks", self.masks)):
                start = f.i * (self.agents * size) + k * size
                # A loop would take longer for a few.
                for e in code.range(size) if size > LONG_ROW else range(size):
                    column = getattr(f, array)
                    column[start + e] = code.choose(column.type, has_ended, 0, column[start + e])

    # Flags of slots, a byte each.

    def _clear(self, code: Code, flags: WordArray, first: Value | int = 0) -> None:
        """Set flags to 0, up to the end of a block."""
        for i in code.range(first, self.size):
            flags[i] = 0

    def _flagged(self, code: Code, flags: WordArray) -> Iterator[Value]:
        """Write a loop over all slots of each eight of which some are flagged; yields a slot."""
        words = flags.view(types.uint64)
        for w in code.range(self.size // 8):
            with code.when(words[w]):
                yield from code.range(w * 8, w * 8 + 8)

    def _count(self, code: Code, flags: WordArray) -> Value:
        """Return how many slots of a block are flagged, by 1."""
        words, total = flags.view(types.uint64), code.variable(code.word(types.uint64, 0))
        for w in code.range(self.size // 8):
            total[0] = total[0] + words[w]
        # Eight sums, a byte each; then four of 16 bits, and the sum of these.
        even, sums = 0x00FF00FF00FF00FF, total[0]
        pairs = (sums & even) + (sums >> 8 & even)
        return pairs * 0x0001000100010001 >> 48


def _at(index: Value, size: int, offset: int) -> Value:
    """Return the place of an element in an array that has so many for each index."""
    return index if size == 1 else index * size + offset
