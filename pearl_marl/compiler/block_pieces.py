"""The pieces of the CPU's kernels: loops over blocks of slots, whose state is worked on where it lies."""

from __future__ import annotations

from typing import Any

import numpy as np

from pearl_marl import rng
from pearl_marl.batch import slot_memory
from pearl_marl.compiler import pieces
from pearl_marl.compiler.pieces import Pieces, assign, call, cell_dtype, each, indented, start
from pearl_marl.spec import EnvSpec

BLOCK = 2048
"""Slots of a block: what a loop touches then fits a 32 KiB L1 cache. A multiple of 64."""

DRAW = "draw(u32(slot_0 + i), key_a{0}, key_b{0})"
DRAWS = "draws(draw_{0}, slot_0, key_a{0}, key_b{0}, m)"

MEMORIES = {"block": "memory", "stored": "stored"}
"""By the prefix of a block's words, what they are read from."""


def each_slot(*lines: str) -> list[str]:
    """Return a loop over the slots of a block."""
    return ["for i in range(m):", *indented(lines)]


def part(array: str, dtype: np.dtype[Any], size: int = 1) -> str:
    """Return what belongs to the block of an array that has ``size`` elements a slot."""
    return f"{dtype}_column({array}, 0, {f'{size} * b' if size > 1 else 'b'})"


