"""Slots over actors of a Ray cluster: the results of one device, whichever actor dies, and when."""

from __future__ import annotations

import copy
import importlib
import json
import os
import pickle
import signal
import sys
import threading
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

from pearl_marl import get_spec
from pearl_marl.base import version
from pearl_marl.batch.actions import random_actions
from pearl_marl.devices import BatchConfig, Device, Lockstep, Native, Phase, Ray, Rtl, cluster, cuda
from pearl_marl.errors import ActionError, ArgumentError, DeviceError, OrderError
from pearl_marl.spec import EnvSpec
from pearl_marl.testing import assert_same_step, assert_same_trajectory, trajectory

from ..sampling import sampled
from ..toy_fields import RELAY, ROVER
from .boards import Faults, OwnBoard, faulty

ray = pytest.importorskip("ray", reason="Ray is not installed: pip install '.[ray]'")

pytestmark = pytest.mark.usefixtures("ray_cluster")

SPEC = get_spec("CliffWalking")
N = 70
"""The size at which the contract is tested: its simulated devices are built once."""

ACTIONS = np.random.default_rng(0).integers(4, size=(300, N), dtype=np.uint8)


@pytest.fixture
def opened() -> Iterator[Any]:
    """Open devices for a batch, and close them after the test."""
    made = []

    def open_(device: Device, n: int = N, **config: Any) -> Any:
        made.append(device)
        device.open(BatchConfig(**{"spec": SPEC, "n_envs": n, "max_cycles": 20, **config}))
        device.reset(seed=0)
        return device

    yield open_
    for device in made:
        device.close()


def process(device: Ray, shard: int) -> int:
    """Return the id of a shard's process."""
    pid: int = cluster.get(device.parts[shard]._actor.__ray_call__.remote(lambda _: os.getpid()))
    return pid


def compare(device: Device, native: Device, t: int, random: np.random.Generator, choices: int = 4) -> None:
    """Do something with both in turn, and step both."""
    if t % 9 == 4:
        mask = random.random(N) < 0.3
        np.testing.assert_array_equal(device.reset(mask=mask), native.reset(mask=mask))
    if t % 29 == 6:
        np.testing.assert_array_equal(device.reset(), native.reset())
    if t % 31 == 8:
        for each in (device, native):
            each.set_max_cycles((0, 5, 9)[t % 3])
            each.set_rewards([t, *native.rewards[1:]])
    if t % 67 == 25:
        saved = device.snapshot(), native.snapshot()
        np.testing.assert_array_equal(saved[0].memory, saved[1].memory)
        np.testing.assert_array_equal(saved[0].stored, saved[1].stored)
        np.testing.assert_array_equal(device.restore(saved[1]), native.restore(saved[0]))
    actions = ACTIONS[t] % choices
    assert_same_step(device.step(actions), native.step(actions), f"step {t}")


@pytest.mark.parametrize(
    ("shards", "environment", "config"),
    [
        pytest.param(1, "CartPole", {}, marks=pytest.mark.exhaustive),
        pytest.param(2, "CliffWalking", {"first_slot": 1000}, marks=pytest.mark.exhaustive),
        (
            3,
            "Blackjack",
            {"autoreset_mode": AutoresetMode.NEXT_STEP, "initial_states": "stored", "copy": False},
        ),
    ],
)
def test_the_results_of_one_device(opened: Any, shards: int, environment: str, config: dict) -> None:
    config = {"spec": get_spec(environment), **config}
    device = opened(Ray(["native"] * shards, checkpoint_every=30), **config)
    native, random = opened(Native(), **config), np.random.default_rng(0)
    for t in range(len(ACTIONS)):
        if environment == "CartPole":  # which has no reward table
            assert_same_step(device.step(ACTIONS[t] % 2), native.step(ACTIONS[t] % 2))
        else:
            compare(device, native, t, random, config["spec"].action_space.n)
    assert device.name == f"ray({', '.join(['native'] * shards)})"


