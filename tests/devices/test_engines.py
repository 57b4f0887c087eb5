"""Policy engines behind links: rollouts of boards, and what may go wrong in the middle of one."""

from __future__ import annotations

import contextlib
import threading
import time
from collections import Counter
from collections.abc import Iterator
from typing import Any
from unittest import mock

import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

from pearl_marl import get_spec
from pearl_marl.devices import BatchConfig, Device, Lockstep, Native, Rtl, Serial, Sharded
from pearl_marl.devices.base import Phase
from pearl_marl.devices.link_rollout import LinkRollout
from pearl_marl.devices.simulator.model_build import library
from pearl_marl.devices.simulator.simulation import Simulation
from pearl_marl.devices.xdma import XdmaTransport
from pearl_marl.errors import DeviceError, LockstepError
from pearl_marl.hardware.build import Build
from pearl_marl.memory_map import Engine, Mode, Statistics

from ..rtl.random_policies import random_table
from .boards import Faults, OwnBoard, faulty
from .rolling import TABLE
from .test_serial import Fake

SPEC = get_spec("CliffWalking")
CONFIG = {"spec": SPEC, "n_envs": 7, "max_cycles": 13}
ENDLESS = (1 << 32) - 1


def policy_of(seed: int, drawn: bool = True) -> Any:
    return random_table(np.random.default_rng(seed), SPEC, 6, drawn)


POLICY, OTHER = policy_of(0), policy_of(1, drawn=False)


def board(**options: Any) -> OwnBoard:
    return OwnBoard(4, 32, engine=TABLE, **options)


def opened(device: Device, **config: Any) -> Device:
    device.open(BatchConfig(**{**CONFIG, **config}))
    device.reset(seed=3)
    return device


def assert_same_sums(ours: Any, theirs: Any) -> None:
    assert (ours.episodes, ours.truncated.sum()) == (theirs.episodes, theirs.truncated.sum())
    assert (ours.lengths.sum(), ours.returns.sum()) == (theirs.lengths.sum(), theirs.returns.sum())


def assert_same_place(ours: Device, theirs: Device) -> None:
    assert ours.tick == theirs.tick
    assert np.array_equal(ours.snapshot().memory, theirs.snapshot().memory)


def assert_goes_on(ours: Device, theirs: Device, steps: int = 30) -> None:
    assert_same_sums(ours.rollout(POLICY, steps), theirs.rollout(POLICY, steps))
    assert_same_place(ours, theirs)


@pytest.mark.parametrize("mode", list(AutoresetMode)[:2])
def test_a_board_rolls_out_by_itself(mode: AutoresetMode) -> None:
    """And says what engine it has: nobody tells the host."""
    device, native = opened(board(), autoreset_mode=mode), opened(Native(), autoreset_mode=mode)
    assert device.has_engine
    for policy, steps in ((POLICY, 40), (OTHER, 1), (POLICY, 25)):
        assert_same_sums(device.rollout(policy, steps), native.rollout(policy, steps))
        idle = np.zeros(7, np.uint8)
        assert np.array_equal(device.step(idle).rewards, native.step(idle).rewards)
        assert_same_place(device, native)
    mask = np.arange(7) % 2 == 0
    assert np.array_equal(device.reset(mask=mask), native.reset(mask=mask))
    assert_goes_on(device, native)
    device.close()


def test_bytes_over_the_link_of_a_board_do_not_grow_with_steps() -> None:
    device = opened(board())
    device.rollout(POLICY, 5)
    moved: Counter[str] = Counter()
    status = device._protocol.layout["status"].offset  # type: ignore[attr-defined]

    def counting(name: str) -> Any:
        real = getattr(XdmaTransport, name)

        def call(self: Any, offset: int, data: Any) -> int:
            moved[name] += data.nbytes * (offset != status)  # which is asked for until the end
            return int(real(self, offset, data))

        return call

    counts = []
    for steps in (10, 1000):
        moved.clear()
        names = ("_pwrite", "_pread")
        with mock.patch.multiple(XdmaTransport, **{name: counting(name) for name in names}):
            device.rollout(POLICY, steps)
        counts.append(dict(moved))
    assert counts[0] == counts[1]
    assert counts[0]["_pread"] == 4 * Statistics.ENGINE
    assert counts[0]["_pwrite"] < 100
    device.close()


def test_faults_at_random_places() -> None:
    faults, random = Faults(seed=5), np.random.default_rng(2)
    device, native = faulty(board(checkpoint_every=5), faults), opened(Native())
    opened(device)
    errors = 0

    def call(name: str, *arguments: Any) -> tuple[Any, Any]:
        nonlocal errors
        while True:
            try:
                ours = getattr(device, name)(*arguments)
                break
            except DeviceError:
                errors += 1
                while True:
                    with contextlib.suppress(DeviceError):
                        device.recover()
                        break
        return ours, getattr(native, name)(*arguments)

    faults.rate = 0.04
    for k in range(60):
        assert_same_sums(*call("rollout", (POLICY, OTHER)[k % 2], int(random.integers(1, 20))))
        if k % 3 == 0:
            ours, theirs = call("step", random.integers(0, 4, 7, dtype=np.uint8))
            assert np.array_equal(ours.rewards, theirs.rewards)
        if k % 20 == 9:
            device.restart()
        if k % 7 == 3:
            call("reset", None, random.random(7) < 0.5)
    faults.rate = 0
    assert errors > 10
    assert_same_place(device, native)
    device.close()


