"""The way to a Comm-BRAM and back: what moves bytes, one step on that way, and how long its stages take."""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from typing import Any

import numpy as np

from pearl_marl.hardware.codec import Stream
from pearl_marl.memory_map import Status, StatusError

STAGES = {"pack": "T1", "write": "T2", "compute": "T3-T5", "read": "T6", "unpack": "T7"}
"""The stages of a step, in their order, with the paper's names for their times."""


class Exchange:
    """A step on its way: what is written, where the answer goes, and whether that is the step's own.

    Results and status are read from byte address ``read_at`` on, the status at ``status_at``.
    """

    write_at: int
    """The byte address from which on ``data`` is written."""
    data: Stream
    sequence: int

    def __init__(self, read_at: int, answer: Stream, status_at: int) -> None:
        self.read_at, self.answer, self.status_at = read_at, answer, status_at
        start = status_at - read_at
        self.status_bytes = answer[start : start + 4 * len(Status)]
        self.status = self.status_bytes.view("<u4")

    @property
    def finished(self) -> int:
        """The sequence number of the step that the answer belongs to."""
        return int(self.status[Status.SEQUENCE])

    @property
    def error(self) -> StatusError:
        """What the hardware reports."""
        return StatusError(int(self.status[Status.ERROR]))

    @property
    def ended(self) -> bool:
        """Whether there is nothing to wait for: the status is this step's, or the hardware was reset."""
        return self.finished == self.sequence or bool(self.error & StatusError.RESET)

    @property
    def done(self) -> bool:
        """Whether none of the answer was read before the step had ended."""
        return self.ended and not self.error & StatusError.TORN_READ


class Transport(ABC):
    """Moves bytes to and from a Comm-BRAM; all of its methods raise DeviceError when they cannot."""

    timed = False
    """Whether to do a step in its stages, so that :attr:`times` are those of the last one."""

    times: tuple[float, float, float, float]
    """Begin and end of the write, then of the read that had the results, by ``time.perf_counter``."""

    @abstractmethod
    def write(self, offset: int, data: Stream) -> None:
        """Write all of ``data`` from byte address ``offset`` on."""

    @abstractmethod
    def read(self, offset: int, data: Stream) -> None:
        """Fill all of ``data`` from byte address ``offset`` on."""

    def begin(self) -> None:  # noqa: B027, as not every link keeps anything
        """Forget what is left of earlier steps, before another one is written."""

    @abstractmethod
    def wait(self, step: Exchange) -> None:
        """Return once a step has ended, or as soon as that is likely."""

    def pause(self) -> None:
        """Let some time pass while the hardware is busy with more than a step."""
        time.sleep(1e-4)

    def unfinished(self, step: Exchange, waited: float) -> bool:
        """Return whether to read again, ``waited`` seconds after the write; may pause, or raise."""
        return False

    def exchange(self, step: Exchange) -> None:
        """Do a whole step: write, wait, and read for as long as it is :meth:`unfinished`.

        Most steps have ended when they are first looked for, so all is read at once. Of one that has not,
        the status alone is read until it has, and then all once more.
        """
        self.begin()
        began = time.perf_counter()
        self.write(step.write_at, step.data)
        written = time.perf_counter()
        self.wait(step)
        while True:
            reading = time.perf_counter()
            self.read(step.read_at, step.answer)
            read = time.perf_counter()
            if not self.unfinished(step, read - written):
                break
            while not step.ended:
                self.read(step.status_at, step.status_bytes)
                if not step.ended:
                    self.unfinished(step, time.perf_counter() - written)
        self.times = began, written, reading, read

    def reconnect(self) -> None:  # noqa: B027, as not every connection can fail
        """Make the connection anew if it has failed."""

    @abstractmethod
    def close(self) -> None:
        """Release everything. Called once."""


def word(transport: Transport, offset: int) -> int:
    """Return the 32-bit word at a byte address."""
    found: Any = np.empty(4, np.uint8)
    transport.read(offset, found)
    return int(found.view("<u4")[0])