@pytest.mark.parametrize("environment", sampled(["ConnectFour", "LevelBasedForaging"], ["ConnectFour"]))
def test_worlds_in_two_shards(opened: Any, environment: str) -> None:
    """Agents that share a world, and its masks, also after a snapshot and a reset by world."""
    spec, worlds = get_spec(environment), 21
    device = opened(Ray(["native", "native"], sizes=[8, 13]), worlds, spec=spec)
    native, random = opened(Native(), worlds, spec=spec), np.random.default_rng(3)
    ended = 0
    for t in range(90):
        if t == 40:
            named = random.random(worlds) < 0.3
            np.testing.assert_array_equal(device.reset(mask=named), native.reset(mask=named))
        if t == 60:
            device.restore(native.snapshot())
        np.testing.assert_array_equal(device.action_masks, native.action_masks)
        chosen = random.random(native.action_masks.shape) * native.action_masks
        step = device.step(chosen.argmax(1).astype(spec.action.dtype))
        assert_same_step(step, native.step(chosen.argmax(1).astype(spec.action.dtype)), f"step {t}")
        ended += int(step.ended.sum())
    assert ended > worlds * spec.agents


@pytest.mark.parametrize("spec", sampled([ROVER, RELAY], [RELAY]), ids=lambda spec: spec.name)
def test_actions_and_observations_of_several_fields(opened: Any, spec: EnvSpec) -> None:
    lockstep = opened(Lockstep(Ray(["native", "native"], sizes=[20, N - 20]), "reference"), spec=spec)
    chance = np.random.default_rng(0)
    for _ in range(12):
        lockstep.step(random_actions(spec, chance, N * spec.agents))


@pytest.mark.exhaustive
def test_shards_of_any_kind_and_size(opened: Any) -> None:
    """And a copy goes on by itself, with actors of its own."""
    device = opened(Ray(["native", Rtl(pe_num=1)], sizes=[35, 35], resources=[None, {"fpga": 1}]))
    assert ray.available_resources().get("fpga", 0) == 0
    native = opened(Native())
    random = np.random.default_rng(0)
    for t in range(60):
        compare(device, native, t, random)
    device.close()  # or there would be no board for the copy


def test_copies(opened: Any) -> None:
    device, native = opened(Ray(["native"])), opened(Native())
    assert_same_trajectory(trajectory(device, ACTIONS[:9]), trajectory(native, ACTIONS[:9]))
    other = pickle.loads(pickle.dumps(device))
    assert process(other, 0) != process(device, 0)
    device.step(ACTIONS[9])
    assert_same_trajectory(trajectory(other, ACTIONS[9:15]), trajectory(native, ACTIONS[9:15]))
    other.close()
    again = copy.deepcopy(Ray(["native"]))
    assert again.phase is Phase.NEW


class Meeting(Native):
    """Comes back from a step only once all others are in theirs."""

    def __init__(self, folder: Path, name: str, others: int) -> None:
        super().__init__()
        self.place = str(folder), name, others

    def _step(self, actions: np.ndarray) -> Any:
        folder, name, others = self.place
        Path(folder, name).touch()
        deadline = time.monotonic() + 1800
        while len(os.listdir(folder)) < others:
            assert time.monotonic() < deadline, "the others do not step at the same time"
            time.sleep(0.01)
        return super()._step(actions)


def test_halves_and_shards_step_at_the_same_time(tmp_path: Path, opened: Any) -> None:
    halves = [
        opened(Ray([Meeting(tmp_path, "a", 3), Meeting(tmp_path, "b", 3)])),
        opened(Ray([Meeting(tmp_path, "c", 3)]), first_slot=N),
    ]
    for half in halves:
        half.send(ACTIONS[0])
    native = [opened(Native()), opened(Native(), first_slot=N)]
    for half, whole in zip(halves, native, strict=True):
        assert_same_step(half.recv(), whole.step(ACTIONS[0]))


class Dangerous(Native):
    """Does in a step what a file says, if there is one: ends its process, is slow, or fails."""

    def __init__(self, file: Path) -> None:
        super().__init__()
        self.file = str(file)

    def _reset(self, mask: np.ndarray | None, seed: int | None) -> Any:
        self._obey()
        return super()._reset(mask, seed)

    def _step(self, actions: np.ndarray) -> Any:
        self._obey()
        return super()._step(actions)

    def _obey(self) -> None:
        if os.path.exists(self.file):
            match Path(self.file).read_text():
                case "end":
                    os.kill(os.getpid(), signal.SIGKILL)
                case "slow":
                    Path(self.file).unlink()
                    Path(f"{self.file}.pid").write_text(str(os.getpid()))
                    time.sleep(3600)
                case "failed":
                    Path(self.file).unlink()
                    raise DeviceError("failed")
                case "refused":
                    Path(self.file).unlink()
                    raise ActionError("refused")