class BlockPieces(Pieces):
    """The pieces of loops over a block ``b``, of which a slot is ``i``."""

    size = BLOCK

    def __init__(self, spec: EnvSpec) -> None:
        size = spec.observation_size
        # A constant stride: LLVM does not vectorise over one that it only knows at run time.
        element = f"O[{size} * i + {{}}]" if size > 1 else "O[i]"
        super().__init__(spec, element, f"{cell_dtype(spec)}_row(O, {size} * i, {size})")
        flat = spec.unpack is None
        kept = each("F" + element[1:], range(len(spec.observation)))
        self.copy_one = assign(kept, each(element, range(len(spec.observation))))
        if not flat:
            self.copy_one = [f"for k in range({size} * i, {size} * (i + 1)):", "    F[k] = O[k]"]
        *self.fields, self.elapsed, self.ended = slot_memory.columns(spec)
        # From about so many on, fewer where a start takes draws, SIMD code for all slots is faster. Not with
        # large observations, of which all would be made anew.
        self.few = self.size // (4 + 3 * spec.reset_draws) if flat else self.size + 1
        self.block = each("block_{}[i]", self.state)
        self.taken = 0
        self.take = assign(self.new, each("stored_{}[i]", self.state))

    def rows(self, array: str) -> str:
        """Return what belongs to the block of an array of observations, as a flat array."""
        return part(array, self.dtype, self.spec.observation_size)

    def column(self, memory: str, column: slot_memory.Column) -> str:
        """Return what belongs to the block of a column."""
        return f"{column.dtype}_column({memory}, p * {column.bytes_before}, b)"

    def space(self, name: str, dtype: np.dtype[Any] | str, words: int = 1) -> str:
        """Return what finds so many words a slot in the scratch space, where nothing else is kept."""
        start, bytes_each = self.taken, np.dtype(dtype).itemsize
        self.taken += slot_memory.padded(self.size * words * bytes_each)
        return f"{name} = {dtype}_column(space, {start}, 0)"

    def given_parts(self) -> list[str]:
        """Return what finds the block's words of observations that a device delivered."""
        return [f"part_{f.name} = {part(f'given_{f.name}', f.dtype)}" for f in self.spec.observation]

    def columns(self) -> dict[str, list[str]]:
        """Return what finds a block's state."""
        block, stored = (
            [f"{prefix}_{field.name} = {self.column(memory, field)}" for field in self.fields]
            for prefix, memory in MEMORIES.items()
        )
        none: list[str] = []
        return {
            "functions": none, "block_lanes": none, "stored_lanes": none,
            "load_block": block, "load_stored": stored, "store_block": none,
        }  # fmt: skip

    def draws(self) -> dict[str, list[str]]:
        """Return the scratch space of random draws, their keys, and what makes the step's."""

        def keys(draws: range, tick: str) -> list[str]:
            chains = ("a", rng.CHAIN_A), ("b", rng.CHAIN_B)
            return [f"key_{side}{d} = {pieces.key(chain, tick, d)}" for d in draws for side, chain in chains]

        return {
            "reset_scratch": [self.space(f"draw_{d}", "uint32") for d in self.reset_draws],
            "step_scratch": [self.space(f"draw_{d}", "uint32") for d in self.step_draws],
            "reset_keys_now": keys(self.reset_draws, "tick"),
            "reset_keys": keys(self.reset_draws, "reset_tick"),
            "step_keys": keys(self.step_draws, "tick"),
            "step_keys_fixed": keys(self.step_draws, "0"),
            "draw_for_step": each(DRAWS, self.step_draws),
        }

    def start_over(self) -> list[str]:
        """Return what starts an episode in the slots of the block that are flagged."""
        initial = call("initial", each("draw_{}[i]", self.reset_draws), self.new)
        draws = each(DRAWS, self.reset_draws)
        return start(self.choose(*self.take), [*draws, *self.choose(initial)])

    def start_one(self) -> list[str]:
        """Return what starts one in a single slot, and does not store it."""
        initial = call("initial", each("d{}", self.reset_draws), self.new)
        return start(self.take, [*each("d{0} = " + DRAW, self.reset_draws), initial])

    def choose(self, *sources: str) -> list[str]:
        """Return what stores new words where a slot is flagged."""
        # No `if`: LLVM would move the start into its branch, and the loop would stay scalar.
        chosen = (
            f"{f.dtype}_choose(c, {new}, {old})"
            for f, new, old in zip(self.spec.state, self.new, self.block, strict=True)
        )
        return each_slot("c = flag[i]", *sources, *assign(self.block, chosen))

    def observed(self) -> list[str]:
        """Return what observes a slot of the block."""
        return self.observe(self.block)

    def observed_start(self) -> list[str]:
        """Return what observes a slot that has just started."""
        return self.observe(self.new)

    def store_one(self) -> list[str]:
        """Return what stores the start of a single slot."""
        return assign(self.block, self.narrow)

    def restart(self) -> list[str]:
        """Return what starts over the slots that ended, which are listed."""
        store = [*self.store_one(), "E[i] = np.uint32(0)"]
        one = [*self.copy_one, *self.start_one(), *store, *self.observed_start()]
        each = ["for j in range(count):", *indented(["i = np.int64(ended_slots[j])", *one])]
        if self.spec.unpack is not None:
            return each
        at_once = [*each_slot(*self.copy_one), *self.start_over()]
        at_once += each_slot("E[i] = np.uint32(0) if flag[i] else E[i]")
        at_once += each_slot(*self.observed())
        return [f"if count < {self.few}:", *indented(each), "else:", *indented(at_once)]

    def golden_step(self) -> list[str]:
        """Return the loop over the golden step."""
        sources = [*self.block, "A[i]", *each("draw_{}[i]", self.step_draws)]
        results = [*self.new, "r", "t"]
        return each_slot(
            call("golden_step", sources, results), *assign([*self.block, "code[i]", "flag[i]"], results)
        )

    def rewards(self) -> dict[str, list[str]]:
        """Return what makes rewards of their codes."""
        names = each("reward_{}", range(self.categories if self.categories <= 8 else 0))
        lines = [f"R[i] = {self.reward('code[i]', 'code[i]')}"]
        if names:  # a chain of blends; beyond that a gather costs less
            chain = (f"r = {name} if code[i] == {k} else r" for k, name in enumerate(names) if k)
            lines = [f"r = {names[0]}", *chain, "R[i] = r"]
        lookups = each("reward_{0} = table[{0}]", range(len(names)))
        return {"reward_names": lookups, "rewards": each_slot(*lines)}
