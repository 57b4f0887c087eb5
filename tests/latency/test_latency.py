"""The latency model against the simulated hardware, and `pearl plan`."""

from __future__ import annotations

import dataclasses
import importlib
import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pearl_marl import get_spec
from pearl_marl.batch.actions import random_actions
from pearl_marl.benchmark.paper import TABLE_2
from pearl_marl.devices import BatchConfig, Rtl
from pearl_marl.errors import ArgumentError
from pearl_marl.hardware import elaboration
from pearl_marl.hardware.elaboration import clocked, core_timing
from pearl_marl.hardware.fitting import PARTS, modelled_bram36, modelled_dsp
from pearl_marl.hardware.synthesis import DesignMemory, Family, Usage
from pearl_marl.latency import (
    LINKS,
    HostTimes,
    Link,
    axi_cycles,
    draws_wait,
    loop_cycles,
    measure_host,
    planning,
    predict,
    step_cycles,
)
from pearl_marl.latency.cycles import TRANSFER_WAIT, read_cycles, transfer_cycles, write_cycles
from pearl_marl.latency.host import ENDING, NoHardware
from pearl_marl.latency.prediction import Overlap
from pearl_marl.memory_map import DATA_WIDTHS, memory_map

from ..rtl.shift_add import SPEC as SHIFT_ADD

figure6, paper_builds, pipeline = (
    importlib.import_module(f"pearl_marl.experiments.{name}")
    for name in ("figure6", "paper_builds", "pipeline")
)

SPEC = get_spec("CliffWalking")


@pytest.mark.parametrize(
    ("spec", "size", "pipelined"),
    [
        (SPEC, (7, 4, 32), True),
        (SPEC, (7, 3, 128), True),
        (get_spec("Blackjack"), (70, 3, 32), True),
        (SHIFT_ADD, (23, 5, 64), True),  # four cycles a slot; it waits for its draws
        (SPEC, (7, 1, 32), False),
        (SHIFT_ADD, (23, 5, 64), False),
    ],
    ids=lambda value: getattr(value, "name", None),
)
def test_clock_cycles_over_axi(spec: Any, size: tuple[int, int, int], pipelined: bool) -> None:
    """Other builds: experiments/latency_model.py."""
    n, pe_num, data_wl = size
    device = Rtl(pe_num, data_wl, path="axi", pipelined=pipelined).open(BatchConfig(spec=spec, n_envs=n))
    device.reset(seed=0)
    rng = np.random.default_rng(0)
    device.step(random_actions(spec, rng, n))  # writes the settings too
    layout = memory_map(spec, *size)
    for _ in range(3):
        began = device.clock
        device.step(random_actions(spec, rng, n))
        assert device.cycles == step_cycles(spec, layout, pipelined) + draws_wait(spec, layout)
        assert device.clock - began == axi_cycles(spec, layout, pipelined)
    device.close()


def test_queued_bursts_of_any_length_take_as_long() -> None:
    layout = memory_map(SPEC, 43008, 128, 32)
    assert write_cycles(layout) == layout.step_write[1] // 4 + TRANSFER_WAIT
    assert read_cycles(memory_map(SPEC, 70, 3, 32)) == TRANSFER_WAIT + 14 + 5 + 3 + 3


@pytest.mark.parametrize(
    ("start", "length", "burst", "bursts"),
    [
        (0, 4096, 4096, 4),  # a burst has 256 beats at most
        (0, 4096, 512, 8),
        (0, 4096, 256, 16),
        (128, 512, 256, 3),
        (4000, 200, 4096, 2),  # and does not cross a multiple of 4 KiB
        (0, 0, 256, 0),
    ],
)
def test_bursts_one_at_a_time_wait_for_each_answer(start: int, length: int, burst: int, bursts: int) -> None:
    assert transfer_cycles(start, length, 4, burst) == length // 4 + bursts * TRANSFER_WAIT


def test_a_link_that_does_not_queue_is_predicted_by_its_bursts() -> None:
    layout = memory_map(SPEC, 43008, 64, 256)
    link = Link("fast", 0.0, 1e12, 1e12, "")
    times = [predict(SPEC, layout, link, HOST, 125e6, burst=burst) for burst in (None, 4096, 512, 256)]
    assert [step.read for step in times] == sorted(step.read for step in times)
    assert times[3].read == pytest.approx(read_cycles(layout, 256) / 125e6)
    assert times[3].write == pytest.approx(write_cycles(layout, 256) / 125e6)