def test_lost_actors_are_replaced(tmp_path: Path, opened: Any) -> None:
    """Between steps and within one, before any state was kept and after, in every kind of call."""
    file = tmp_path / "todo"
    device = opened(Ray(["native", Dangerous(file)], checkpoint_every=7), spec=get_spec("FrozenLake"))
    native, random = opened(Native(), spec=get_spec("FrozenLake")), np.random.default_rng(1)
    first = process(device, 0), process(device, 1)
    seconds = 0.0
    for t in range(100):
        if t in (3, 40):
            os.kill(process(device, 0), signal.SIGKILL)
        if t == 25:
            ray.kill(device.parts[1]._actor)  # next are a snapshot, and a restored state
        if t == 37:  # next is a reset that goes on with the random numbers, and one with a mask before
            os.kill(process(device, 1), signal.SIGKILL)
            np.testing.assert_array_equal(device.reset(), native.reset())
        if t == 70:  # next is a change of the table and the limit
            for part in (0, 1):
                os.kill(process(device, part), signal.SIGKILL)
        if t == 80:
            file.write_text("slow")
            killer = threading.Thread(target=kill_when_named, args=(Path(f"{file}.pid"),))
            killer.start()
            began = time.monotonic()
        compare(device, native, t, random)
        if t == 80:
            seconds = time.monotonic() - began
            killer.join()
    assert 0 < seconds < 3600, "it was killed within the step"
    np.testing.assert_array_equal(device.state(), native.state())
    assert not {process(device, 0), process(device, 1)} & set(first)


def kill_when_named(file: Path) -> None:
    while not file.exists() or not file.read_text():
        time.sleep(0.01)
    os.kill(int(file.read_text()), signal.SIGKILL)


@pytest.mark.exhaustive  # the workers of a training are given up likewise
def test_an_actor_that_is_lost_again_and_again(tmp_path: Path, opened: Any) -> None:
    file = tmp_path / "todo"
    device, native = opened(Ray(["native", Dangerous(file)])), opened(Native())
    assert_same_trajectory(trajectory(device, ACTIONS[:5]), trajectory(native, ACTIONS[:5]))
    file.write_text("end")
    with pytest.raises(
        DeviceError, match=r"the actor of slots 35 to 69 \(native\) was lost 3 times in a row"
    ):
        device.step(ACTIONS[5])
    for call in (lambda: device.step(ACTIONS[5]), device.state, lambda: device.set_rewards([1, 2])):
        with pytest.raises(DeviceError, match=r"failed on some parts before; call recover\(\)"):
            call()
    file.unlink()
    device.recover()
    assert_same_trajectory(trajectory(device, ACTIONS[5:9]), trajectory(native, ACTIONS[5:9]))
    device.recover()  # though nothing has failed since
    assert_same_trajectory(trajectory(device, ACTIONS[9:12]), trajectory(native, ACTIONS[9:12]))


def test_what_a_device_raises_arrives_as_itself(tmp_path: Path, opened: Any) -> None:
    """The other shard has stepped then, and goes back."""
    file = tmp_path / "todo"
    device, native = opened(Ray(["native", Dangerous(file)])), opened(Native())
    processes = process(device, 0), process(device, 1)
    for t, (todo, error) in enumerate((("failed", DeviceError), ("refused", ActionError))):
        actions = ACTIONS[10 * t : 10 * t + 10]
        assert_same_trajectory(trajectory(device, actions), trajectory(native, actions))
        file.write_text(todo)
        with pytest.raises(error, match=f"^{todo}$") as raised:
            device.step(ACTIONS[0])
        assert type(raised.value) is error
        file.write_text(todo)
        with pytest.raises(error):  # the other shard has stepped, and is reset
            device.reset(seed=3)
        device.recover()
    assert_same_trajectory(trajectory(device, ACTIONS[:5]), trajectory(native, ACTIONS[:5]))
    assert (process(device, 0), process(device, 1)) == processes, "no actor was lost"
    with pytest.raises(ActionError, match="agent_50: action 9"):
        device.step(np.where(np.arange(N) == 50, 9, 0))
    assert_same_trajectory(trajectory(device, ACTIONS[:5]), trajectory(native, ACTIONS[:5]))


