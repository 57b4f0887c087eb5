"""A board at a serial port: the protocol of ``rtl/boards/serial/pearl_uart_bridge.sv``, host's side.

::

    request  operation ("R" or "W") | byte address (4) | words (2) | data (4 a word, "W") | checksum (4)
    answer   data (4 a word, "R") | response (1) | checksum (4)

All numbers come lowest byte first; a word has 32 bits and a checksum is the CRC-32 of all before it.
What was damaged on the line is not answered, or recognised here: it raises, and is never delivered.
"""

from __future__ import annotations

import contextlib
import errno
import fcntl
import os
import select
import struct
import termios
import time
import tty
import zlib

import numpy as np

from pearl_marl.batch.config import BatchConfig
from pearl_marl.checks import checked_count_or_none
from pearl_marl.devices.comm_bram import CommBram
from pearl_marl.devices.recovery import CHECKPOINT_EVERY, CheckpointLog
from pearl_marl.devices.transport import Exchange, Transport, word
from pearl_marl.errors import DeviceError
from pearl_marl.hardware.codec import Stream

MAX_WORDS = 2**16 - 1
"""A request can have no more."""

WORD = 4
_CHECKSUM = struct.Struct("<I")
_RESPONSES = {2: "the hardware refused it (SLVERR)", 3: "there is nothing at that address (DECERR)"}


def request(operation: str, address: int, words: int, data: bytes = b"") -> bytes:
    """Return the bytes of a request."""
    body = struct.pack("<cIH", operation.encode(), address, words) + data
    return body + _CHECKSUM.pack(zlib.crc32(body))


def answer_bytes(words: int) -> int:
    """Return how long the answer to a request for so many words is."""
    return WORD * words + 1 + _CHECKSUM.size


_FIXES: dict[type[OSError], str] = {
    PermissionError: "; users in the group dialout may open it",
    FileNotFoundError: "; plug the board in, or name its port: serial:PORT",
}


class SerialTransport(Transport):
    """Moves bytes over a serial port, a request at a time; for its arguments see :class:`Serial`."""

    _file = -1

    def __init__(self, port: str, timeout: float) -> None:
        self._port, self._timeout = port, timeout
        self._lost = False
        self._open()

    def _open(self) -> None:
        port = self._port
        try:
            self._file = os.open(port, os.O_RDWR | os.O_NOCTTY)
        except OSError as error:
            fix = _FIXES.get(type(error), "")
            raise DeviceError(f"the serial port {port} cannot be opened: {error.strerror}{fix}") from None
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            tty.setraw(self._file)
            attributes = termios.tcgetattr(self._file)
            attributes[4:6] = [termios.B3000000] * 2
            termios.tcsetattr(self._file, termios.TCSANOW, attributes)
            # A program that was killed may have left half a request.
            self._resynchronise()
        except BlockingIOError:
            self.close()
            raise DeviceError(f"the serial port {port} is in use by another process") from None
        except (OSError, termios.error) as error:
            self.close()
            raise DeviceError(
                f"{port} cannot be used as a serial port at 3 Mbaud: {error.args[-1]}; name a board's port"
            ) from None

    def write(self, offset: int, data: Stream) -> None:
        """See :class:`Transport`."""
        for begin in range(0, data.size, WORD * MAX_WORDS):
            part = data[begin : begin + WORD * MAX_WORDS]
            self._call("W", offset + begin, part.size // WORD, part.tobytes())

    def read(self, offset: int, data: Stream) -> None:
        """See :class:`Transport`."""
        for begin in range(0, data.size, WORD * MAX_WORDS):
            part = data[begin : begin + WORD * MAX_WORDS]
            part[:] = np.frombuffer(self._call("R", offset + begin, part.size // WORD), np.uint8)

    def wait(self, step: Exchange) -> None:
        """Poll the status, for as long as an answer may take."""
        until = time.monotonic() + self._timeout
        while time.monotonic() < until and word(self, step.status_at) != step.sequence:
            pass

    def reconnect(self) -> None:
        """Open the port again, if it was lost."""
        if self._lost:
            self.close()
            self._open()
            self._lost = False

    def close(self) -> None:
        """Close the port, which also gives up the lock."""
        if self._file >= 0:
            os.close(self._file)
            self._file = -1

    def _call(self, operation: str, address: int, words: int, data: bytes = b"") -> bytes:
        sent = request(operation, address, words, data)
        length = answer_bytes(words if operation == "R" else 0)
        try:
            while sent:
                sent = sent[os.write(self._file, sent) :]
            answer = self._receive(length)
        except OSError as error:
            self._lost = True
            raise DeviceError(f"the serial port {self._port} failed: {error.strerror}") from None
        body = answer[: -_CHECKSUM.size]
        if len(answer) < length or _CHECKSUM.unpack_from(answer, len(body))[0] != zlib.crc32(body):
            self._resynchronise()
            what = "damaged" if len(answer) == length else f"{len(answer)} of {length} bytes long"
            raise DeviceError(
                f"the answer of the board at {self._port} is {what}: check that it is loaded, and the port"
            )
        if body[-1]:
            what = _RESPONSES.get(body[-1], f"response {body[-1]}")
            raise DeviceError(f"the board at {self._port} failed at {operation} {address:#x}: {what}")
        return body[:-1]

    def _receive(self, length: int) -> bytes:
        received = b""
        while len(received) < length and select.select([self._file], [], [], self._timeout)[0]:
            part = os.read(self._file, length - len(received))
            if not part:  # a port that was unplugged ends, and at once
                raise OSError(errno.EIO, os.strerror(errno.EIO))
            received += part
        return received

    def _resynchronise(self) -> None:
        """Make the board forget what it was told, and forget what it said."""
        with contextlib.suppress(termios.error):  # not every port can send a break
            termios.tcsendbreak(self._file, 0)
            termios.tcflush(self._file, termios.TCIOFLUSH)


class Serial(CommBram):
    """A board at a serial port, such as `pearl board ulx3s` makes a bitstream for.

    Parameters
    ----------
    port
        The port's device file.
    timeout
        Seconds without a byte after which the board is given up.
    checkpoint_every
        Steps between two states that are kept on the host for :meth:`recover`; ``None`` keeps nothing.
    """

    name = "serial"
    recovery_type = CheckpointLog

    def __init__(
        self,
        port: str = "/dev/ttyUSB0",
        timeout: float = 1.0,
        checkpoint_every: int | None = CHECKPOINT_EVERY,
    ) -> None:
        self.checkpoint_every = checked_count_or_none("checkpoint_every", checkpoint_every)
        self._port, self._timeout = port, timeout

    def _connect(self, config: BatchConfig) -> tuple[Transport, None]:
        return SerialTransport(self._port, self._timeout), None
