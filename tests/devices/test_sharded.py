"""Several devices as one: the results of one device, whatever has the slots."""

from __future__ import annotations

import copy
import threading
from concurrent import futures
from typing import Any

import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

from pearl_marl import get_spec
from pearl_marl.devices import BatchConfig, Device, Lockstep, Native, Phase, Sharded, make_device
from pearl_marl.errors import ActionError, ArgumentError, DeviceError
from pearl_marl.testing import assert_same_trajectory, trajectory

from .boards import OwnBoard

SPEC = get_spec("CliffWalking")
N = 70
ACTIONS = np.random.default_rng(0).integers(4, size=(40, N), dtype=np.uint8)


def opened(device: Device, n: int = N, **config: Any) -> Device:
    device.open(BatchConfig(**{"spec": SPEC, "n_envs": n, "max_cycles": 20, **config}))
    device.reset(seed=0)
    return device


def test_boards_of_equal_shares() -> None:
    """One environment over two boards."""
    device = opened(Sharded([OwnBoard(1), OwnBoard(1)]), first_slot=1000)
    assert [part.config.first_slot for part in device.parts] == [1000, 1035]
    assert_same_trajectory(trajectory(device, ACTIONS), trajectory(opened(Native()), ACTIONS))
    device.close()
    assert device.name == "xdma + xdma"