class Later(Faults):
    """Faults that begin once the board has been in use for a while."""

    calls = 0

    def _next(self, answer: bool) -> str | None:
        self.calls += 1
        return super()._next(answer) if self.calls > 40 else None


def test_faults_of_a_board_in_an_actor(opened: Any) -> None:
    board = faulty(OwnBoard(1), Later(seed=3, rate=0.03))
    device, native = opened(Ray(["native", board], checkpoint_every=15)), opened(Native())
    errors: list[str] = []
    for actions in ACTIONS[:150]:
        calls = [lambda actions=actions: device.step(actions)]
        while calls:
            try:
                step = calls[-1]()
                calls.pop()
            except DeviceError as error:
                errors.append(str(error))
                calls[1:] = [device.recover]
        assert_same_step(step, native.step(actions))
    assert len(errors) > 3
    assert all("board" in error or "xdma" in error for error in errors)


@pytest.mark.exhaustive  # below, a resource that the cluster never had
def test_a_resource_that_is_gone(opened: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """By hand, later, it goes on."""
    device = opened(Ray(["native", "native"], resources=[None, {"fpga": 1}], checkpoint_every=4))
    native = opened(Native())
    assert_same_trajectory(trajectory(device, ACTIONS[:6]), trajectory(native, ACTIONS[:6]))

    class Other:
        pass

    cluster.kill(device.parts[1]._actor)
    other = cluster.start_actor(Other, resources={"fpga": 1})
    monkeypatch.setattr(cluster, "START_SECONDS", 0.5)
    for call in (lambda: device.step(ACTIONS[6]), device.recover):
        with pytest.raises(
            DeviceError, match=r"no actor with the resources \{'fpga': 1\} started .* fpga: 1, of which"
        ):
            call()
    monkeypatch.undo()
    cluster.kill(other)
    device.recover()
    assert_same_trajectory(trajectory(device, ACTIONS[6:12]), trajectory(native, ACTIONS[6:12]))


@pytest.mark.exhaustive
def test_nothing_is_kept_where_that_is_not_wanted(opened: Any) -> None:
    device, native = opened(Ray(["native"], checkpoint_every=None)), opened(Native())
    os.kill(process(device, 0), signal.SIGKILL)
    with pytest.raises(DeviceError, match=r"keeps nothing to recover from, as checkpoint_every is None"):
        device.step(ACTIONS[0])
    np.testing.assert_array_equal(device.reset(seed=4), native.reset(seed=4))
    assert_same_trajectory(trajectory(device, ACTIONS[:5]), trajectory(native, ACTIONS[:5]))


def test_close_ends_the_actors(opened: Any) -> None:
    device = opened(Ray(["native"]))
    pid = process(device, 0)
    device.close()
    deadline = time.monotonic() + 1800
    while os.path.exists(f"/proc/{pid}") and time.monotonic() < deadline:
        time.sleep(0.02)
    assert not os.path.exists(f"/proc/{pid}")
    with pytest.raises(OrderError, match="after close"):
        device.step(ACTIONS[0])


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (([],), r"shards is \[\]; it must be a list of at least one device"),
        (("native",), "shards is 'native'; it must be a list"),
        ((["native", "nativ"],), "there is no device 'nativ'"),
        ((["native"], [0]), r"sizes is \[0\]; it must be 1 positive integers"),
        ((["native", "native"], [30, 30]), "70 slots do not fall to 2 parts of 30, 30 slots"),
        (([Ray(["native"])],), "list its shards instead"),
        ((["native"], None, [{"GPU": 1}, None]), "one for each of the 1 shards"),
        ((["native"], None, "fpga"), "one for all, or a list"),
        ((["native"], None, {"fpga": "one"}), "must be positive numbers by name"),
        ((["native"], None, None, 0), "checkpoint_every is 0"),
    ],
)
def test_illegal_arguments(arguments: tuple, says: str) -> None:
    with pytest.raises(ArgumentError, match=says):
        Ray(*arguments).open(BatchConfig(spec=SPEC, n_envs=N))


def test_a_device_is_one_shard() -> None:
    device = Native()
    with pytest.raises(ArgumentError, match="the same device is among the shards twice"):
        Ray([device, device])


