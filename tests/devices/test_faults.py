"""Whatever goes wrong on the way to a board: a clear error or none, and the same trajectory after it."""

from __future__ import annotations

import errno
import signal
import subprocess
import sys
import threading
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

import pearl_marl
from pearl_marl import get_spec
from pearl_marl.devices import BatchConfig, BatchStep, Device, Lockstep, Native, Phase, Rtl, Sharded, Xdma
from pearl_marl.devices.recovery import CheckpointLog
from pearl_marl.errors import ArgumentError, DeviceError, OrderError
from pearl_marl.testing import assert_same_step

from .boards import ANSWERS, ANY_CALL, Faults, OwnBoard, faulty

SPEC = get_spec("CliffWalking")
N = 70
CONFIG = {"spec": SPEC, "n_envs": N, "max_cycles": 25}
"""The size at which the contract is tested: its simulated device is built once."""


def actions(steps: int, n: int = N, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).integers(4, size=(steps, n), dtype=np.uint8)


def both(faults: Faults, **config: Any) -> tuple[Xdma, Native]:
    """Return a device on a link with these faults, and one without, begun alike."""
    batch = BatchConfig(**CONFIG, **config)
    device, native = faulty(OwnBoard(3), faults).open(batch), Native().open(batch)
    device.reset(seed=1)
    native.reset(seed=1)
    return device, native


class Pair:
    """A device that fails, and one that does not; the same calls on both, with the same results."""

    def __init__(self, device: Device, **config: Any) -> None:
        self.device = device.open(BatchConfig(**{**CONFIG, **config}))
        self.native = Native().open(BatchConfig(**{**CONFIG, **config}))
        self.errors: list[str] = []

    def call(self, name: str, *arguments: Any) -> None:
        while True:
            try:
                ours = getattr(self.device, name)(*arguments)
                break
            except DeviceError as error:
                self.errors.append(str(error))
                self._recover()
        theirs = getattr(self.native, name)(*arguments)
        if isinstance(theirs, BatchStep):
            assert_same_step(ours, theirs)
        elif theirs is not None:
            np.testing.assert_array_equal(ours, theirs)

    def _recover(self) -> None:
        while True:
            try:
                return self.device.recover()
            except DeviceError as error:
                self.errors.append(str(error))

    def close(self) -> None:
        np.testing.assert_array_equal(self.device.snapshot().memory, self.native.snapshot().memory)
        self.device.close()
        self.native.close()