def test_the_papers_loops() -> None:
    """43,008 slots by Eq. 2 and 3: 84 words of actions in; 252, 42 and 84 of results out; 2 cycles a slot."""
    loop = loop_cycles(SPEC, memory_map(SPEC, 43008, 256, 1024))
    assert loop.serial == 84 + 252 + 42 + 84 + 2 * 43008
    assert loop.parallel == 84 + 252 + 42 + 84 + 2
    assert loop.ours == 271, "as measured: docs/hardware.md"


def test_what_is_measured_of_the_host_has_ends_in_it() -> None:
    device = NoHardware().open(BatchConfig(spec=SPEC, n_envs=1000))
    device.reset(seed=0)
    step = device.step(np.zeros(1000, np.uint8))
    assert np.flatnonzero(step.terminations).tolist() == list(range(0, 1000, ENDING))
    assert not step.truncations.any()
    assert (step.obs[step.ended] == 36).all(), "new episodes begin"
    device.close()
    times = measure_host(SPEC, 1000, rounds=5)
    assert 0 < times.pack < 0.1
    assert 0 < times.unpack < 0.1


def test_the_host_is_measured_with_actions_that_masks_allow() -> None:
    """Where agents of one table have unlike masks from the first step on."""
    times = measure_host(get_spec("LeducPoker"), 64, rounds=2)
    assert min(times) > 0


HOST = HostTimes(pack=10e-6, unpack=40e-6)

TARGET = clocked("xc7", 100.0)
C = core_timing(SPEC, TARGET).latency


def test_a_prediction() -> None:
    layout = memory_map(SPEC, 43008, 64, 256)
    step = predict(SPEC, layout, Link("mine", 20e-6, 2e9, 1e9, ""), HOST, 100e6)
    # Actions of 10,752 bytes, and a word of doorbell; results of 48,384, and a word of status.
    assert step.write == pytest.approx(20e-6 + 10_784 / 2e9)
    assert step.read == pytest.approx(20e-6 + 48_416 / 1e9)
    assert step.device == pytest.approx(step_cycles(SPEC, layout, target=TARGET) / 100e6)
    assert (step.words_in, step.words_out) == pytest.approx((336 / 100e6, 1008 / 100e6))
    assert step.compute == pytest.approx((671 + C) / 100e6)
    assert max(step.words_in, step.compute, step.words_out) < step.device
    assert step.total == pytest.approx(step.pack + step.write + step.device + step.read + step.unpack)
    assert step.rate == pytest.approx(43008 / step.total)
    assert step.bottleneck == "read"


def test_a_prediction_without_the_pipeline() -> None:
    layout, link = memory_map(SPEC, 43008, 1, 256), Link("mine", 20e-6, 2e9, 1e9, "")
    step = predict(SPEC, layout, link, HOST, 100e6, pipelined=False)
    # And states of 32,256 bytes each way.
    assert step.write == pytest.approx(20e-6 + 43_040 / 2e9)
    assert step.read == pytest.approx(20e-6 + 80_672 / 1e9)
    assert step.compute == pytest.approx(43008 * C / 100e6)
    assert step.device == pytest.approx(step_cycles(SPEC, layout, pipelined=False, target=TARGET) / 100e6)
    # c_r, c_c and c_w of a slot, as Eq. 2 has them; and a step's constant cycles.
    assert 43008 * (4 + C + 2) <= step.device * 100e6 <= 43008 * (4 + C + 2) + 14
    # The same on a port that is slower than the link.
    fast = predict(SPEC, layout, Link("fast", 0.0, 1e12, 1e12, ""), HOST, 100e6, pipelined=False)
    assert fast.write == pytest.approx((write_cycles(layout) + 1008 + TRANSFER_WAIT) / 100e6)
    assert fast.read == pytest.approx((read_cycles(layout) + 1008 + TRANSFER_WAIT) / 100e6)


