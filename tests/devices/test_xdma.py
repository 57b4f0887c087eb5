"""A board behind the driver's nodes: finding it, refusing another, one step's system calls."""

from __future__ import annotations

import contextlib
import copy
import fcntl
import itertools
import os
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest

from pearl_marl import get_spec
from pearl_marl.devices import BatchConfig, Device, Native, Rtl, Xdma, discovery, make_device, xdma
from pearl_marl.devices import served as served_board
from pearl_marl.devices.served import ServedBoard
from pearl_marl.devices.simulator.model_build import library
from pearl_marl.devices.simulator.simulation import Simulation
from pearl_marl.devices.xdma import SERVER_LOCK, XdmaTransport
from pearl_marl.errors import ArgumentError, DeviceError
from pearl_marl.hardware.build import Build
from pearl_marl.memory_map import PROTOCOL_VERSION, Control, Doorbell, Status
from pearl_marl.spec import EnvSpec
from pearl_marl.testing import assert_same_trajectory, trajectory

from .boards import OwnBoard, served

SPEC = get_spec("CliffWalking")
N = 70
CONFIG = BatchConfig(spec=SPEC, n_envs=N, max_cycles=20)
ACTIONS = np.random.default_rng(0).integers(4, size=(60, N), dtype=np.uint8)


