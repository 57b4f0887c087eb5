"""The source of the CPU's kernels: short loops over blocks of slots, around the golden functions."""

from __future__ import annotations

from typing import Any

import numpy as np

from pearl_marl import rng
from pearl_marl.batch import slot_memory
from pearl_marl.compiler import pieces
from pearl_marl.compiler.kernel_template import TEMPLATE
from pearl_marl.compiler.pieces import Pieces, assign, call, cell_dtype, each, indented, narrowed, start
from pearl_marl.compiler.straight_line import golden_functions
from pearl_marl.spec import EnvSpec

BLOCK = 2048
"""Slots of a block: what a loop touches then fits a 32 KiB L1 cache. A multiple of 64."""

CROWD = 16
"""Fields from which on a block's state is copied into *lanes*, parts of one array, and back. Of more than a
few arrays LLVM does not check whether they overlap, and leaves the loop scalar; parts of one it can tell."""

CROWDED_BLOCK = 512
"""Slots of a block where there is such a crowd; divides :data:`BLOCK`. Seaquest steps 40 M slots/s like this,
with its 44 arrays as they are 6 M."""

DRAW = "draw(u32(slot_0 + i), key_a{0}, key_b{0})"

MEMORIES = {"block": "memory", "stored": "stored"}
"""By the prefix of a block's words, what they are read from."""


def kernel_source(spec: EnvSpec) -> str:
    """Return the source of the kernels of ``spec``, for :mod:`pearl_marl.compiler.kernels` to load."""
    p = _BlockPieces(spec)
    given = each("given_{}", p.observation)
    words = {
        "NAME": spec.name,
        "BLOCK": str(p.size),
        "REWARD_DTYPE": str(spec.reward.dtype),
        "PADDED": p.padded,
        "ELAPSED": p.column("memory", p.elapsed),
        "ENDED": p.column("memory", p.ended),
        "CODES": part("code_words", spec.reward.dtype),
        "ACTIONS": part("actions", spec.action.dtype),
        "OBSERVED": p.rows("observations"),
        "FINAL": p.rows("final_observations"),
        "ALL_OBSERVED": f"{p.dtype}_column(observations, 0, observations.size)",
        "FEW": str(p.few),
        "GIVEN": ", ".join(given),
        "FIRST_GIVEN": given[0],
    }
    parts = {
        "golden_functions": golden_functions(spec),
        **(p.lanes() if p.crowded else p.columns()),
        **p.draws(),
        **p.rewards(),
        "golden_step": p.golden_step(),
        "start_over": p.start_over(),
        "observe": each_slot(*p.observe(p.read)),
        "restart": p.restart(),
        "copy_one": p.copy_one,
        "start_one": p.start_one(),
        "observe_one": p.observe(p.new),
        "given_parts": p.given_parts(),
        "deliver": p.deliver(each("given_{}[i]", p.observation)),
        "deliver_block": p.deliver(each("part_{}[i]", p.observation)),
    }
    return pieces.filled(TEMPLATE, words, parts)


def each_slot(*lines: str) -> list[str]:
    """Return a loop over the slots of a block."""
    return ["for i in range(m):", *indented(lines)]


def loops(lines: list[str]) -> list[str]:
    """Return such a loop for each line."""
    return [inner for line in lines for inner in each_slot(line)]


def part(array: str, dtype: np.dtype[Any], size: int = 1) -> str:
    """Return what belongs to the block of an array that has ``size`` elements a slot."""
    return f"{dtype}_column({array}, {dtype.itemsize * size} * b, {size} * m)"


