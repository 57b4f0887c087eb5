"""The pieces of the CPU's kernels where a state has many fields: they are copied into *lanes* by blocks.

Lanes are parts of one array. And since so many fields take long to compile, what does not become SIMD code
anyway, which is starting and observing a slot, is a function of its own.
"""

from __future__ import annotations

import numpy as np

from pearl_marl.compiler.block_pieces import DRAW, DRAWS, MEMORIES, BlockPieces, each_slot
from pearl_marl.compiler.pieces import assign, call, each, indented, narrowed, start
from pearl_marl.spec import EnvSpec


class LanePieces(BlockPieces):
    """The pieces of loops over the lanes of a block."""

    size = 512
    """Seaquest steps 40 M slots/s like this, with the arrays of its 41 fields as they are 6 M."""

    def __init__(self, spec: EnvSpec) -> None:
        super().__init__(spec)
        self.lane = np.dtype(np.uint64 if any(f.bits > 32 for f in spec.state) else np.uint32)
        self.words = narrowed(spec.state, self.block)
        self.written = each(f"np.{self.lane}({{}})", self.new)

    def columns(self) -> dict[str, list[str]]:
        """Return what copies a block's state into lanes and back."""
        block, stored = (self.space(f"{prefix}s", self.lane, len(self.fields)) for prefix in MEMORIES)
        return {
            "functions": [*self.copies(), *self.of_a_slot()],
            "block_lanes": [block, *self.lanes("block")],
            "stored_lanes": [stored],
            "load_block": ["load(blocks, memory, p, b, m)"],
            "load_stored": ["if use_stored:", "    load(storeds, stored, p, b, m)"],
            "store_block": ["store(blocks, memory, p, b, m)"],
        }

    def lanes(self, prefix: str) -> list[str]:
        """Return what finds the lane of each field in an array of them."""
        return [
            f"{prefix}_{field.name} = {self.lane}_column({prefix}s, 0, {k * self.size})"
            for k, field in enumerate(self.fields)
        ]

    def copies(self) -> list[str]:
        """Return the functions that copy a block's columns into lanes, and back."""
        lines = [
            "",
            "",
            "@called",
            "def copied(target, source, m):",
            *indented(each_slot("target[i] = source[i]")),
        ]
        for name in ("load", "store"):
            lines += ["", "", "@called", f"def {name}(lanes, memory, p, b, m):"]
            for dtype in sorted({field.dtype for field in self.fields}, key=str):
                places = [
                    (k * self.size, f.bytes_before) for k, f in enumerate(self.fields) if f.dtype == dtype
                ]
                pair = [
                    f"{self.lane}_column(lanes, 0, lane)",
                    f"{dtype}_column(memory, p * before, b)",
                ]
                to, of = pair if name == "load" else pair[::-1]
                lines += [f"    for lane, before in {tuple(places)}:", f"        copied({to}, {of}, m)"]
        return lines

    def of_a_slot(self) -> list[str]:
        """Return the functions that start a slot, and that observe it if it takes ``unpack``."""
        draws = each("d{}", self.reset_draws)
        take = assign(self.new, narrowed(self.spec.state, each("stored_{}[i]", self.state)))
        begin = [
            *self.lanes("block"),
            *self.lanes("stored"),
            *start(take, [call("initial", draws, self.new)]),
            *assign(self.block, self.written),
        ]
        lines = ["", "", "@called", f"def begin({', '.join(['blocks, storeds, i, use_stored', *draws])}):"]
        lines += indented(begin)
        if self.spec.unpack is not None:
            lines += ["", "", "@called_inline", "def show(blocks, O, i):"]
            lines += indented([*self.lanes("block"), *self.observe(self.words)])
        return lines

    def begin(self, draws: list[str]) -> str:
        """Return the call that starts a slot."""
        return f"begin({', '.join(['blocks, storeds, i, use_stored', *draws])})"

    def start_over(self) -> list[str]:
        """Return what starts an episode in the slots of the block that are flagged."""
        begin = self.begin(each("draw_{}[i]", self.reset_draws))
        return [*each(DRAWS, self.reset_draws), *each_slot("if flag[i]:", *indented([begin]))]

    def start_one(self) -> list[str]:
        """Return what starts one in a single slot, and stores it."""
        return [*each("d{0} = " + DRAW, self.reset_draws), self.begin(each("d{}", self.reset_draws))]

    def store_one(self) -> list[str]:
        """Return nothing, since a slot that starts is stored."""
        return []

    def observed(self) -> list[str]:
        """Return what observes a slot of the block."""
        return self.observe(self.words) if self.spec.unpack is None else ["show(blocks, O, i)"]

    def observed_start(self) -> list[str]:
        """Return what observes a slot that has just started."""
        return self.observed()

    def golden_step(self) -> list[str]:
        """Return the loop over the golden step."""
        sources = [*self.words, "A[i]", *each("draw_{}[i]", self.step_draws)]
        step = call("golden_step", sources, [*self.new, "r", "t"])
        return each_slot(step, *assign([*self.block, "code[i]", "flag[i]"], [*self.written, "r", "t"]))