@contextlib.contextmanager
def in_the_middle(act: Any, at: int = 3) -> Iterator[None]:
    """Do something as soon as a rollout is under way."""
    real, count = XdmaTransport.pause, 0

    def pause(self: Any) -> None:
        nonlocal count
        count += 1
        if count == at:
            act()
        real(self)

    with mock.patch.object(XdmaTransport, "pause", pause):
        yield


def interrupt() -> None:
    raise KeyboardInterrupt


def test_a_board_is_killed_in_the_middle() -> None:
    device, native = opened(board()), opened(Native())
    assert_goes_on(device, native)
    with in_the_middle(device._server.close), pytest.raises(DeviceError, match="is gone"):
        device.rollout(POLICY, ENDLESS)
    assert device.phase is Phase.FAILED
    with pytest.raises(DeviceError, match=r"recover\(\)"):
        device.rollout(POLICY, 1)
    device._serve()
    device.recover()
    assert_same_place(device, native)
    assert_goes_on(device, native)
    device.close()


def test_a_rollout_that_is_given_up_ends_at_once() -> None:
    device, native = opened(board()), opened(Native())
    with in_the_middle(interrupt), pytest.raises(KeyboardInterrupt):
        device.rollout(POLICY, ENDLESS)
    assert device.phase is Phase.FAILED
    began = time.monotonic()
    device.recover()
    assert time.monotonic() - began < device.patience / 2
    assert_same_place(device, native)
    assert_goes_on(device, native)
    device.close()


def test_a_server_ends_in_the_middle_of_a_rollout() -> None:
    device = opened(board())
    thread = threading.Timer(0.3, device._server.close)
    thread.start()
    with pytest.raises(DeviceError, match="is gone"):
        device.rollout(POLICY, ENDLESS)
    thread.join()
    device.close()


@pytest.mark.parametrize("engine", [None, TABLE._replace(table_rows=128)])
def test_another_bitstream_is_refused(engine: Engine | None) -> None:
    device = opened(board())
    right = device.engine
    device._server.close()
    device.engine = engine
    device._serve()
    for _ in range(2):
        with pytest.raises(DeviceError):
            device.rollout(POLICY, 3)
        with pytest.raises(DeviceError, match="another policy engine than this batch has been opened for"):
            device.recover()
    device._server.close()
    device.engine = right
    device._serve()
    device.recover()
    device.rollout(POLICY, 3)
    device.close()


class Stuck:
    """A link to hardware that does nothing."""

    def write(self, offset: int, data: Any) -> None: ...

    def read(self, offset: int, data: Any) -> None:
        data[:] = 0

    def pause(self) -> None: ...


def test_a_rollout_that_gets_no_further_is_given_up() -> None:
    layout = Build.of(SPEC, 7, 4, 32, TABLE).layout
    run = LinkRollout.of(POLICY, layout, SPEC, np.array([-1, -100], np.float32), 50, 13)
    with pytest.raises(DeviceError, match=r"has done 0 of 50 steps of a rollout, and none for 0\.01 s"):
        run.run(Stuck(), Mode(0), 1, 0.01)  # type: ignore[arg-type]


def test_boards_share_slots() -> None:
    parts = [OwnBoard(2, 32, engine=TABLE), Rtl(2, 32, engine=TABLE)]
    device, native = opened(Sharded(parts), n_envs=8), opened(Native(), n_envs=8)
    assert device.has_engine
    assert_goes_on(device, native)
    native.rollout(POLICY, 9)
    device.rollout(POLICY, 9)
    with in_the_middle(interrupt, at=1), pytest.raises(KeyboardInterrupt):
        device.rollout(POLICY, 100)
    assert device.phase is Phase.FAILED
    device.recover()
    assert_same_place(device, native)
    assert_goes_on(device, native)
    device.close()


def test_an_engine_in_lockstep() -> None:
    device, native = opened(Lockstep(Rtl(4, 32, engine=TABLE), "reference")), opened(Native())
    assert device.has_engine
    assert_goes_on(device, native, 20)
    assert device.words_compared
    device.close()


class Wrong(Native):
    """Takes another policy from a tick on."""

    def rollout(self, policy: Any, steps: int, record: bool = False, episodes: int | None = None) -> Any:
        for _ in range(steps):
            result = super().rollout(OTHER if self.tick >= 12 else policy, 1, record, episodes)
        return result


def test_the_first_step_of_a_rollout_that_differs_is_found() -> None:
    device = opened(Lockstep(Wrong(), "native"))
    device.rollout(POLICY, 1)
    with pytest.raises(LockstepError) as error:
        device.rollout(POLICY, 30)
    assert error.value.divergence.call == "rollout"
    assert 12 <= error.value.divergence.step < 20, "policies that differ may do the same for a while"
    assert device.tick == 1
    device.close()


class Simulated:
    """A simulated board as the memory of a fake one at a serial port."""

    def __init__(self, engine: Engine = TABLE) -> None:
        build = Build.of(SPEC, 7, 4, 32, engine)
        self._simulation = Simulation(library(build), build.layout, False, None)

    def __setitem__(self, place: slice, data: bytes) -> None:
        if data:
            self._simulation.write(place.start, np.frombuffer(data, np.uint8))

    def __getitem__(self, place: slice) -> bytes:
        self._simulation.pause()
        data = np.zeros(place.stop - place.start, np.uint8)
        self._simulation.read(place.start, data)
        return data.tobytes()


def test_a_serial_board_rolls_out_by_itself() -> None:
    fake = Fake()
    fake.memory = Simulated()  # type: ignore[assignment]
    device, native = opened(Serial(fake.port, timeout=20)), opened(Native())
    assert device.has_engine
    assert_goes_on(device, native)
    device.close()
    fake.unplug()