class _BlockPieces(Pieces):
    """The pieces of loops over a block ``b``, of which a slot is ``i``."""

    def __init__(self, spec: EnvSpec) -> None:
        size, item = spec.observation_size, spec.observation_dtype.itemsize
        # A constant stride: LLVM does not vectorise over one that it only knows at run time.
        element = f"O[{size} * i + {{}}]" if size > 1 else "O[i]"
        super().__init__(spec, element, f"{cell_dtype(spec)}_column(O, {item * size} * i, {size})")
        flat = spec.unpack is None
        kept = each("F" + element[1:], range(len(spec.observation)))
        self.copy_one = assign(kept, each(element, range(len(spec.observation))))
        if not flat:
            self.copy_one = [f"for k in range({size} * i, {size} * (i + 1)):", "    F[k] = O[k]"]
        *self.fields, self.elapsed, self.ended = slot_memory.columns(spec)
        self.crowded = len(spec.state) > CROWD
        self.size = CROWDED_BLOCK if self.crowded else BLOCK
        # From about so many on, fewer where a start takes draws, SIMD code for all slots is faster. Not with
        # large observations, of which all would be made anew.
        self.few = self.size // (4 + 3 * spec.reset_draws) if flat else self.size + 1
        self.block, stored = each("block_{}[i]", self.state), each("stored_{}[i]", self.state)
        self.read, self.write = self.block, self.narrow
        if self.crowded:
            self.lane = np.dtype(np.uint64 if any(f.bits > 32 for f in spec.state) else np.uint32)
            self.read, stored = narrowed(spec.state, self.block), narrowed(spec.state, stored)
            self.write = each(f"np.{self.lane}({{}})", self.new)
        self.take = assign(self.new, stored)

    def rows(self, array: str) -> str:
        """Return what belongs to the block of an array of observations, as a flat array."""
        return part(array, self.dtype, self.spec.observation_size)

    def column(self, memory: str, column: slot_memory.Column) -> str:
        """Return what belongs to the block of a column."""
        at = f"p * {column.bytes_before} + {column.dtype.itemsize} * b"
        return f"{column.dtype}_column({memory}, {at}, m)"

    def given_parts(self) -> list[str]:
        """Return what finds the block's words of observations that a device delivered."""
        return [f"part_{f.name} = {part(f'given_{f.name}', f.dtype)}" for f in self.spec.observation]

    def columns(self) -> dict[str, list[str]]:
        """Return what finds a block's state where it lies."""
        block, stored = (
            [f"{prefix}_{field.name} = {self.column(memory, field)}" for field in self.fields]
            for prefix, memory in MEMORIES.items()
        )
        none: list[str] = []
        return {
            "load_block": block, "load_stored": stored, "store": none,
            "lane_functions": none, "block_lanes": none, "stored_lanes": none,
        }  # fmt: skip

    def lanes(self) -> dict[str, list[str]]:
        """Return what copies a block's state into lanes, and back."""
        size, item, count = self.size, self.lane.itemsize, len(self.fields)
        lanes = {
            prefix: [
                f"{prefix}s = np.empty({count * size}, np.{self.lane})",
                *(
                    f"{prefix}_{field.name} = {self.lane}_column({prefix}s, {k * size * item}, {size})"
                    for k, field in enumerate(self.fields)
                ),
            ]
            for prefix in MEMORIES
        }
        functions = [
            "@called",
            "def copied(target, source, m):",
            *indented(each_slot("target[i] = source[i]")),
        ]
        for name in ("load", "store"):
            functions += ["", "", "@called", f"def {name}(lanes, memory, p, b, m):"]
            for dtype in sorted({field.dtype for field in self.fields}, key=str):
                # Where a field's lane begins, and its column.
                places = tuple(
                    (k * size * item, field.bytes_before)
                    for k, field in enumerate(self.fields)
                    if field.dtype == dtype
                )
                pair = [
                    f"{self.lane}_column(lanes, lane, m)",
                    f"{dtype}_column(memory, p * before + {dtype.itemsize} * b, m)",
                ]
                first, second = pair if name == "load" else pair[::-1]
                functions.append(f"    for lane, before in {places}:")
                functions.append(f"        copied({first}, {second}, m)")
        return {
            "lane_functions": functions,
            "block_lanes": lanes["block"],
            "stored_lanes": lanes["stored"],
            "load_block": ["load(blocks, memory, p, b, m)"],
            "load_stored": ["if use_stored:", "    load(storeds, stored, p, b, m)"],
            "store": ["store(blocks, memory, p, b, m)"],
        }

    def draws(self) -> dict[str, list[str]]:
        """Return the scratch space of random draws, their keys, and what makes the step's."""
        scratch = f"draw_{{}} = np.empty({self.size}, np.uint32)"

        def keys(draws: range, tick: str) -> list[str]:
            chains = ("a", rng.CHAIN_A), ("b", rng.CHAIN_B)
            return [f"key_{side}{d} = {pieces.key(chain, tick, d)}" for d in draws for side, chain in chains]

        return {
            "reset_scratch": each(scratch, self.reset_draws),
            "step_scratch": each(scratch, self.step_draws),
            "reset_keys_now": keys(self.reset_draws, "tick"),
            "reset_keys": keys(self.reset_draws, "reset_tick"),
            "step_keys": keys(self.step_draws, "tick"),
            "step_keys_fixed": keys(self.step_draws, "0"),
            "draw_for_step": loops(each("draw_{0}[i] = " + DRAW, self.step_draws)),
        }

    def start_over(self) -> list[str]:
        """Return what starts an episode in the slots of the block that are flagged."""
        initial = call("initial", each("draw_{}[i]", self.reset_draws), self.new)
        draws = loops(each("draw_{0}[i] = " + DRAW, self.reset_draws))
        return start(self.choose(*self.take), [*draws, *self.choose(initial)])

    def start_one(self) -> list[str]:
        """Return what starts one in a single slot, and does not store it."""
        initial = call("initial", each("d{}", self.reset_draws), self.new)
        return start(self.take, [*each("d{0} = " + DRAW, self.reset_draws), initial])

    def choose(self, *sources: str) -> list[str]:
        """Return what stores new words where a slot is flagged."""
        if self.crowded:  # so many choices take long to compile, and few slots end
            return each_slot("if flag[i]:", *indented([*sources, *assign(self.block, self.write)]))
        # No `if`: LLVM would move the start into its branch, and the loop would stay scalar.
        chosen = (
            f"{f.dtype}_choose(c, {new}, {old})"
            for f, new, old in zip(self.spec.state, self.new, self.block, strict=True)
        )
        return each_slot("c = flag[i]", *sources, *assign(self.block, chosen))

    def restart(self) -> list[str]:
        """Return what starts over the slots that ended, which are listed."""
        store = [*assign(self.block, self.write), "E[i] = np.uint32(0)"]
        one = [*self.copy_one, *self.start_one(), *store, *self.observe(self.new)]
        each = ["for j in range(count):", *indented(["i = np.int64(ended_slots[j])", *one])]
        if self.spec.unpack is not None:
            return each
        at_once = [*each_slot(*self.copy_one), *self.start_over()]
        at_once += each_slot("E[i] = np.uint32(0) if flag[i] else E[i]")
        at_once += each_slot(*self.observe(self.read))
        return [f"if count < {self.few}:", *indented(each), "else:", *indented(at_once)]

    def golden_step(self) -> list[str]:
        """Return the loop over the golden step."""
        sources = [*self.read, "A[i]", *each("draw_{}[i]", self.step_draws)]
        step = call("golden_step", sources, [*self.new, "r", "t"])
        return each_slot(step, *assign([*self.block, "code[i]", "flag[i]"], [*self.write, "r", "t"]))

    def rewards(self) -> dict[str, list[str]]:
        """Return what makes rewards of their codes."""
        names = each("reward_{}", range(self.categories if self.categories <= 8 else 0))
        lines = [f"R[i] = {self.reward('code[i]', 'code[i]')}"]
        if names:  # a chain of blends; beyond that a gather costs less
            chain = (f"r = {name} if code[i] == {k} else r" for k, name in enumerate(names) if k)
            lines = [f"r = {names[0]}", *chain, "R[i] = r"]
        lookups = each("reward_{0} = table[{0}]", range(len(names)))
        return {"reward_names": lookups, "rewards": each_slot(*lines)}