@pytest.mark.parametrize("mode", [AutoresetMode.SAME_STEP, AutoresetMode.NEXT_STEP], ids=lambda m: m.name)
def test_parts_of_any_kind_and_size(mode: AutoresetMode) -> None:
    """With all that can happen between steps, and saved states of either moved to the other."""
    blackjack = get_spec("Blackjack")
    config = {"spec": blackjack, "autoreset_mode": mode, "initial_states": "stored", "first_slot": 7}
    parts = ["reference", Lockstep("native"), Sharded(["native", "native"], sizes=[1, 9]), Native(threads=2)]
    device = opened(Sharded(parts, sizes=[3, 5, 10, 52]), **config)
    native = opened(Native(), **config)
    random = np.random.default_rng(0)
    for t, a in enumerate(ACTIONS % 2):
        if t % 9 == 4:
            mask = random.random(N) < 0.3
            np.testing.assert_array_equal(device.reset(mask=mask), native.reset(mask=mask))
        if t % 10 == 6:
            np.testing.assert_array_equal(device.reset(), native.reset())
        if t % 10 == 8:
            limit = (0, 5, 9, 0)[t // 10]
            device.set_max_cycles(limit)
            native.set_max_cycles(limit)
            device.set_rewards([t, 1, 2, 3])
            native.set_rewards([t, 1, 2, 3])
        if t == 25:
            saved = device.snapshot(), native.snapshot()
            np.testing.assert_array_equal(saved[0].memory, saved[1].memory)
            np.testing.assert_array_equal(saved[0].stored, saved[1].stored)
            np.testing.assert_array_equal(device.restore(saved[1]), native.restore(saved[0]))
        assert_same_trajectory(trajectory(device, [a]), trajectory(native, [a]))
    other = copy.deepcopy(device)
    assert_same_trajectory(trajectory(other, ACTIONS % 2), trajectory(native, ACTIONS % 2))
    device.close()
    other.close()


def test_the_first_seed_is_the_same_for_all() -> None:
    device = Sharded(["native", "native"]).open(BatchConfig(spec=get_spec("Blackjack"), n_envs=N))
    native = Native().open(BatchConfig(spec=get_spec("Blackjack"), n_envs=N))
    device.reset()
    native.restore(device.snapshot())
    assert_same_trajectory(trajectory(device, ACTIONS % 2), trajectory(native, ACTIONS % 2))


def test_parts_step_at_the_same_time() -> None:
    """All are under way before any is done."""
    meeting = threading.Barrier(3)

    class Meeting(Native):
        def _step(self, actions: np.ndarray) -> Any:
            meeting.wait(timeout=1800)
            return super()._step(actions)

    device = opened(Sharded([Meeting(), Meeting(), Meeting()]))
    device.step(ACTIONS[0])
    device.close()


def test_actions_are_checked_before_any_part_has_moved() -> None:
    device = opened(Sharded(["native", "native"]))
    before = device.state()
    bad = ACTIONS[0].copy()
    bad[50] = 9
    with pytest.raises(ActionError, match="agent_50: action 9"):
        device.step(bad)
    np.testing.assert_array_equal(device.state(), before)
    with pytest.raises(ArgumentError, match="reward table of shape"):
        device.set_rewards([1])
    with pytest.raises(ArgumentError, match="max_cycles"):
        device.set_max_cycles(-1)
    np.testing.assert_array_equal(device.state(), before)


class Failing(Native):
    """Fails when told to, before it has moved."""

    fails = False

    def _step(self, actions: np.ndarray) -> Any:
        if self.fails:
            self.fails = False
            raise DeviceError("failed")
        return super()._step(actions)


def test_a_part_that_fails_holds_the_others_back() -> None:
    failing = Failing()
    device, native = opened(Sharded(["native", failing])), opened(Native())
    for way_on in (lambda d: d.recover(), lambda d: d.reset(seed=3)):
        assert_same_trajectory(trajectory(device, ACTIONS[:7]), trajectory(native, ACTIONS[:7]))
        failing.fails = True
        with pytest.raises(DeviceError, match=r"^failed$"):
            device.step(ACTIONS[8])
        for call in (lambda: device.step(ACTIONS[8]), device.reset, device.snapshot):
            with pytest.raises(DeviceError, match=r"failed on some parts before; call recover\(\)"):
                call()
        way_on(device)
        way_on(native)
    assert_same_trajectory(trajectory(device, ACTIONS), trajectory(native, ACTIONS))


def test_a_ctrl_c_waits_for_the_parts(monkeypatch: pytest.MonkeyPatch) -> None:
    device, native = opened(Sharded(["native", "native"])), opened(Native())
    waits: list[Any] = []

    def wait(tasks: Any) -> None:
        waits.append(tasks)
        if len(waits) == 1:
            raise KeyboardInterrupt
        futures.wait(tasks)

    monkeypatch.setattr("pearl_marl.devices.sharded.wait", wait)
    with pytest.raises(KeyboardInterrupt):
        device.step(ACTIONS[0])
    assert all(task.done() for task in waits[0])
    device.recover()
    assert_same_trajectory(trajectory(device, ACTIONS), trajectory(native, ACTIONS))


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (([],), r"parts is \[\]; it must be a list of at least one device"),
        (("native",), "parts is 'native'; it must be a list"),
        ((["native", "nativ"],), "there is no device 'nativ'"),
        ((["native"], [0]), r"sizes is \[0\]; it must be 1 positive integers"),
        ((["native", "native"], [N]), r"sizes is \[70\]; it must be 2 positive integers"),
        ((["native", "native"], [30, 30]), "70 slots do not fall to 2 parts of 30, 30 slots; sizes= says"),
        ((["native"] * 71,), "70 slots do not fall to 71 parts"),
    ],
)
def test_illegal_parts(arguments: tuple, says: str) -> None:
    with pytest.raises(ArgumentError, match=says):
        opened(Sharded(*arguments))


def test_a_device_is_one_part() -> None:
    device = make_device("native")
    with pytest.raises(ArgumentError, match="the same device is among the parts twice"):
        Sharded([device, device])


def test_a_part_that_cannot_be_opened_closes_the_others(tmp_path: Any) -> None:
    first = Native()
    with pytest.raises(DeviceError, match="there is no board at"):
        opened(Sharded([first, f"xdma:{tmp_path}"]))
    assert first.phase is Phase.CLOSED
