"""The pieces of the CPU's kernels where a state has many fields: they are copied into *lanes* by blocks.

Lanes are parts of one array. And since so many fields take long to compile, what does not become SIMD code
anyway, which is starting and observing a slot, is a function of its own.
"""

from __future__ import annotations

import numpy as np

from pearl_marl.compiler.block_pieces import BlockPieces, each_slot
from pearl_marl.compiler.pieces import assign, call, each, indented, narrowed, start
from pearl_marl.spec import EnvSpec


class LanePieces(BlockPieces):
    """The pieces of loops over the lanes of a block."""

    size = 512
    """Seaquest steps 40 M slots/s like this, with the arrays of its 41 fields as they are 6 M."""

    def __init__(self, spec: EnvSpec, counter: str) -> None:
        self.lane = np.dtype(f"uint{8 * max(field.dtype.itemsize for field in spec.state)}")
        super().__init__(spec, counter)
        self.show = "show(blocks, O, M, i)" if spec.mask_fields else "show(blocks, O, i)"
        self.loaded = narrowed(spec.state, self.block)
        self.written = each(f"np.{self.lane}({{}})", self.new)

    def words(self) -> dict[str, str]:
        """Return where the words of the state lie: in lanes."""
        return {
            f"{prefix}_{field.name}": f"{self.lane}_column({prefix}s, 0, {k * self.size})"
            for prefix in ("block", "stored")
            for k, field in enumerate(self.fields)
        }

    def columns(self) -> dict[str, list[str]]:
        """Return what copies a block's state into lanes and back."""
        return {
            "load_block": ["load(blocks, memory, p, b, m)"],
            "load_stored": ["if use_stored:", "    load(storeds, stored, p, b, m)"],
            "store_block": ["store(blocks, memory, p, b, m)"],
        }

    def spaces(self) -> dict[str, int]:
        """Return the bytes of each scratch space."""
        lanes = self.lane.itemsize * self.size * len(self.fields)
        return super().spaces() | {"blocks": lanes, "storeds": lanes}

    def compiled(self) -> list[str]:
        """Return the functions that copy, start and observe slots."""
        lines = [*self.copies("load"), *self.copies("store")]
        lines += ["", "", "@called", f"def {self.begin}:", *indented(self.begun())]
        if not self.flat:
            lines += ["", "", "@called_inline", f"def {self.show}:", *indented(self.shown())]
        return lines

    def copies(self, name: str) -> list[str]:
        """Return the function that copies a block's columns into lanes, or back."""
        lines, loops = [], []
        for dtype in sorted({field.dtype for field in self.fields}, key=str):
            fields = [(k * self.size, f.bytes_before) for k, f in enumerate(self.fields) if f.dtype == dtype]
            lanes, before = (f"{table}_{dtype}" for table in ("LANES", "BEFORE"))
            if name == "load":
                lines += [f"{lanes} = np.array({[lane for lane, _ in fields]}, np.int64)"]
                lines += [f"{before} = np.array({[before for _, before in fields]}, np.int64)"]
            lane = f"{self.lane}_column(lanes, 0, {lanes}[k])"
            column = f"{dtype}_column(memory, p * {before}[k], b)"
            to, of = (lane, column) if name == "load" else (column, lane)
            inside = [f"to = {to}", f"of = {of}", *each_slot("to[i] = of[i]")]
            loops += [f"for k in range({len(fields)}):", *indented(inside)]
        return [*lines, "", "", "@inlined", f"def {name}(lanes, memory, p, b, m):", *indented(loops)]

    begin = "begin(blocks, storeds, space, slot_0, i, use_stored)"

    def begun(self) -> list[str]:
        """Return what starts a slot, and stores it."""
        fresh = [*self.draw_one(), call("initial", each("d{}", self.reset_draws), self.new)]
        stored = assign(self.new, narrowed(self.spec.state, each("stored_{}[i]", self.state)))
        store = assign(self.block, self.written)
        return start(
            self.apart("start_stored", [*stored, *store]), self.apart("start_fresh", [*fresh, *store])
        )

    def shown(self) -> list[str]:
        """Return what observes a slot by ``unpack``."""
        lines, observed = [], each("observed_{}", self.seen)
        for k in range(self.agents):
            looks = [*self.look(self.loaded, k), *self.judge(self.loaded, k)]
            lines += self.apart(f"see_{k}", looks, observed)
            lines += [*self.deliver(observed, k), *self.masks(observed, k)]
        return lines

    def start_over(self) -> list[str]:
        """Return what starts an episode in the slots of the block that are flagged."""
        return each_slot("if flag[i]:", f"    {self.begin}")

    def start_one(self) -> list[str]:
        """Return what starts one in a single slot, and stores it."""
        return [self.begin]

    def store_one(self) -> list[str]:
        """Return what a slot that started has yet to store."""
        return self.apart("reset_one", self.forget_one)

    def observed(self) -> list[str]:
        """Return what observes all slots of a block."""
        return self.seen_in(self.loaded) if self.flat else self.over_slots("observe_all", self.show)

    def observed_start(self) -> list[str]:
        """Return what observes a slot that has just started."""
        if self.flat and self.crowded:
            return ["first = i", "end = i + 1", *self.see(self.loaded)]
        return self.apart("observe_start", self.observe(self.loaded) if self.flat else [self.show])

    def golden_step(self) -> list[str]:
        """Return the loop over the golden step."""
        return self.stepped(self.loaded, self.written)
