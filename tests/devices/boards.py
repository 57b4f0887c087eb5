"""Boards for tests: simulated ones, served on a thread, and a link to them that fails at will."""

from __future__ import annotations

import contextlib
import errno
import os
import tempfile
import threading
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from pearl_marl.devices import BatchConfig, Xdma
from pearl_marl.devices.served import ServedBoard
from pearl_marl.devices.transport import Exchange, Transport
from pearl_marl.devices.xdma import XdmaTransport
from pearl_marl.memory_map import Engine, Status, StatusError

IN_MEMORY = "/dev/shm" if os.access("/dev/shm", os.W_OK) else None


@contextlib.contextmanager
def served(folder: Path | str, *arguments: Any, **options: Any) -> Iterator[ServedBoard]:
    """Serve a board on a thread; takes what :class:`ServedBoard` takes."""
    board = ServedBoard(folder, *arguments, **options)
    thread = threading.Thread(target=board.serve, daemon=True)  # or a test that fails would not end
    thread.start()
    try:
        yield board
    finally:
        board.stop()
        thread.join()
        board.close()


class OwnBoard(Xdma):
    """A board that is served for this device alone, whatever batch it is opened for."""

    def __init__(
        self,
        pe_num: int | None = None,
        data_wl: int | None = None,
        engine: Engine | None = None,
        **options: Any,
    ) -> None:
        super().__init__("", **options)
        self._sizes, self.engine = (pe_num, data_wl), engine

    def restart(self) -> None:
        """End the board's server and start another one: a board that comes back with nothing in it."""
        self._server.close()
        self._serve()

    def _serve(self) -> None:
        spec, n = self._batch
        self._server = contextlib.ExitStack()
        self._server.enter_context(served(self.board, spec, n, *self._sizes, engine=self.engine))

    def _connect(self, config: BatchConfig) -> tuple[Transport, None]:
        self._folder = tempfile.TemporaryDirectory(prefix="pearl-test-", dir=IN_MEMORY)
        self.board = self._folder.name
        self._batch = config.spec, config.n_envs
        self._serve()
        return super()._connect(config)

    def _close(self) -> None:
        super()._close()
        self._server.close()
        self._folder.cleanup()


NODE_ERRORS = (errno.EIO, errno.ETIMEDOUT, 512, errno.EINVAL, errno.EBUSY, errno.ENODEV)
"""What the driver answers where a transfer fails."""

ANY_CALL = ("short", "interrupted", "refused", "failed late", "dead")
ANSWERS = ("stale", "torn", "torn and stale", "flipped")
"""What may go wrong with any transfer, and with the one that reads a step's results."""


class Faults:
    """What goes wrong on a link, and what has; outlives its connections.

    ``plan`` holds what the next calls are to suffer, where it is possible for them; beyond it, each call
    suffers something with the probability ``rate``.
    """

    def __init__(self, seed: int = 0, rate: float = 0.0) -> None:
        self.random, self.rate = np.random.default_rng(seed), rate
        self.plan: list[str] = []
        self.error: int | None = None
        self.injected: Counter[str] = Counter()
        self.attempts_left = 0
        self.before: np.ndarray | None = None

    def around(self, call: Any, offset: int, data: np.ndarray, status: np.ndarray | None) -> int:
        """Make a system call, or something like it; ``status`` is where in ``data`` a step's status is."""
        # How often a single word is read, to wait for something, depends on time; faults must not.
        kind = self._next(status is not None) if data.size > 4 else None
        if kind is not None:
            self.injected[kind] += 1
        if kind == "interrupted":
            raise InterruptedError(errno.EINTR, "interrupted")
        if kind == "dead":
            self.attempts_left = 2
            raise OSError(errno.ENODEV, "no such device")
        if kind in ("refused", "failed late"):
            code = self.error or int(self.random.choice(NODE_ERRORS))
            if kind == "failed late":
                call(offset, data)
            raise OSError(code, os.strerror(code))
        if kind == "short":
            return int(call(offset, data[: self.random.integers(data.size)]))
        moved = int(call(offset, data))
        if status is not None:
            self._spoil(kind, data, status)
        return moved

    def _next(self, answer: bool) -> str | None:
        possible = ANY_CALL + ANSWERS * (answer and self.before is not None)
        if self.plan and self.plan[0] in possible:
            return self.plan.pop(0)
        if self.random.random() < self.rate:
            return str(self.random.choice(possible))
        return None

    def _spoil(self, kind: str | None, data: np.ndarray, status: np.ndarray) -> None:
        whole = data.copy()
        results = data.size - status.nbytes
        cut = int(self.random.integers(1, max(2, results)))
        if kind == "stale":
            data[:] = self.before
        elif kind == "torn and stale":
            data[cut:] = self.before[cut:]
        elif kind == "torn":  # the hardware knows, and says so
            data[:cut] = self.before[:cut]
            status[Status.ERROR] |= StatusError.TORN_READ
        elif kind == "flipped":
            status[self.random.integers(len(Status))] ^= np.uint32(1 << int(self.random.integers(32)))
        else:
            self.before = whole


class FaultyTransport(XdmaTransport):
    """A link whose system calls go wrong where its :class:`Faults` say."""

    faults: Faults
    status_at: int | None = None

    def exchange(self, step: Exchange) -> None:
        self.status_at = step.status_at
        super().exchange(step)

    def _lock(self) -> None:
        if self.faults.attempts_left:
            self.faults.attempts_left -= 1
            raise OSError(errno.ENODEV, "no such device", self._prefix)
        super()._lock()

    def _pwrite(self, offset: int, data: np.ndarray) -> int:
        return self.faults.around(super()._pwrite, offset, data, None)

    def _pread(self, offset: int, data: np.ndarray) -> int:
        status = None
        if self.status_at is not None and offset < self.status_at < offset + data.size:
            start = self.status_at - offset
            status = data[start : start + 4 * len(Status)].view("<u4")
        return self.faults.around(super()._pread, offset, data, status)


def faulty(device: Xdma, faults: Faults) -> Xdma:
    """Let a device that is not open yet use a link with these faults."""
    device.transport_type = type("FaultyTransport", (FaultyTransport,), {"faults": faults})
    return device
