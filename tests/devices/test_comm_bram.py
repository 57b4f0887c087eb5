"""The host's half of the protocol, against hardware that answers wrongly."""

from __future__ import annotations

import numpy as np
import pytest

from pearl_marl import get_spec
from pearl_marl.devices import BatchConfig
from pearl_marl.devices.comm_bram import CommBram
from pearl_marl.devices.transport import Exchange, Transport
from pearl_marl.errors import DeviceError
from pearl_marl.hardware import elaboration
from pearl_marl.memory_map import (
    MAGIC,
    PROTOCOL_VERSION,
    Control,
    Doorbell,
    Mode,
    Status,
    StatusError,
    memory_map,
)

SPEC = get_spec("CliffWalking")
LAYOUT = memory_map(SPEC, 20, 4, 64)
ACTIONS = np.zeros(20, np.uint8)


class Memory(Transport):
    """A Comm-BRAM without hardware behind it: every doorbell is answered at once, with zeros."""

    def __init__(self) -> None:
        self.bytes = np.zeros(LAYOUT.end("status"), np.uint8)
        words = [MAGIC, PROTOCOL_VERSION, elaboration.env_hash(SPEC), 20, 4, 64, 6, 9]
        self.words("control")[: len(words)] = words
        self.transfers: list[tuple[str, int, int]] = []
        self.error, self.lag, self.resettable = StatusError(0), 0, True
        self.closed = False

    def words(self, region: str) -> np.ndarray:
        return self.bytes[LAYOUT[region].offset : LAYOUT.end(region)].view("<u4")

    def write(self, offset: int, data: np.ndarray) -> None:
        self.transfers.append(("write", offset, data.size))
        self.bytes[offset : offset + data.size] = data
        if self.words("control")[Control.RESET] and self.resettable:
            self.words("control")[Control.RESET] = self.words("doorbell")[:] = self.lag = 0
            self.error = StatusError.RESET
        self.words("status")[Status.SEQUENCE] = self.words("doorbell")[Doorbell.SEQUENCE] - self.lag
        self.words("status")[Status.ERROR] = self.error

    def read(self, offset: int, data: np.ndarray) -> None:
        self.transfers.append(("read", offset, data.size))
        data[:] = self.bytes[offset : offset + data.size]

    def wait(self, step: Exchange) -> None:
        pass

    def close(self) -> None:
        self.closed = True


class OverMemory(CommBram):
    name = "memory"

    def __init__(self) -> None:
        self.memory = Memory()

    def _connect(self, config: BatchConfig) -> tuple[Transport, object]:
        return self.memory, LAYOUT


@pytest.fixture
def device() -> OverMemory:
    return OverMemory()


def opened(device: OverMemory, **config: object) -> OverMemory:
    device.open(BatchConfig(spec=SPEC, n_envs=20, **config))
    device.reset(seed=0)
    return device


@pytest.mark.parametrize(
    ("word", "value", "says"),
    [
        (Control.MAGIC, 0xFFFFFFFF, f"magic 0xffffffff, this batch needs {MAGIC:#x}"),
        (
            Control.PROTOCOL_VERSION,
            2,
            "protocol_version 2, this batch needs 3: it is built by another version of this program",
        ),
        # With an engine for a table, which stands in the upper half.
        (Control.PROTOCOL_VERSION, 2 | 1 << 16, "protocol_version 2, this batch needs 3"),
        (Control.ENV_HASH, 5, "env_hash 0x5, this batch needs 0x"),
        (Control.N_ENVS, 4096, "n_envs 4096, this batch needs 20"),
        (Control.PE_NUM, 8, "pe_num 8, this batch needs 4"),
        (Control.DATA_WL, 512, "data_wl 512, this batch needs 64"),
        (Control.STATE_BITS, 7, "state_bits 7, this batch needs 6"),
        (Control.RESULT_BITS, 10, "result_bits 10, this batch needs 9"),
    ],
)
def test_other_hardware_is_refused(device: OverMemory, word: Control, value: int, says: str) -> None:
    device.memory.words("control")[word] = value
    with pytest.raises(DeviceError, match=says):
        opened(device)
    assert device.memory.closed


def test_a_step_is_one_write_and_one_read(device: OverMemory) -> None:
    opened(device)
    device.step(ACTIONS)
    device.memory.transfers.clear()
    for _ in range(3):
        device.step(ACTIONS)
    assert device.memory.transfers == [("write", *LAYOUT.step_write), ("read", *LAYOUT.step_read)] * 3