@pytest.mark.parametrize(
    ("steps", "config"),
    [
        (3_000, {}),
        pytest.param(10_000, {}, marks=pytest.mark.exhaustive),
        (1_500, {"autoreset_mode": AutoresetMode.NEXT_STEP, "initial_states": "stored"}),
    ],
    ids=["same-step", "same-step-long", "next-step-stored"],
)
def test_every_fault_at_random_places(steps: int, config: dict) -> None:
    """In every call there is, with boards among it that come back with nothing in their memory."""
    faults, random = Faults(seed=5), np.random.default_rng(2)
    device = faulty(OwnBoard(3, checkpoint_every=20), faults)
    pair = Pair(device, **config)
    pair.call("reset", 3)
    faults.rate = 0.03
    for a in actions(steps):
        other = random.random()
        if other < 0.02:
            pair.call("reset", None, random.random(N) < 0.2)
        elif other < 0.03:
            pair.call(*RARELY[int(random.integers(len(RARELY)))])
        elif other < 0.032:
            device.restart()
        pair.call("step", a)
    faults.rate = 0
    assert all(faults.injected[kind] > steps // 1000 for kind in ANY_CALL + ANSWERS), faults.injected
    assert len(pair.errors) > steps // 100
    pair.close()


RARELY = (
    ("reset",),
    ("reset", 5),
    ("state",),
    ("set_rewards", [-2, -50]),
    ("set_rewards", [-1, -100]),
    ("set_max_cycles", 12),
    ("set_max_cycles", 0),
    ("set_max_cycles", 40),
)


@pytest.mark.parametrize("call", ["step", "reset", "restore", "set_rewards", "recv"])
def test_a_call_that_was_not_noted_did_not_happen(call: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Ctrl-C comes when the slots have moved, but what is kept for recover() has not."""

    def interrupted(*_: Any) -> None:
        raise KeyboardInterrupt

    device, native = both(Faults())
    for a in actions(3):
        assert_same_step(device.step(a), native.step(a))
    arguments = {
        "step": (actions(1)[0],), "reset": (7,), "restore": (native.snapshot(),), "set_rewards": ([-2, -50],),
        "recv": (),
    }[call]  # fmt: skip
    if call == "recv":
        device.send(actions(1)[0])
    with monkeypatch.context() as patch:
        patch.setattr(CheckpointLog, "after", interrupted)
        with pytest.raises(KeyboardInterrupt):
            getattr(device, call)(*arguments)
    with pytest.raises(DeviceError, match=r"recover\(\)"):
        device.step(actions(1)[0])
    device.recover()
    for a in actions(3, seed=1):
        assert_same_step(device.step(a), native.step(a))
    np.testing.assert_array_equal(device.snapshot().memory, native.snapshot().memory)
    device.close()


def test_phases() -> None:
    faults = Faults()
    device = faulty(OwnBoard(3), faults)
    assert device.phase is Phase.NEW
    device.open(BatchConfig(**CONFIG))
    assert device.phase is Phase.OPEN
    faults.plan = ["refused"]
    with pytest.raises(DeviceError):
        device.reset()
    assert device.phase is Phase.OPEN, "nothing is known of it yet, not even a seed"
    with pytest.raises(OrderError, match=r"step\(\) before reset\(\)"):
        device.step(actions(1)[0])
    device.reset(seed=1)
    assert device.phase is Phase.READY
    device.send(actions(1)[0])
    assert device.phase is Phase.STEPPING
    device.recv()
    faults.plan = ["refused"]
    with pytest.raises(DeviceError):
        device.step(actions(1)[0])
    assert device.phase is Phase.FAILED
    device.recover()
    assert device.phase is Phase.READY
    device.close()
    assert device.phase is Phase.CLOSED


def test_a_device_that_cannot_take_its_rewards_is_closed() -> None:
    class Refuses(Native):
        def _apply_rewards(self, table: Any) -> None:
            raise DeviceError("unplugged")

    device = Refuses()
    with pytest.raises(DeviceError, match="unplugged"):
        device.open(BatchConfig(**CONFIG), rewards=[-2, -50])
    with pytest.raises(OrderError, match="after close"):
        device.reset()


def test_one_of_two_boards_fails() -> None:
    """The other has stepped then, and has to go back."""
    links = [Faults(seed=3), Faults(seed=4)]
    boards = [faulty(OwnBoard(1), link) for link in links]
    pair = Pair(Sharded(boards, checkpoint_every=15))
    pair.call("reset", 3)
    for link in links:
        link.rate = 0.02
    for t, a in enumerate(actions(600)):
        if t % 50 == 9:
            pair.call("reset", None, a == 1)
        if t % 200 == 70:
            pair.call("set_max_cycles", (0, 9, 30)[t // 200])
        if t == 300:
            boards[1].restart()
        pair.call("step", a)
    assert all(link.injected.total() > 10 for link in links)
    for link in links:
        link.rate = 0
    pair.close()


def test_lockstep_goes_on_with_both() -> None:
    faults = Faults(seed=7)
    board = faulty(OwnBoard(3, checkpoint_every=10), faults)
    pair = Pair(Lockstep(board, "native", state_every=4))
    pair.call("reset", 3)
    faults.rate = 0.02
    for t, a in enumerate(actions(300)):
        if t % 50 == 9:
            pair.call("reset", None, a == 1)
        pair.call("step", a)
    assert faults.injected.total() > 10
    faults.rate = 0
    pair.close()


def test_a_device_that_keeps_nothing_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    device = Rtl(3).open(BatchConfig(**CONFIG))
    device.reset(seed=0)
    device.recover()
    monkeypatch.setattr(device._protocol.transport, "exchange", lambda *_: None)
    for call in (lambda: device.step(actions(1)[0]), device.recover):
        with pytest.raises(DeviceError, match=r"call reset\(\), or load a saved state, to go on"):
            call()
    device.close()


@pytest.mark.parametrize(
    ("kind", "code", "says"),
    [
        ("refused", errno.EIO, r"failed writing \d+ bytes at 0x[0-9a-f]+ \(EIO\); the board did not take or"),
        ("refused", errno.ETIMEDOUT, r"\(ETIMEDOUT\); the transfer timed out in the driver: see dmesg"),
        ("refused", 512, r"\(512\); the transfer timed out in the driver"),
        ("refused", errno.EINVAL, r"\(EINVAL\); the driver does not take this address or length"),
        ("refused", errno.EBUSY, r"\(EBUSY\); the driver's channel is taken: end other programs"),
        ("refused", errno.ENODEV, r"\(ENODEV\); there is no board any more: check its power"),
        ("failed late", errno.EIO, r"\(EIO\)"),
        ("short", None, r"moved \d+ of \d+ bytes writing at 0x[0-9a-f]+; its file was cut"),
        ("dead", None, r"\(ENODEV\)"),
    ],
)
def test_a_failed_step_is_told_and_taken_again(kind: str, code: int | None, says: str) -> None:
    faults = Faults()
    device, native = both(faults, copy=False)
    first, second = actions(2)
    held, expected = device.step(first), native.step(first)
    faults.plan, faults.error = [kind], code
    with pytest.raises(DeviceError, match=rf"served board at .* {says}.*\. Then call recover\(\)$"):
        device.step(second)
    assert_same_step(held, expected, "no half batch")
    for call in (lambda: device.step(second), device.state, lambda: device.reset(mask=first == 0)):
        with pytest.raises(DeviceError, match=r"a step of the xdma device failed before; call recover\(\)"):
            call()
    while faults.attempts_left:
        with pytest.raises(DeviceError, match=r"no such device; there is no board any more"):
            device.recover()
    device.recover()
    assert_same_step(device.step(second), native.step(second))
    np.testing.assert_array_equal(device.snapshot().memory, native.snapshot().memory)
    device.close()


def test_what_heals_by_itself_is_not_told() -> None:
    faults = Faults()
    device, native = (
        faulty(OwnBoard(3), faults).open(BatchConfig(**CONFIG)),
        Native().open(BatchConfig(**CONFIG)),
    )
    device.reset(seed=1)
    native.reset(seed=1)
    healing = ["interrupted", "stale", "torn", "torn and stale"]
    for t, a in enumerate(actions(12)):
        faults.plan = [healing[t % 4]] * (t % 3) if t else []
        assert_same_step(device.step(a), native.step(a), f"step {t}")
    assert set(faults.injected) == set(healing)
    device.close()


def test_reset_and_saved_states_are_ways_on_too() -> None:
    faults = Faults()
    device, native = (
        faulty(OwnBoard(3), faults).open(BatchConfig(**CONFIG)),
        Native().open(BatchConfig(**CONFIG)),
    )
    device.reset(seed=1)
    native.reset(seed=1)
    saved = native.snapshot()
    for way_on in (lambda d: d.reset(), lambda d: d.reset(seed=4), lambda d: d.restore(saved)):
        faults.plan = ["refused"]
        with pytest.raises(DeviceError):
            device.step(actions(1)[0])
        np.testing.assert_array_equal(way_on(device), way_on(native))
        for a in actions(5):
            assert_same_step(device.step(a), native.step(a))
    device.close()


def test_nothing_to_recover_from() -> None:
    device = OwnBoard(3).open(BatchConfig(**CONFIG))
    with pytest.raises(DeviceError, match=r"as no reset has succeeded: call reset\(\)"):
        device.recover()
    device.close()
    device = OwnBoard(3, checkpoint_every=None).open(BatchConfig(**CONFIG))
    device.reset(seed=0)
    with pytest.raises(DeviceError, match="as checkpoint_every is None"):
        device.recover()
    device.close()
    with pytest.raises(OrderError, match=r"recover\(\) after close"):
        device.recover()


@pytest.mark.parametrize("value", [0, -1, 1.5, True])
def test_checkpoint_every_is_checked(value: Any) -> None:
    with pytest.raises(
        ArgumentError, match=f"checkpoint_every is {value}; it must be an integer of at least 1"
    ):
        Xdma(checkpoint_every=value)


def test_a_device_that_cannot_fail_recovers_at_once() -> None:
    device = Native().open(BatchConfig(**CONFIG))
    device.reset(seed=0)
    before = device.snapshot()
    device.recover()
    np.testing.assert_array_equal(device.snapshot().memory, before.memory)


def test_sent_steps_are_recovered_too() -> None:
    faults = Faults()
    device, native = (
        faulty(OwnBoard(3), faults).open(BatchConfig(**CONFIG)),
        Native().open(BatchConfig(**CONFIG)),
    )
    device.reset(seed=1)
    native.reset(seed=1)
    for t, a in enumerate(actions(9)):
        device.send(a)
        step = device.recv()
        assert_same_step(step, native.step(a))
        if t % 4 == 3:
            faults.plan = ["refused"]
            device.send(a)
            with pytest.raises(DeviceError):
                device.recv()
            device.recover()
    device.close()


def test_a_ctrl_c_in_the_midst_of_a_step(monkeypatch: pytest.MonkeyPatch) -> None:
    device, native = both(Faults())
    first, second = actions(2)
    device.step(first)
    native.step(first)

    def interrupted(*_: Any) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(device._protocol.transport, "wait", interrupted)
        with pytest.raises(KeyboardInterrupt):
            device.step(second)
    device.recover()
    assert_same_step(device.step(second), native.step(second))
    device.close()


@pytest.mark.parametrize("make", [pearl_marl.parallel_env, pearl_marl.make_vec])
def test_environments_recover(make: Any) -> None:
    faults = Faults()
    device = faulty(OwnBoard(3), faults)
    env, native = make("CliffWalking", N, device=device), make("CliffWalking", N)
    for one in (env, native):
        one.reset(seed=0)
    for t, a in enumerate(actions(20)):
        if t == 12:
            faults.plan = ["dead"]
            with pytest.raises(DeviceError):
                env.step(a)
            device.restart()
            faults.attempts_left = 0
            env.recover()
        env.step_batch(a)
        native.step_batch(a)
    np.testing.assert_array_equal(env.device.state(), native.device.state())
    env.close()


def test_agents_that_left_stay_away() -> None:
    faults = Faults()
    envs = [
        pearl_marl.parallel_env("CliffWalking", N, autoreset=False, max_cycles=0, device=device)
        for device in (faulty(OwnBoard(3), faults), "native")
    ]
    for env in envs:
        env.reset(seed=0)
        mover = np.where(np.arange(N) < 20, 1, 0).astype(np.uint8)
        env.step_batch(np.zeros(N, np.uint8))
        for _ in range(11):
            env.step_batch(mover)
        env.step_batch(np.full(N, 2, np.uint8))  # the first 20 are above the goal, and all move down
    assert len(envs[0].agents) == N - 20
    faults.plan = ["refused"]
    with pytest.raises(DeviceError):
        envs[0].step_batch(mover)
    envs[0].recover()
    for env in envs:
        env.step_batch(mover)
    assert envs[0].agents == envs[1].agents
    assert envs[0].save_state() == envs[1].save_state()
    envs[0].close()


def served_by_another_process(folder: Path) -> subprocess.Popen[str]:
    """Run ``pearl serve`` and return once it serves."""
    command = [Path(sys.executable).with_name("pearl"), "serve", "CliffWalking", "--json"]
    process = subprocess.Popen(
        [*command, "--n-agents", str(N), "--pe-num", "3", "--at", folder],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert process.stdout is not None
    answer = ""
    for line in process.stdout:
        answer += line
        if line == "}\n":
            break
    if "device" not in answer:
        raise AssertionError(process.communicate()[1])
    return process


def test_a_served_board_is_killed_and_served_again(tmp_path: Path) -> None:
    """With SIGKILL, at any moment of a step."""
    servers = [served_by_another_process(tmp_path)]
    pair = Pair(Xdma(tmp_path, checkpoint_every=30))
    recover = pair.device.recover

    def serve_again() -> None:
        servers[-1].wait()
        with pytest.raises(DeviceError, match="is gone; its process has ended"):
            recover()
        servers.append(served_by_another_process(tmp_path))
        recover()

    pair._recover = serve_again
    pair.call("reset", 3)
    for t, a in enumerate(actions(600)):
        if t in (100, 400):
            threading.Timer(0.02, servers[-1].kill).start()
        pair.call("step", a)
    assert len(servers) == 3
    assert all("is gone; its process has ended: start `pearl serve` there again" in e for e in pair.errors)
    pair.close()
    servers[-1].send_signal(signal.SIGTERM)
    assert servers[-1].wait() == 0
    assert [path.name for path in tmp_path.iterdir()] == ["server.lock"]