def test_without_ray(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(DeviceError, match=r"Ray is not installed.*pip install '\.\[ray\]'"):
        Ray(["native"]).open(BatchConfig(spec=SPEC, n_envs=N))


def test_the_doctor_looks_for_ray(pearl: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cuda, "find_spec", lambda name: None)  # no GPU: it is looked for there too
    monkeypatch.delenv("RAY_ADDRESS", raising=False)

    def row() -> dict:
        status, output, _ = pearl("doctor", "--json")
        assert status == 0
        return json.loads(output)["Ray"]

    assert row() == {"ok": True, "found": f"version {ray.__version__}", "fix": ""}
    monkeypatch.setenv("RAY_ADDRESS", "127.0.0.1:9")
    assert row() == {
        "ok": False,
        "found": "no Ray cluster answers at RAY_ADDRESS=127.0.0.1:9: Connection refused",
        "fix": "start one with `ray start --head`, or unset RAY_ADDRESS for one on this machine alone",
    }
    monkeypatch.setenv("RAY_ADDRESS", ray.get_runtime_context().gcs_address)
    assert row()["found"] == f"version {ray.__version__}, cluster at {os.environ['RAY_ADDRESS']}"
    monkeypatch.setitem(sys.modules, "ray", None)
    assert row() == {
        "ok": False,
        "found": "Ray is not installed, as 'ray' is missing",
        "fix": "pip install '.[ray]'",
    }


def test_no_cluster_starts_here(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(**_: Any) -> None:
        raise Exception("The current node timed out during startup.")

    monkeypatch.delenv("RAY_ADDRESS", raising=False)
    monkeypatch.setattr(ray, "is_initialized", lambda: False)
    monkeypatch.setattr(ray, "init", fail)
    with pytest.raises(DeviceError, match=r"Ray could not start on this machine: .* timed out .* try again"):
        cluster.connect()


def test_no_cluster_at_the_address(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("RAY_ADDRESS", "127.0.0.1:9")
    monkeypatch.setattr(ray, "is_initialized", lambda: False)
    with pytest.raises(DeviceError, match=r"no Ray cluster answers at RAY_ADDRESS=127\.0\.0\.1:9"):
        cluster.connect()


def test_a_resource_that_the_cluster_has_not() -> None:
    device = Ray(["native"], resources={"asic": 1})
    with pytest.raises(
        DeviceError,
        match=r"has the resource 'asic': 1; there is CPU: 1, fpga: 1.*--resources='\{\"asic\": 1\}'",
    ):
        device.open(BatchConfig(spec=SPEC, n_envs=N))
    with pytest.raises(DeviceError, match=r"has the resource 'GPU': 1.*finds CPUs and GPUs by itself"):
        Ray(["native"], resources={"GPU": 1}).open(BatchConfig(spec=SPEC, n_envs=N))


def test_another_version(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(version, "__version__", "0.0.1")
    with pytest.raises(DeviceError, match=r"runs version \S+ of pearl-marl .*, this process 0\.0\.1"):
        Ray(["native"]).open(BatchConfig(spec=SPEC, n_envs=N))


def test_another_environment(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Golden functions of a module that is another one there, or that is not there."""
    module = tmp_path / "own_golden.py"
    module.write_text("def observe(state):\n    return state.row\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    observe = importlib.import_module("own_golden").observe
    spec = replace(SPEC, name="Own", golden=SPEC.golden._replace(observe=observe))
    with pytest.raises(DeviceError, match=r"cannot load the environment Own .*own_golden.*PYTHONPATH"):
        Ray(["native"]).open(BatchConfig(spec=spec, n_envs=N))

    before = SPEC.golden.observe
    changed = pickle.loads(ray.cloudpickle.dumps(lambda state: state.row))
    changed.__module__, changed.__qualname__ = before.__module__, before.__qualname__
    monkeypatch.setitem(before.__globals__, "observe", changed)
    spec = replace(SPEC, golden=SPEC.golden._replace(observe=changed))
    with pytest.raises(DeviceError, match="has another CliffWalking than the process that asks"):
        Ray(["native"]).open(BatchConfig(spec=spec, n_envs=N))


def test_a_device_that_is_open_already(opened: Any) -> None:
    with pytest.raises(OrderError, match="opened before"):
        Ray([opened(Native())]).open(BatchConfig(spec=SPEC, n_envs=N))