def test_with_and_without_the_pipeline(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pipeline, "measure_host", lambda spec, n: HOST)
    found = pipeline.compare("CliffWalking")
    assert (found.pipelined.n_envs, found.pipelined.pe_num, found.serial.pe_num) == (43008, 256, 1)
    assert found.factor == pytest.approx(found.serial.total / found.pipelined.total)
    assert found.factor > 2.7, "the least of the paper's"
    rate = pipeline.simulated_rate(SPEC, 70, 1, 32, 100e6, pipelined=False)
    assert rate == pytest.approx(70 * 100e6 / 573), "docs/latency.md has it measured"


@pytest.mark.usefixtures("quick_host")
def test_builds_of_table_2_that_do_not_fit_are_marked(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """By what synthesis made of them: every factor of theirs says so, in the table and in the report."""
    monkeypatch.setattr(pipeline, "measure_host", lambda spec, n: HOST)
    monkeypatch.setattr(elaboration, "core_timing", lambda *_: elaboration.Timing(40, 1))
    part, known, marks = PARTS["vc707"], json.loads(paper_builds.FILE.read_text()), {}
    for name in TABLE_2:
        verdict = paper_builds.verdict(paper_builds.build(name))
        marks[name] = f"{verdict.text} ({verdict.source})"
        if name in known:
            over = [what for what in paper_builds.RESOURCES if known[name][what] > getattr(part, what)]
            assert all(f"{known[name][what]:,} of {getattr(part, what):,} " in verdict.lacks for what in over)
            assert verdict.text == (f"does not fit: {verdict.lacks}" if over else "fits")
            assert verdict.source.startswith("synthesised 20")
    assert re.fullmatch(r"does not fit: .*6,662 of 2,800 DSP \(.*\)", marks["Blackjack"])
    assert all(re.fullmatch(r"fits \(synthesised .*\)", marks[name]) for name in ("CartPole", "Seaquest"))
    pipeline.main()
    rows = capsys.readouterr().out.splitlines()[2:]
    assert [row.split(" | ")[-1].removesuffix(" |") for row in rows] == list(marks.values())
    ours, serial = figure6.compared("Blackjack")
    assert ours["over_no_pipeline"] > 1
    assert ours["contender"].endswith("with pipeline, does not fit")
    assert f"on a VC707: {marks['Blackjack']}" in ours["counts"]
    assert "does not fit" not in serial["contender"]
    few = paper_builds.verdict(paper_builds.build("Blackjack", 1024))
    assert (few.lacks, few.source) == ("6,662 of 2,800 DSP", "not synthesised")
    assert paper_builds.verdict(paper_builds.build("CartPole", 1024)).text == "memories and multipliers fit"


def test_the_model_of_multipliers_is_what_yosys_made() -> None:
    for name, made in json.loads(paper_builds.FILE.read_text()).items():
        assert modelled_dsp(get_spec(name), Family.XC7.target)(made["pe_num"]) == made["dsp"], name


def test_the_papers_builds_have_as_many_slots_as_fit() -> None:
    spec, layout = paper_builds.build("Seaquest")
    assert modelled_bram36(layout) <= 1030
    assert modelled_bram36(memory_map(spec, layout.n_envs + 1024, 16, 1024)) > 1030


def test_a_core_is_predicted_for_its_clock() -> None:
    spec = get_spec("MountainCar")
    slow, fast = (
        predict(spec, memory_map(spec, 1, 1, 32), LINKS["gen2x8"], HOST, mhz * 1e6) for mhz in (20, 200)
    )
    cycles = [round(step.compute * mhz * 1e6) for step, mhz in ((slow, 20), (fast, 200))]
    assert cycles == [core_timing(spec, clocked("xc7", mhz)).latency for mhz in (20, 200)]
    assert cycles[0] < cycles[1]


def test_a_link_is_no_faster_than_the_port_behind_it() -> None:
    layout = memory_map(SPEC, 4096, 8, 32)
    step = predict(SPEC, layout, Link("fast", 0.0, 1e12, 1e12, ""), HOST, 100e6)
    assert step.write == pytest.approx(write_cycles(layout) / 100e6)
    assert step.read == pytest.approx(read_cycles(layout) / 100e6)


@pytest.mark.parametrize(
    ("host", "busy", "total"),
    [
        (HostTimes(10e-6, 70e-6), "host", 160e-6),
        (HostTimes(1e-6, 1e-6), "link, reading", None),
        (HostTimes(20e-6, 20e-6), "round trip", None),
    ],
)
def test_two_half_batches(host: HostTimes, busy: str, total: float | None) -> None:
    read = 2e8 if busy == "link, reading" else 2.6e9
    half = predict(SPEC, memory_map(SPEC, 21504, 64, 256), Link("", 30e-6, 3.2e9, read, ""), host, 125e6)
    overlap = Overlap(half)
    assert overlap.bottleneck == busy
    assert overlap.total == pytest.approx(total or overlap.loads[busy])
    assert half.total <= overlap.total <= 2 * half.total
    assert overlap.rate == pytest.approx(43008 / overlap.total)


@pytest.mark.parametrize("values", [(-1.0, 1.0, 1.0), (0.0, 0.0, 1.0), (0.0, 1.0, float("nan"))])
def test_links_that_there_cannot_be(values: tuple[float, float, float]) -> None:
    with pytest.raises(ArgumentError, match="it must be positive"):
        Link("odd", *values, "")


@pytest.fixture
def quick_host(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(planning, "measure_host", lambda spec, n: HOST)
    monkeypatch.setattr(planning, "synthesised", lambda build: None)


@pytest.mark.usefixtures("quick_host")
def test_the_smallest_build_that_is_nearly_the_fastest() -> None:
    found = planning.plan(SPEC, 43008, LINKS["gen2x8"], 125e6)
    sizes = [1 << k for k in range(9)]
    best = min(
        predict(SPEC, memory_map(SPEC, 43008, size, width), LINKS["gen2x8"], HOST, 125e6).total
        for size in sizes
        for width in DATA_WIDTHS
    )
    assert found.chosen in found.candidates
    assert found.chosen.prediction.total <= planning.NEAR * best
    for candidate in found.candidates:
        if candidate.layout.pe_num < found.chosen.layout.pe_num:
            assert candidate.prediction.total > planning.NEAR * best
    assert [c.layout.pe_num for c in found.candidates] == sizes
    # On a link that costs nothing, every cycle counts.
    fast = planning.plan(SPEC, 43008, Link("fast", 0, 1e12, 1e12, ""), 1e6)
    assert fast.chosen.layout.pe_num > found.chosen.layout.pe_num
    assert fast.chosen.layout.data_wl == 1024


@pytest.mark.usefixtures("quick_host")
def test_plans_for_a_part() -> None:
    arty = PARTS["arty-a7-100t"]
    found = planning.plan(SPEC, 43008, LINKS["gen2x8"], 125e6, arty)
    assert found.chosen.bram36 == modelled_bram36(found.chosen.layout) <= arty.bram36
    assert all(c.bram36 <= arty.bram36 for c in found.candidates)
    needs = r"need 1,\d+\.\d BRAM36 and 0 DSP or more, the xc7a100t has 135 and 240"
    with pytest.raises(ArgumentError, match=needs):
        planning.plan(SPEC, 1_000_000, LINKS["gen2x8"], 125e6, arty)


@pytest.mark.usefixtures("quick_host")
@pytest.mark.parametrize("env_id", ["CartPole", "Pendulum", "Blackjack"])
def test_where_multipliers_are_scarce_cores_are_fewer(monkeypatch: pytest.MonkeyPatch, env_id: str) -> None:
    """They take a quarter of a VC707's 2,800 at most where these outrun the link, and never more than all."""
    monkeypatch.setattr(elaboration, "core_timing", lambda *_: elaboration.Timing(40, 1))  # takes seconds
    spec, link, part = get_spec(env_id), LINKS["gen2x8"], PARTS["vc707"]
    free = planning.plan(spec, 43008, link, 125e6)
    assert free.chosen.dsp > 700
    found = planning.plan(spec, 43008, link, 125e6, part)
    step = found.chosen.prediction
    assert found.chosen.dsp <= 700
    assert step.device < step.write + step.read
    assert found.larger is not None
    assert found.larger.dsp > 700 or found.larger.prediction.total >= step.total / planning.NEAR
    assert max(c.dsp for c in found.candidates) <= 2800
    fast = planning.plan(spec, 43008, Link("fast", 0.0, 1e12, 1e12, ""), 125e6, part)
    assert 700 < fast.chosen.dsp <= 2800
    for candidate in fast.candidates:
        if candidate.dsp <= 700:
            assert candidate.prediction.device > fast.chosen.prediction.link
    with pytest.raises(ArgumentError, match=r"and [\d,]+ DSP or more, the xc7vx485t has 1,030 and 2,800"):
        planning.plan(spec, 43008, link, 125e6, part, pe_num=128)


@pytest.mark.usefixtures("quick_host")
@pytest.mark.parametrize("n", [1, 2, 7])
def test_plans_for_few_slots(n: int) -> None:
    found = planning.plan(SPEC, n, LINKS["gen2x8"], 125e6)
    assert found.chosen.layout.n_envs == n
    assert (found.overlap is None) == (n == 1)


@pytest.mark.usefixtures("quick_host")
def test_what_is_chosen_is_among_what_it_was_chosen_from() -> None:
    """Also where a narrower word would be near the fastest of as many elements."""
    found = planning.plan(SPEC, 43008, LINKS["gen2x8"], 100e6)
    alone = planning.plan(SPEC, 43008, LINKS["gen2x8"], 100e6, pe_num=found.chosen.layout.pe_num)
    assert alone.chosen.layout.data_wl < found.chosen.layout.data_wl
    assert found.chosen in found.candidates


@pytest.mark.usefixtures("quick_host")
def test_pearl_plan(pearl: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    arguments = ("plan", "CliffWalking", "--part", "vc707", "--link", "25,3,2", "--clock", "100")
    status, out, err = pearl(*arguments)
    assert (status, err) == (0, "")
    for word in (
        "T1",
        "T7",
        "half-batches",
        "64 PEs: with 128 a step would take 1.2 % less time. Computing takes",
        "the cores outrun it",
        "of the 1,030 of a vc707",
        "pearl synth CliffWalking --n-envs 43008",
    ):
        assert word in out
    result = json.loads(pearl(*arguments, "--json", "--out", tmp_path)[1])
    assert result == json.loads((tmp_path / "plan_CliffWalking_43008.json").read_text())
    assert (result["link"]["call_us"], result["link"]["read_gb_per_s"]) == pytest.approx((25, 2))
    assert result["usage"] is None
    assert result["chosen"] in result["candidates"]
    (row,) = (line for line in out.splitlines() if "(chosen)" in line)
    assert row.split()[1:4:2] == ["64", f"{result['chosen']['data_wl']}"]
    assert result["reason"].startswith("64 PEs")
    assert result["chosen"]["device"] == pytest.approx(result["loop_cycles"]["ours"] / 100e6)
    usage = Usage(43008, 64, 256, 12_345, 678, 110.0, 9, (DesignMemory("m", 1, 2, "LUT RAM"),), {})
    monkeypatch.setattr(planning, "synthesised", lambda build: usage)
    assert "12,345 LUT, 678 FF, 110 BRAM36, 9 DSP." in pearl(*arguments)[1]
    large = dataclasses.replace(usage, lut=400_000, dsp=2801)
    monkeypatch.setattr(planning, "synthesised", lambda build: large)
    assert "2,801 DSP. A vc707 has fewer: lut, dsp." in pearl(*arguments)[1]
    cores = pearl("plan", "CartPole")[1]
    assert re.search(
        r"4 PEs: with 8 a step would take \d\.\d % less time, and 1,022 DSP of the 2,800 of a vc707", cores
    )
    assert "8 PEs: with 16" in pearl("plan", "CartPole", "--part", "any")[1]


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["--link", "gen9"], "there is no link 'gen9'; possible are gen2x4, gen2x8, gen3x16"),
        (["--link", "30,0,1"], "--link is '30,0,1'; the microseconds a call"),
        (["--part", "vc808"], "--part is 'vc808'; possible are 'vc707', 'kc705', 'arty-a7-100t' and 'any'"),
        (
            ["--clock", "0"],
            "the clock is 0 MHz; for xc7 it can be 1 to 317",
        ),
        (["--pe-num", "0"], "pe_num is 0; possible are 1 to n_envs = 43008"),
        (["--data-wl", "48"], "data_wl is 48; possible are 32"),
        (["--n-envs", "0"], "--n-envs"),
    ],
)
@pytest.mark.usefixtures("quick_host")
def test_refused_plans(pearl: Any, arguments: list[str], says: str) -> None:
    status, out, err = pearl("plan", "CliffWalking", *arguments)
    assert (status, out) == (2, "")
    assert says in " ".join(err.split())
