"""A board at a serial port, and what may go wrong at it; tests/rtl/test_boards.py has the hardware."""

from __future__ import annotations

import contextlib
import os
import pty
import select
import struct
import threading
import time
import tty
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

import pearl_marl
from pearl_marl.devices import Serial
from pearl_marl.devices.serial import SerialTransport, request
from pearl_marl.devices.transport import Exchange
from pearl_marl.errors import DeviceError
from pearl_marl.hardware import elaboration
from pearl_marl.memory_map import MAGIC, PROTOCOL_VERSION

SPEC = pearl_marl.get_spec("CliffWalking")
IDENTITY = struct.pack("<8I", MAGIC, PROTOCOL_VERSION, elaboration.env_hash(SPEC), 7, 4, 32, 6, 9)


class Fake:
    """A memory at the other end of a pseudo-terminal, answering as ``pearl_uart_bridge`` does."""

    def __init__(self) -> None:
        self._board, self._host = pty.openpty()
        self._ending = os.eventfd(0)
        tty.setraw(self._host)
        self.port = os.ttyname(self._host)
        self.memory = bytearray(IDENTITY.ljust(1 << 20, b"\0"))
        self.response = 0
        self.damage: Callable[[bytes], bytes] = bytes
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    def _take(self, count: int) -> bytes:
        taken = b""
        while len(taken) < count:
            if self._ending in select.select([self._board, self._ending], [], [])[0]:
                raise OSError("unplugged")
            taken += os.read(self._board, count - len(taken))
        return taken

    def _serve(self) -> None:
        with contextlib.suppress(OSError):
            while True:
                header = self._take(7)
                operation, address, words = struct.unpack("<cIH", header)
                data = self._take(4 * words) if operation == b"W" else b""
                assert header + data + self._take(4) == request(operation.decode(), address, words, data)
                self.memory[address : address + len(data)] = data
                read = self.memory[address : address + 4 * words] if operation == b"R" else b""
                body = bytes(read) + bytes([self.response])
                answer = self.damage(body + struct.pack("<I", zlib.crc32(body)))
                while answer:
                    answer = answer[os.write(self._board, answer) :]

    def unplug(self) -> None:
        """End the board, and then close its files: another board may get their numbers."""
        if self._thread.is_alive():
            os.eventfd_write(self._ending, 1)
            self._thread.join()
            for file in (self._host, self._board, self._ending):
                os.close(file)


@pytest.fixture
def board() -> Iterator[Fake]:
    fake = Fake()
    yield fake
    fake.unplug()


def test_any_length_goes_through(board: Fake) -> None:
    transport = SerialTransport(board.port, timeout=1800)
    written = np.random.default_rng(1).integers(0, 256, 300_000, np.uint8)  # more than a request can have
    transport.write(64, written)
    read = np.zeros_like(written)
    transport.read(64, read)
    assert np.array_equal(read, written)
    transport.close()


@pytest.mark.parametrize(
    ("damage", "sentence"),
    [
        (lambda answer: b"", r"is 0 of 9 bytes long: check that it is loaded"),
        (lambda answer: answer[:-1], r"is 8 of 9 bytes long"),
        (lambda answer: bytes([answer[0] ^ 1]) + answer[1:], r"is damaged"),
        (lambda answer: answer[:-1] + bytes([answer[-1] ^ 1]), r"is damaged"),
    ],
)
def test_what_is_damaged_is_not_delivered(
    board: Fake, damage: Callable[[bytes], bytes], sentence: str
) -> None:
    transport = SerialTransport(board.port, timeout=2)
    board.damage = damage
    word = np.zeros(4, np.uint8)
    with pytest.raises(DeviceError, match=sentence):
        transport.read(0, word)
    assert not word.any()
    # The next answer is not taken for what is left of this one.
    board.damage, transport._timeout = bytes, 1800
    transport.read(4, word)
    assert word.view("<u4")[0] == PROTOCOL_VERSION
    transport.close()


@pytest.mark.parametrize(
    ("response", "sentence"),
    [(2, r"failed at R 0x10: the hardware refused it"), (3, r"there is nothing at that address")],
)
def test_responses_are_errors(board: Fake, response: int, sentence: str) -> None:
    transport = SerialTransport(board.port, timeout=1800)
    board.response = response
    with pytest.raises(DeviceError, match=sentence):
        transport.read(16, np.zeros(4, np.uint8))
    transport.close()


def test_a_wait_ends_with_the_step_or_with_patience(board: Fake) -> None:
    transport = SerialTransport(board.port, timeout=1800)
    step = Exchange(0, np.zeros(64, np.uint8), status_at=4)
    step.sequence = PROTOCOL_VERSION
    transport.wait(step)
    transport._timeout = 2
    began = time.monotonic()
    step.sequence = PROTOCOL_VERSION + 1
    transport.wait(step)
    assert time.monotonic() - began >= 2
    transport.close()


def test_one_process_at_a_time(board: Fake) -> None:
    first = SerialTransport(board.port, timeout=1800)
    with pytest.raises(DeviceError, match=r"is in use by another process"):
        SerialTransport(board.port, timeout=1800)
    first.close()
    SerialTransport(board.port, timeout=1800).close()


def test_what_is_no_port_is_told(tmp_path) -> None:
    with pytest.raises(DeviceError, match=r"tty_none cannot be opened: No such file.*; plug .*serial:PORT"):
        SerialTransport("/dev/tty_none", timeout=1800)
    (tmp_path / "file").touch()
    with pytest.raises(DeviceError, match=r"file cannot be used as a serial port"):
        SerialTransport(str(tmp_path / "file"), timeout=1800)


def test_a_board_for_something_else_is_refused(board: Fake) -> None:
    for name, n_agents, sentence in (
        ("CliffWalking", 8, r"the serial device has n_envs 7, this batch needs 8"),
        ("CliffWalking", 3, r"the serial device has n_envs 7, this batch needs 3"),
        (
            "FrozenLake",
            7,
            r"the serial device has env_hash .* it is built for CliffWalking-v0, not for FrozenLake-v0",
        ),
    ):
        with pytest.raises(DeviceError, match=sentence):
            pearl_marl.parallel_env(name, n_agents=n_agents, device=Serial(board.port, timeout=1800))


def test_an_unplugged_board_is_told(board: Fake) -> None:
    transport = SerialTransport(board.port, timeout=1800)
    board.unplug()
    with pytest.raises(DeviceError, match=r"the serial port .* failed: Input/output error"):
        transport.read(0, np.zeros(4, np.uint8))
    with pytest.raises(DeviceError, match=r"cannot be opened"):
        transport.reconnect()
    transport.close()


def test_a_board_that_is_plugged_in_again_is_found(board: Fake, tmp_path: Path) -> None:
    port, word = tmp_path / "port", np.zeros(4, np.uint8)
    port.symlink_to(board.port)
    transport = SerialTransport(str(port), timeout=1800)
    board.unplug()
    with pytest.raises(DeviceError, match=r"failed: Input/output error"):
        transport.read(0, word)
    again = Fake()
    port.unlink()
    port.symlink_to(again.port)
    transport.reconnect()
    transport.read(0, word)
    assert word.view("<u4")[0] == MAGIC
    transport.close()
    again.unplug()