@pytest.fixture(scope="module")
def board(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A served board, for one test after the other."""
    folder = tmp_path_factory.mktemp("board")
    with served(folder, SPEC, N, pe_num=3):
        yield folder


@pytest.fixture
def device(board: Path) -> Iterator[Xdma]:
    device = Xdma(board).open(CONFIG)
    device.reset(seed=0)
    yield device
    device.close()


@pytest.fixture(scope="module")
def expected() -> list[Any]:
    native = Native().open(CONFIG)
    native.reset(seed=0)
    return trajectory(native, ACTIONS)


def test_devices_by_name(tmp_path: Path) -> None:
    assert make_device("xdma").board == 0
    assert make_device("xdma:1").board == 1
    assert make_device(f"xdma:{tmp_path}").board == str(tmp_path)
    for name in ("xdma:", "rtl:1", "fpga"):
        with pytest.raises(ArgumentError, match=f"no device '{name}'; possible are .*'xdma:N' for board N"):
            make_device(name)


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"board": -1}, "board is -1; it must be a number from 0 on, or a folder"),
        ({"board": True}, "board is True"),
        ({"board": [0, 1]}, r"board is \[0, 1\]"),
        ({"completion": "irq"}, "completion is 'irq'; possible are 'poll', 'event' and None"),
        ({"timeout": 0}, "timeout is 0; it must be a number above 0 to below 1,000,000"),
        ({"timeout": "1"}, "timeout is '1'"),
    ],
)
def test_options_are_checked(options: dict, says: str) -> None:
    with pytest.raises(ArgumentError, match=says):
        Xdma(**options)


def test_a_step_is_one_write_and_one_read(device: Xdma) -> None:
    """As the kernel counts them for this thread: one write, one read, and the four bytes of the event."""
    trajectory(device, ACTIONS[:5])
    layout = device._protocol.layout
    steps = ACTIONS[5:]

    def counted() -> dict[str, int]:
        lines = Path("/proc/thread-self/io").read_text().splitlines()
        return {name: int(value) for name, value in (line.split(": ") for line in lines)}

    counted()
    counting = [counted(), counted()]
    trajectory(device, steps)
    counting.append(counted())
    own, all_of_it = ({k: b[k] - a[k] for k in a} for a, b in itertools.pairwise(counting))
    made = {name: all_of_it[name] - own[name] for name in own}
    assert made["syscw"] == len(steps)
    assert made["wchar"] == len(steps) * layout.step_write[1]
    assert made["syscr"] == 2 * len(steps)
    assert abs(made["rchar"] - len(steps) * (layout.step_read[1] + 4)) < 10, "digits of the counters"


def test_buffers_begin_on_a_page(device: Xdma) -> None:
    for buffer in (device._protocol.written, device._protocol.answer):
        assert buffer.ctypes.data % os.sysconf("SC_PAGE_SIZE") == 0
        assert buffer.flags.writeable


def test_two_half_batches_in_flight(tmp_path: Path, expected: list[Any]) -> None:
    half = N // 2
    shares = [slice(0, half), slice(half, N)]
    envs = [
        OwnBoard(1).open(BatchConfig(spec=SPEC, n_envs=half, max_cycles=20, first_slot=s.start))
        for s in shares
    ]
    for env in envs:
        env.reset(seed=0)
    for actions, whole in zip(ACTIONS, expected, strict=True):
        for env, share in zip(envs, shares, strict=True):
            env.send(actions[share])
        for env, share in zip(envs, shares, strict=True):
            np.testing.assert_array_equal(env.recv().obs, whole.obs[share])
    for env in envs:
        env.close()


def test_a_doorbell_that_rings_before_the_server_looks(tmp_path: Path, expected: list[Any]) -> None:
    server = ServedBoard(tmp_path, SPEC, N, pe_num=3)
    device = Xdma(tmp_path).open(CONFIG)
    device.reset(seed=0)
    device.send(ACTIONS[0])
    thread = threading.Thread(target=server.serve)
    thread.start()
    assert_same_trajectory([device.recv()], expected[:1])
    device.close()
    server.stop()
    thread.join()
    server.close()


def ring(device: Xdma, sequence: int) -> None:
    """Begin a step that nobody waits for."""
    protocol = device._protocol
    protocol.doorbell[Doorbell.SEQUENCE] = sequence
    protocol.transport.write(protocol.layout["reset_mask"].offset, protocol.written[:-8])


def test_the_next_program_waits_for_a_step_under_way(tmp_path: Path, expected: list[Any]) -> None:
    """Which one left that was killed."""
    server = ServedBoard(tmp_path, SPEC, N, pe_num=3)
    killed = Xdma(tmp_path).open(CONFIG)
    ring(killed, 1)
    killed.close()
    thread = threading.Thread(target=server.serve)
    threading.Timer(0.1, thread.start).start()
    device = Xdma(tmp_path).open(CONFIG)
    assert server.steps == 1
    device.reset(seed=0)
    assert_same_trajectory(trajectory(device, ACTIONS), expected)
    device.close()
    server.stop()
    thread.join()
    server.close()


def test_one_program_after_the_other(board: Path, expected: list[Any]) -> None:
    """Each finds the board as the one before left it, and its own trajectory."""
    for steps in (7, 60):
        device = Xdma(board).open(CONFIG)
        device.reset(seed=0)
        assert_same_trajectory(trajectory(device, ACTIONS[:steps]), expected[:steps])
        device.close()


@pytest.mark.parametrize("make", [Native, lambda: Rtl(3)], ids=["native", "rtl"])
def test_other_devices_go_on_where_a_board_stopped(device: Xdma, make: Callable[[], Device]) -> None:
    other = make().open(CONFIG)
    trajectory(device, ACTIONS[:30])
    other.restore(device.snapshot())
    assert_same_trajectory(trajectory(device, ACTIONS[30:]), trajectory(other, ACTIONS[30:]))
    other.close()


def test_a_board_for_something_else_is_refused(board: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(
        DeviceError, match=r"has n_envs 70, this batch needs 71: it is built for 70 agents, not 71"
    ):
        Xdma(board).open(BatchConfig(spec=SPEC, n_envs=71))
    with pytest.raises(
        DeviceError,
        match=r"has env_hash 0x\w+, this batch needs 0x\w+: it is built for CliffWalking-v0, not for Blackj",
    ):
        Xdma(board).open(BatchConfig(spec=get_spec("Blackjack"), n_envs=N))
    with pytest.raises(DeviceError, match=r"not for CliffWalking-v0 with {'is_slippery': True}"):
        Xdma(board).open(BatchConfig(spec=SPEC.with_options(is_slippery=True), n_envs=N))
    newer = PROTOCOL_VERSION + 1
    monkeypatch.setattr("pearl_marl.devices.identity.PROTOCOL_VERSION", newer)
    with pytest.raises(
        DeviceError, match=f"has protocol_version {PROTOCOL_VERSION}, this batch needs {newer}"
    ):
        Xdma(board).open(CONFIG)
    monkeypatch.undo()
    Xdma(board).open(CONFIG).close()  # a refusal leaves the board free


def test_what_is_no_board_is_refused(tmp_path: Path) -> None:
    """A link that is down reads as ones."""
    (tmp_path / "xdma0_h2c_0").write_bytes(b"\xff" * 10_000)
    (tmp_path / "xdma0_c2h_0").hardlink_to(tmp_path / "xdma0_h2c_0")
    with pytest.raises(DeviceError, match="has magic 0xffffffff"):
        Xdma(tmp_path).open(CONFIG)


@pytest.mark.parametrize("ends", [False, True])
def test_a_board_that_is_being_made_is_waited_for(
    ends: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Until it is there, or its server is not any more."""
    with (tmp_path / SERVER_LOCK).open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)

        def goes_on(_: float) -> None:
            if ends:
                fcntl.flock(lock, fcntl.LOCK_UN)
            else:
                (tmp_path / "xdma0_h2c_0").write_bytes(b"")

        monkeypatch.setattr("pearl_marl.devices.xdma.time.sleep", goes_on)
        xdma.await_server(tmp_path)
    told = capsys.readouterr().err
    assert told == f"pearl: waiting for process {os.getpid()}, which makes a board at {tmp_path}\n"