def test_a_reset_mask_travels_with_the_next_step(device: OverMemory) -> None:
    opened(device)
    device.step(ACTIONS)
    mask = np.arange(20) == 5
    device.reset(mask=mask)
    device.reset(mask=np.arange(20) == 7)
    device.memory.transfers.clear()
    device.step(ACTIONS)
    start = LAYOUT["reset_mask"].offset
    assert device.memory.transfers[0] == ("write", start, LAYOUT.end("doorbell") - start)
    assert device.memory.words("reset_mask")[0] == 1 << 5 | 1 << 7
    assert device.memory.words("doorbell")[Doorbell.MODE] == Mode.RESET_MASK
    device.step(ACTIONS)
    assert device.memory.words("doorbell")[Doorbell.MODE] == 0


@pytest.mark.parametrize(
    ("fault", "says"),
    [({"lag": 1}, "stale: they belong to step"), *(({"error": e}, f"reports {e.name}") for e in StatusError)],
)
def test_stale_and_torn_results_are_never_returned(device: OverMemory, fault: dict, says: str) -> None:
    opened(device)
    device.step(ACTIONS)
    vars(device.memory).update(fault)
    with pytest.raises(DeviceError, match=says):
        device.step(ACTIONS)
    device.memory.words("status")[Status.SEQUENCE] = device.memory.words("doorbell")[Doorbell.SEQUENCE]
    vars(device.memory).update(lag=0, error=StatusError(0))
    for call in (lambda: device.step(ACTIONS), device.state, lambda: device.reset(mask=ACTIONS == 0)):
        with pytest.raises(DeviceError, match=r"failed before; call reset\(\)"):
            call()
    device.reset()
    assert device.memory.words("doorbell")[Doorbell.SEQUENCE] == 2
    device.step(ACTIONS)
    assert device.memory.words("doorbell")[Doorbell.SEQUENCE] == 3


def test_what_does_not_end_is_reset(device: OverMemory) -> None:
    """A step that was left under way, once patience is at its end."""
    device.patience = 0.01
    device.memory.words("doorbell")[Doorbell.SEQUENCE] = 7
    opened(device)
    assert device.memory.error == StatusError.RESET
    device.memory.error = StatusError(0)
    device.step(ACTIONS)
    assert device.memory.words("doorbell")[Doorbell.SEQUENCE] == 1
    device.memory.lag, device.memory.resettable = 1, False
    with pytest.raises(DeviceError, match="stale"):
        device.step(ACTIONS)
    with pytest.raises(DeviceError, match=r"busy with step 2 for 0.01 s, and does not answer a reset; end"):
        device.reset()


def test_the_sequence_goes_on_where_the_hardware_was(device: OverMemory) -> None:
    device.memory.words("doorbell")[Doorbell.SEQUENCE] = 0xFFFFFFFF
    device.memory.words("status")[Status.SEQUENCE] = 0xFFFFFFFF
    opened(device)
    device.step(ACTIONS)
    assert device.memory.words("doorbell")[Doorbell.SEQUENCE] == 0


def test_settings_are_written_once(device: OverMemory) -> None:
    opened(device, max_cycles=7, first_slot=3)
    device.step(ACTIONS)
    control = device.memory.words("control")
    assert control[Control.TICK_LOW] == 0
    assert (control[Control.FIRST_SLOT], control[Control.MAX_CYCLES]) == (3, 7)
    device.reset()  # the next tick, in the midst of it
    device.step(ACTIONS)
    assert control[Control.TICK_LOW] == 2
    device.set_max_cycles(9)
    device.step(ACTIONS)
    assert control[Control.MAX_CYCLES] == 9


def test_a_reset_that_fails_resets_nobody(device: OverMemory, monkeypatch: pytest.MonkeyPatch) -> None:
    opened(device)
    device.step(ACTIONS)

    def broken(offset: int, data: np.ndarray) -> None:
        raise DeviceError("not now")

    with monkeypatch.context() as patch:
        patch.setattr(device.memory, "read", broken)
        with pytest.raises(DeviceError, match="not now"):
            device.reset(mask=np.arange(20) == 5)
    device.step(ACTIONS)
    assert device.memory.words("doorbell")[Doorbell.MODE] == 0


def test_settings_are_written_again_after_a_write_that_failed(
    device: OverMemory, monkeypatch: pytest.MonkeyPatch
) -> None:
    opened(device, max_cycles=7)
    device.step(ACTIONS)
    control = device.memory.words("control")
    device.set_max_cycles(9)

    def broken(offset: int, data: np.ndarray) -> None:
        Memory.write(device.memory, offset, data)
        raise DeviceError("not now")

    with monkeypatch.context() as patch:
        patch.setattr(device.memory, "write", broken)
        with pytest.raises(DeviceError, match="not now"):
            device.step(ACTIONS)
    assert control[Control.MAX_CYCLES] == 9, "it came through all the same"
    device.set_max_cycles(7)
    device.step(ACTIONS)
    assert control[Control.MAX_CYCLES] == 7