def test_nobody_is_waited_for(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("pearl_marl.devices.xdma.time.sleep", lambda _: pytest.fail("it waits"))
    (tmp_path / "file").write_text("")
    for folder, says in (
        (tmp_path, "there is no board at"),
        (tmp_path / "file", "name the folder of a board"),
    ):
        with pytest.raises(DeviceError, match=says):
            Xdma(folder).open(CONFIG)
    (tmp_path / SERVER_LOCK).write_text("1\n")  # of a server that has ended
    with pytest.raises(DeviceError, match="there is no board at"):
        Xdma(tmp_path).open(CONFIG)


def test_pearl_serve_counts_agents(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, pearl: Any) -> None:
    def board(_: Path, spec: EnvSpec, n_envs: int, *sizes: Any) -> None:
        raise DeviceError(f"{n_envs} worlds of {spec.name}")

    monkeypatch.setattr("pearl_marl.cli.serve.ServedBoard", board)
    status, _, err = pearl("serve", "LevelBasedForaging", "--at", tmp_path, "--n-agents", 4)
    assert (status, err) == (2, "pearl: 2 worlds of LevelBasedForaging\n")


def test_a_board_has_one_user(device: Xdma, board: Path) -> None:
    with pytest.raises(DeviceError, match="in use by this process: close that environment"):
        Xdma(board).open(CONFIG)
    with pytest.raises(DeviceError, match="in use by this process"):
        copy.deepcopy(device)
    pearl = Path(sys.executable).with_name("pearl")
    command = [pearl, "run", "CliffWalking", "--n-agents", str(N), "--device", f"xdma:{board}"]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 2
    assert f"is in use by process {os.getpid()}: close that environment, or end that process" in " ".join(
        done.stderr.split()
    )


def test_a_forgotten_device_gives_its_board_back(board: Path) -> None:
    Xdma(board).open(CONFIG)
    Xdma(board).open(CONFIG).close()


def test_a_folder_has_one_server(board: Path) -> None:
    with pytest.raises(
        DeviceError, match=f"process {os.getpid()} serves a board at .* already: end it first"
    ):
        ServedBoard(board, SPEC, N, pe_num=3)


def test_folders_that_cannot_be_served(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(DeviceError, match=r"no board can be served at .*file"):
        ServedBoard(tmp_path / "file", SPEC, N, pe_num=3)


def test_a_server_that_has_ended(tmp_path: Path) -> None:
    """Its files stay where it was killed; they are no board, and the next server's take their place."""
    with pytest.raises(DeviceError, match=r"there is no board at .*; serve one there with: pearl serve ENV"):
        Xdma(tmp_path).open(CONFIG)
    os.mkfifo(tmp_path / "xdma0_events_0")
    (tmp_path / "xdma0_h2c_0").write_bytes(b"")
    (tmp_path / "xdma0_c2h_0").write_bytes(b"")
    with pytest.raises(DeviceError, match="is gone; its process has ended: start `pearl serve` there again"):
        Xdma(tmp_path).open(CONFIG)
    with served(tmp_path, SPEC, N, pe_num=3):
        Xdma(tmp_path).open(CONFIG).close()


def test_polling_needs_a_board(board: Path) -> None:
    with pytest.raises(ArgumentError, match="a served board tells the end of a step by an event only"):
        Xdma(board, completion="poll").open(CONFIG)


def test_a_step_that_does_not_end(tmp_path: Path) -> None:
    server = ServedBoard(tmp_path, SPEC, N, pe_num=3)  # which nobody lets serve
    device = Xdma(tmp_path, timeout=0.1).open(CONFIG)
    device.reset(seed=0)
    with pytest.raises(
        DeviceError, match=r"did not end step 1 within 0.1 s: its status is of step 0, error 0"
    ):
        device.step(ACTIONS[0])
    for way_on in (device.recover, device.reset):
        with pytest.raises(
            DeviceError, match=r"busy with step 1 for 0.1 s, and does not answer a reset; end other"
        ):
            way_on()
    device.close()
    server.close()


def plugged_in(sys: Path, slot: str, driver: int | None, vendor: str = "0x10ee") -> None:
    """Make what sysfs shows of a PCI device, and of the driver's nodes for it."""
    device = sys / "bus" / "pci" / "devices" / slot
    device.mkdir(parents=True)
    (device / "vendor").write_text(f"{vendor}\n")
    (device / "device").write_text("0x7028\n")
    if driver is not None:
        (device / "driver").mkdir()
        for name in ("h2c_0", "c2h_0", "user"):
            node = sys / "class" / "xdma" / f"xdma{driver}_{name}"
            node.mkdir(parents=True)
            (node / "device").symlink_to(device)


def test_boards_are_found_in_sysfs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(discovery, "SYS", tmp_path)
    monkeypatch.setattr(xdma, "DEV", str(tmp_path))

    def refusal() -> str:
        with pytest.raises(DeviceError) as refused:
            Xdma(7).open(CONFIG)
        return str(refused.value)

    start = f"there is no XDMA board 7: there is no {tmp_path}/xdma7_h2c_0; "
    assert refusal().startswith(f"{start}nor a PCI device of vendor 0x10ee: check the board's power")
    assert refusal().endswith("pearl serve ENV --n-agents N --at DIR, and use device='xdma:DIR'")
    plugged_in(tmp_path, "0000:00:02.0", None, vendor="0x8086")
    plugged_in(tmp_path, "0000:03:00.0", None)
    assert discovery.boards_without_driver() == ["0000:03:00.0"]
    assert refusal().startswith(f"{start}a Xilinx device in slot 0000:03:00.0 has no driver: load it")
    plugged_in(tmp_path, "0000:02:00.0", 1)
    plugged_in(tmp_path, "0000:01:00.0", 0)
    assert discovery.boards() == [(0, "10ee:7028", "0000:01:00.0"), (1, "10ee:7028", "0000:02:00.0")]
    assert refusal().startswith(f"{start}there are boards 0 (10ee:7028 in slot 0000:01:00.0), 1 (10ee:7028")


def test_a_board_by_its_number(board: Path, monkeypatch: pytest.MonkeyPatch, expected: list[Any]) -> None:
    monkeypatch.setattr(xdma, "DEV", str(board))
    device = Xdma().open(CONFIG)
    device.reset(seed=0)
    assert_same_trajectory(trajectory(device, ACTIONS), expected)
    device.close()


class AxiLink(XdmaTransport):
    """The driver and its board without a server between: every transfer goes over the simulated AXI port.

    The clock runs only while one does. So a read that comes right after the doorbell meets the step under
    way, as it does on a board.
    """

    reads: ClassVar[list[int]] = []
    wired = True

    def _open(self) -> None:
        build = Build.of(SPEC, N // 2, 1, 32)
        self.simulation = Simulation(library(build), build.layout, backdoor=False, trace=None)
        self._events = -1 if self._asked == "poll" else 1000

    def _pwrite(self, offset: int, data: np.ndarray) -> int:
        self.simulation.write(offset, data)
        return data.size

    def _pread(self, offset: int, data: np.ndarray) -> int:
        AxiLink.reads.append(data.size)
        self.simulation.read(offset, data)
        return data.size

    def begin(self) -> None:
        """There are no interrupts of earlier steps."""

    def _await_event(self, seconds: float) -> None:
        if self.wired:
            self.simulation.wait(None)
            self._interrupted = True

    def close(self) -> None:
        if self._events:
            self.simulation.close()
        self._events = 0


def axi_pair(completion: str) -> tuple[Xdma, Native]:
    """A device on the simulated hardware itself, and one beside it, begun alike."""
    config = BatchConfig(spec=SPEC, n_envs=N // 2, max_cycles=20)
    device, native = Xdma(completion=completion).open(config), Native().open(config)
    device.reset(seed=0)
    native.reset(seed=0)
    return device, native


@pytest.mark.parametrize("completion", ["poll", "event"])
def test_completion_on_the_hardware_itself(completion: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """What was read during the step is read again, once; till its end it is the status that is looked at."""
    monkeypatch.setattr(Xdma, "transport_type", AxiLink)
    device, native = axi_pair(completion)
    actions = ACTIONS[:, : N // 2].copy()
    monkeypatch.setattr(AxiLink, "reads", [])
    assert_same_trajectory(trajectory(device, actions), trajectory(native, actions))
    whole = device._protocol.layout.step_read[1]
    if completion == "event":
        assert AxiLink.reads == [whole] * len(actions)
    else:
        assert AxiLink.reads.count(whole) == 2 * len(actions)
        assert set(AxiLink.reads) == {whole, 4 * len(Status)}
    device.close()


def test_a_step_that_would_not_end_is_reset(monkeypatch: pytest.MonkeyPatch) -> None:
    """By the next program, after its patience; what it finds is as good as new hardware."""
    monkeypatch.setattr(Xdma, "transport_type", AxiLink)
    device, native = axi_pair("poll")
    actions = ACTIONS[:, : N // 2].copy()
    assert_same_trajectory(trajectory(device, actions[:7]), trajectory(native, actions[:7]))
    ring(device, 99)
    device.patience = 0
    device.reset(seed=0)
    assert device._protocol.sequence == 0
    native.reset(seed=0)
    assert_same_trajectory(trajectory(device, actions), trajectory(native, actions))
    device.close()


@pytest.mark.parametrize("completion", ["poll", "event"])
def test_hardware_that_is_reset_during_a_step(completion: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """There is nothing to wait for then."""
    monkeypatch.setattr(Xdma, "transport_type", AxiLink)
    device, native = axi_pair(completion)
    actions = ACTIONS[:, : N // 2].copy()
    assert_same_trajectory(trajectory(device, actions[:7]), trajectory(native, actions[:7]))
    with monkeypatch.context() as patch:
        reset = np.array([1], "<u4").view(np.uint8)
        patch.setattr(AxiLink, "wait", lambda self, step: self.write(4 * Control.RESET, reset))
        with pytest.raises(DeviceError, match="reports RESET: it was reset since the last call"):
            device.step(actions[7])
    device.recover()
    assert_same_trajectory(trajectory(device, actions[7:]), trajectory(native, actions[7:]))
    device.close()


def test_hardware_that_was_reset_between_two_steps(monkeypatch: pytest.MonkeyPatch) -> None:
    """By a button, say: it would go on from anywhere, and answer in time."""
    monkeypatch.setattr(Xdma, "transport_type", AxiLink)
    device, native = axi_pair("event")
    actions = ACTIONS[:, : N // 2].copy()
    assert_same_trajectory(trajectory(device, actions[:30]), trajectory(native, actions[:30]))
    device._protocol.transport.close()
    device._protocol.transport._open()
    with pytest.raises(DeviceError, match=r"reports RESET: it was reset since the last call, and has lost"):
        device.step(actions[30])
    device.recover()
    assert_same_trajectory(trajectory(device, actions[30:]), trajectory(native, actions[30:]))
    device.close()


def test_an_interrupt_that_is_not_wired(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Xdma, "transport_type", AxiLink)
    monkeypatch.setattr(AxiLink, "wired", False)
    device = Xdma(completion="event", timeout=0.01).open(BatchConfig(spec=SPEC, n_envs=N // 2))
    device.reset(seed=0)
    with pytest.raises(DeviceError, match=r"ended step 1, but no interrupt came .*use completion=\"poll\""):
        device.step(ACTIONS[0, : N // 2])
    device.close()


@pytest.mark.slow
def test_43008_agents_alike_on_every_device() -> None:
    """On few processing elements, which are compiled soon."""
    n, steps = 43008, 25
    config = BatchConfig(spec=SPEC, n_envs=n, max_cycles=10)
    actions = np.random.default_rng(1).integers(4, size=(steps, n), dtype=np.uint8)
    runs = []
    for device in (Native(), Rtl(8, 64), OwnBoard(8, 64)):
        device.open(config).reset(seed=2)
        runs.append(trajectory(device, actions))
        device.close()
    for run in runs[1:]:
        assert_same_trajectory(run, runs[0])


SERVE = """
import sys
from pearl_marl.cli import main
sys.argv = ["pearl", "serve", "CliffWalking", "--n-agents", "8", "--at", sys.argv[1]]
main()
"""


@contextlib.contextmanager
def pearl_serve(folder: Path) -> Iterator[subprocess.Popen[str]]:
    """Run `pearl serve` as a process of its own, until its files are there."""
    command = [sys.executable, "-c", SERVE, folder]
    server = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
        while not (folder / "xdma0_h2c_0").exists() and server.poll() is None:
            time.sleep(0.01)
        yield server
    finally:
        server.kill()
        server.communicate()


@pytest.mark.parametrize("size", [0, pytest.param(100, marks=pytest.mark.exhaustive)])
def test_a_server_whose_file_is_cut_says_so(size: int, tmp_path: Path) -> None:
    """It was killed by SIGBUS, without a word."""
    library(Build.of(SPEC, 8))  # of whose making it would tell
    with pearl_serve(tmp_path) as server:
        os.truncate(tmp_path / "xdma0_c2h_0", size)
        _, err = server.communicate(timeout=60)
        assert server.returncode == 2, err
        assert err.startswith(f"pearl: somebody has cut {tmp_path}/xdma0_c2h_0 to {size} of ")
        assert len(err.splitlines()) == 1
        assert sorted(tmp_path.iterdir()) == [tmp_path / SERVER_LOCK]


def test_a_device_whose_file_is_cut_says_so(tmp_path: Path) -> None:
    server = ServedBoard(tmp_path, SPEC, 8)  # which nobody lets serve yet
    link = XdmaTransport(str(tmp_path), None, 1.0)
    os.truncate(tmp_path / "xdma0_c2h_0", 100)
    with pytest.raises(DeviceError, match="its file was cut: start `pearl serve` there again"):
        link.read(0, np.empty(200, np.uint8))
    with pytest.raises(DeviceError, match="somebody has cut"):
        server.serve()
    link.close()
    server.close()


def test_space_for_a_board_is_there_from_the_beginning(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """On a full tmpfs a page that is written to for the first time is no more, and the process neither."""
    server = ServedBoard(tmp_path, SPEC, 8)
    found = (tmp_path / "xdma0_c2h_0").stat()
    assert found.st_size == server.layout.end("status")
    assert 512 * found.st_blocks >= found.st_size
    server.close()

    def full(*_: Any) -> None:
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(served_board.os, "posix_fallocate", full)
        with pytest.raises(DeviceError, match=r"no board can be served at .*No space left on device"):
            ServedBoard(tmp_path, SPEC, 8)
    assert sorted(tmp_path.iterdir()) == [tmp_path / SERVER_LOCK]
    server = ServedBoard(tmp_path, SPEC, 8)
    device = Xdma(tmp_path).open(BatchConfig(spec=SPEC, n_envs=8))
    device.reset(seed=0)
    monkeypatch.setattr(served_board.os, "pwrite", full)

    def step() -> None:
        with contextlib.suppress(DeviceError):
            device.step(ACTIONS[0, :8])

    thread = threading.Thread(target=step, daemon=True)
    thread.start()
    with pytest.raises(DeviceError, match=r"cannot be served any more: No space left on device; start"):
        server.serve()
    server.close()
    thread.join()
    device.close()


@pytest.mark.parametrize("make", [os.symlink, os.link], ids=["symbolic", "hard"])
@pytest.mark.parametrize("name", [SERVER_LOCK, "xdma0_c2h_0", "xdma0_h2c_0", "xdma0_events_0"])
def test_links_in_a_servers_folder_are_not_followed(name: str, make: Any, tmp_path: Path) -> None:
    dear, folder = tmp_path / "dear", tmp_path / "board"
    dear.write_text("dear")
    folder.mkdir()
    make(dear, folder / name)
    if name == SERVER_LOCK:
        with pytest.raises(DeviceError, match=r"no board can be served at .* it is a link, or no file"):
            ServedBoard(folder, SPEC, 8)
    else:
        with served(folder, SPEC, 8):
            device = Xdma(folder).open(BatchConfig(spec=SPEC, n_envs=8))
            device.reset(seed=0)
            device.step(ACTIONS[0, :8])
            device.close()
    assert dear.read_text() == "dear"


@pytest.mark.parametrize("name", ["xdma0_h2c_0", "xdma0_c2h_0"])
def test_a_device_follows_no_links(name: str, tmp_path: Path) -> None:
    dear = tmp_path / "dear"
    dear.write_bytes(bytes(1 << 16))
    folder = tmp_path / "board"
    with served(folder, SPEC, 8):
        (folder / name).unlink()
        (folder / name).symlink_to(dear)
        with pytest.raises(DeviceError, match="it is a symbolic link, which `pearl serve` makes none of"):
            Xdma(folder).open(BatchConfig(spec=SPEC, n_envs=8))
    assert not any(dear.read_bytes())


def test_a_lock_of_strange_content(tmp_path: Path) -> None:
    with (tmp_path / SERVER_LOCK).open("wb") as lock:
        lock.write(b"\xff\n\nsomething else")
        lock.flush()
        fcntl.flock(lock, fcntl.LOCK_EX)
        with pytest.raises(DeviceError, match="another process serves a board at") as caught:
            ServedBoard(tmp_path, SPEC, 8)
        assert len(str(caught.value).splitlines()) == 1
    assert (tmp_path / SERVER_LOCK).read_bytes() == b"\xff\n\nsomething else"
    ServedBoard(tmp_path, SPEC, 8).close()
