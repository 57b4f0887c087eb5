"""A board behind the Xilinx XDMA driver, or a simulated one of ``pearl serve``, whose files look the same.

::

    XdmaTransport   --pwrite-->  /dev/xdma0_h2c_0     -->  Comm-BRAM
                    <--pread---  /dev/xdma0_c2h_0     <--
                    <--poll----  /dev/xdma0_events_0  <--  interrupt

A step is one ``pwrite`` and one ``pread``. They go through ctypes, as the driver's vectored calls
(``preadv``, ``writev``, io_uring) move wrong bytes, and ``os.pread`` would allocate.
"""

from __future__ import annotations

import contextlib
import ctypes
import errno
import fcntl
import os
import select
import sys
import time
from pathlib import Path
from typing import Any, ClassVar, NoReturn

import numpy as np

from pearl_marl.batch.config import BatchConfig
from pearl_marl.checks import checked_choice, checked_count_or_none, checked_number
from pearl_marl.devices import discovery
from pearl_marl.devices.comm_bram import CommBram
from pearl_marl.devices.recovery import CHECKPOINT_EVERY, CheckpointLog
from pearl_marl.devices.transport import Exchange, Transport
from pearl_marl.errors import ArgumentError, DeviceError
from pearl_marl.hardware.codec import Stream

COMPLETIONS = ("poll", "event")

DEV = "/dev"

_EVENT_BYTES = 4  # the driver's event nodes give exactly so many a call
_SPIN_SECONDS = 1e-3  # a step on a board takes microseconds; one that takes longer is looked at less often
_MAX_PAUSE = 10e-3

_ERESTARTSYS = 512  # of the kernel's own, which older drivers return where a transfer timed out
_FIXES = {
    errno.ETIMEDOUT: "the transfer timed out in the driver: see dmesg, and check that the FPGA is configured "
    "and its clock runs",
    errno.EINVAL: "the driver does not take this address or length: the XDMA core of the board must allow "
    "transfers of any alignment, or its bus must be no wider than the design's words",
    errno.EBUSY: "the driver's channel is taken: end other programs that use the board",
    errno.EIO: "the board did not take or answer the transfer: see dmesg, and check that the FPGA holds the "
    "design for this environment",
    errno.ENODEV: "there is no board any more: check its power and its slot, then load the driver again",
    errno.ENOTDIR: "name the folder of a board that `pearl serve` makes",
    errno.ELOOP: "it is a symbolic link, which `pearl serve` makes none of: remove it",
    errno.ENOSPC: "make room on the file system of the board's folder, and start `pearl serve` there again",
    errno.EBADF: "the connection is closed",
    errno.EACCES: "give your user the right to read and write the driver's nodes, with a udev rule",
}
_FIXES[_ERESTARTSYS] = _FIXES[errno.ETIMEDOUT]
_FIXES[errno.ENXIO] = _FIXES[errno.ENODEV]
_FIXES[errno.EPERM] = _FIXES[errno.EACCES]

SERVER_LOCK = "server.lock"
"""The file in a served board's folder that its server holds a lock on, from its beginning to its end."""

_SERVER_PAUSE = 0.1

_SERVE_AGAIN = "its process has ended: start `pearl serve` there again"

_libc = ctypes.CDLL(None, use_errno=True)
for _function in (_libc.pread, _libc.pwrite):
    _function.restype = ctypes.c_ssize_t
    _function.argtypes = (ctypes.c_int, ctypes.c_void_p, ctypes.c_size_t, ctypes.c_int64)


class XdmaTransport(Transport):
    """Moves bytes through the character devices of the XDMA driver; for its arguments see :class:`Xdma`."""

    _h2c = _c2h = _events = -1

    def __init__(self, board: int | str, completion: str | None, timeout: float) -> None:
        self._board, self._asked, self._timeout = board, completion, timeout
        if isinstance(board, int):
            self._prefix, self._called = f"{DEV}/xdma{board}", f"XDMA board {board}"
        else:
            self._prefix, self._called = f"{board}/xdma0", f"served board at {board}"
        self._failed = self._interrupted = False
        self._open()

    def write(self, offset: int, data: Stream) -> None:
        """See :class:`Transport`."""
        self._move(self._pwrite, "writing", offset, data)

    def read(self, offset: int, data: Stream) -> None:
        """See :class:`Transport`."""
        self._move(self._pread, "reading", offset, data)

    def begin(self) -> None:
        """Forget interrupts of steps that were not waited for to the end."""
        while self._events >= 0 and self._poller.poll(0):
            self._await_event(0)

    def wait(self, step: Exchange) -> None:
        """Wait for the interrupt, where that is how the end of a step is noticed."""
        if self._events >= 0:
            self._await_event(self._timeout)

    def pause(self) -> None:
        """Let some time pass, but no longer than until the interrupt, where there is one."""
        if self._events >= 0:
            self._await_event(_MAX_PAUSE)
        else:
            super().pause()

    def unfinished(self, step: Exchange, waited: float) -> bool:
        """Have what is not of this step, or was read before its end, read again until the time is over."""
        if step.done and (self._interrupted or self._events < 0 or step.error):
            return False
        if step.done:
            self._fail(
                f"ended step {step.sequence}, but no interrupt came within {waited:.3g} s",
                'check that it is wired, or use completion="poll"',
            )
        if waited > self._timeout:
            self._fail(
                f"did not end step {step.sequence} within {self._timeout:g} s: its status is of step "
                f"{step.finished}, error {int(step.error)}",
                "check that its clock runs, or give a longer timeout",
            )
        self._pause(waited)
        return True

    def reconnect(self) -> None:
        """Open the nodes again, if anything has failed since they were opened, or the server has ended."""
        served = isinstance(self._board, str) and self._events >= 0
        server_ended = served and any(what & ~select.POLLIN for _, what in self._poller.poll(0))
        if self._failed or server_ended:
            self.close()
            self._open()
            self._failed = False

    def close(self) -> None:
        """Close the nodes, and with them give the board back."""
        for node in (self._events, self._c2h, self._h2c):
            if node >= 0:
                os.close(node)
        self._h2c = self._c2h = self._events = -1

    def __del__(self) -> None:
        self.close()  # or a board that was not closed would stay in use

    def _open(self) -> None:
        if isinstance(self._board, str):
            await_server(Path(self._board))
        # A served board's folder may be one of several users, and a link in it lead to any file of ours.
        links = os.O_NOFOLLOW if isinstance(self._board, str) else 0
        try:
            self._h2c = os.open(f"{self._prefix}_h2c_0", os.O_WRONLY | links)
            self._lock()
            self._c2h = os.open(f"{self._prefix}_c2h_0", os.O_RDONLY | links)
            self._open_events()
        except FileNotFoundError as error:
            self.close()
            raise DeviceError(self._why_missing(error.filename)) from None
        except OSError as error:
            self.close()
            fix = _FIXES.get(error.errno or 0, "see dmesg")
            raise DeviceError(f"{self._called}: {error.filename}: {error.strerror}; {fix}") from error
        except BaseException:
            self.close()
            raise

    def _lock(self) -> None:
        """Let one process at a time, and one device in it, use the board."""
        try:
            fcntl.flock(self._h2c, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            owner = _lock_owner(os.fstat(self._h2c))
            who = "this process" if owner == os.getpid() else f"process {owner}" if owner else "somebody"
            raise DeviceError(
                f"{self._called} is in use by {who}: close that environment, or end that process"
            ) from None

    def _open_events(self) -> None:
        """Open the node of the interrupt, if it is to be waited for.

        A served board's is a FIFO that its process holds open: so we learn when that ends.
        """
        path = f"{self._prefix}_events_0"
        served = Path(path).is_fifo()
        if served:
            if self._asked == "poll":
                raise ArgumentError(
                    'completion is "poll"; a served board tells the end of a step by an event only, as a '
                    "file cannot tell that it was read while it was written"
                )
            try:
                os.close(os.open(path, os.O_WRONLY | os.O_NONBLOCK))
            except OSError:  # no process has it open for reading
                raise DeviceError(f"{self._called} is gone; {_SERVE_AGAIN}") from None
        if served or self._asked == "event":
            self._events = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
            self._poller = select.poll()
            self._poller.register(self._events, select.POLLIN)

    def _why_missing(self, path: str) -> str:
        if not isinstance(self._board, int):
            return (
                f"there is no board at {self._board}: there is no {path}; serve one there with: "
                f"pearl serve ENV --n-agents N --at {self._board}"
            )
        found = [f"{b.number} ({b.device_id} in slot {b.slot})" for b in discovery.boards()]
        waiting = discovery.boards_without_driver()
        if found:
            fix = f"there are boards {', '.join(found)}"
        elif waiting:
            fix = f"a Xilinx device in slot {', '.join(waiting)} has no driver: load it with: modprobe xdma"
        else:
            fix = f"nor a PCI device of vendor {discovery.XILINX}: check the board's power and its slot"
        return (
            f"there is no XDMA board {self._board}: there is no {path}; {fix}. Without a board, serve a "
            "simulated one with: pearl serve ENV --n-agents N --at DIR, and use device='xdma:DIR'"
        )

    def _pwrite(self, offset: int, data: Stream) -> int:
        return _moved(_libc.pwrite(self._h2c, data.ctypes.data, data.size, offset))

    def _pread(self, offset: int, data: Stream) -> int:
        return _moved(_libc.pread(self._c2h, data.ctypes.data, data.size, offset))

    def _move(self, call: Any, doing: str, offset: int, data: Stream) -> None:
        while True:
            try:
                moved = call(offset, data)
                break
            except InterruptedError:
                continue
            except OSError as error:
                code = error.errno or 0
                name = errno.errorcode.get(code, str(code))
                self._fail(
                    f"failed {doing} {data.size} bytes at {offset:#x} ({name})", _FIXES.get(code, "see dmesg")
                )
        if moved != data.size:
            self._fail(
                f"moved {moved} of {data.size} bytes {doing} at {offset:#x}",
                "the driver gave the transfer up half way: see dmesg"
                if isinstance(self._board, int)
                else "its file was cut: start `pearl serve` there again",
            )

    def _await_event(self, seconds: float) -> None:
        """Return at the next interrupt, or when the time is over: the status tells which."""
        for _, happened in self._poller.poll(seconds * 1000):
            if happened & select.POLLIN:
                self._interrupted = True
                with contextlib.suppress(BlockingIOError):
                    os.read(self._events, _EVENT_BYTES)
            else:
                self._fail("is gone", _SERVE_AGAIN if isinstance(self._board, str) else _FIXES[errno.ENODEV])

    def _pause(self, waited: float) -> None:
        if self._events >= 0:
            self._await_event(min(waited / 10, _MAX_PAUSE))
        elif waited > _SPIN_SECONDS:
            time.sleep(min(waited / 10, _MAX_PAUSE))

    def _fail(self, what: str, fix: str) -> NoReturn:
        self._failed = True
        then = ". Then call recover()" if self.recoverable else ""
        raise DeviceError(f"{self._called} {what}; {fix}{then}")


def _moved(answer: int) -> int:
    """Return how many bytes a system call moved, or raise what it failed with."""
    if answer < 0:
        raise OSError(ctypes.get_errno(), os.strerror(ctypes.get_errno()))
    return answer


def await_server(folder: Path) -> None:
    """Wait while a server there has begun, and not made its nodes yet: its model has to be compiled."""
    told = False
    while not (folder / "xdma0_h2c_0").exists():
        try:
            owner = _lock_owner((folder / SERVER_LOCK).stat())
        except OSError:
            return
        if owner is None:
            return
        if not told:
            print(f"pearl: waiting for process {owner}, which makes a board at {folder}", file=sys.stderr)
        told = True
        time.sleep(_SERVER_PAUSE)


def _lock_owner(of_file: os.stat_result) -> int | None:
    """Return the process that holds a lock on a file, if the system tells."""
    major, minor = os.major(of_file.st_dev), os.minor(of_file.st_dev)
    name = f"{major:02x}:{minor:02x}:{of_file.st_ino}"
    with contextlib.suppress(OSError):
        for line in Path("/proc/locks").read_text().splitlines():
            fields = line.split()
            if "FLOCK" in fields and name in fields:
                return int(fields[fields.index(name) - 1])
    return None


class Xdma(CommBram):
    """A board behind the XDMA driver.

    Parameters
    ----------
    board
        Its number *N* in ``/dev/xdmaN_h2c_0``, or the folder of a board that ``pearl serve`` simulates.
    completion
        How the end of a step is noticed. ``"poll"`` reads the results at once; if they are not yet those
        of the step, it reads the status until it is, and the results again. ``"event"`` waits for the
        board's interrupt first. ``None`` is ``"event"`` for a served board, which knows no other way, and
        ``"poll"`` for a real one.
    timeout
        Seconds until a step is given up, or a rollout that gets no further.
    checkpoint_every
        Steps between two states that are kept on the host for :meth:`recover`; ``None`` keeps nothing.
    """

    name = "xdma"
    recovery_type = CheckpointLog
    transport_type: ClassVar[type[XdmaTransport]] = XdmaTransport
    """What moves the bytes; tests put links that fail in its place."""

    def __init__(
        self,
        board: int | str | os.PathLike[str] = 0,
        completion: str | None = None,
        timeout: float = 10.0,
        checkpoint_every: int | None = CHECKPOINT_EVERY,
    ) -> None:
        self.checkpoint_every = checked_count_or_none("checkpoint_every", checkpoint_every)
        if isinstance(board, (str, os.PathLike)):
            self.board: int | str = os.fspath(board)
        elif isinstance(board, (int, np.integer)) and not isinstance(board, bool) and board >= 0:
            self.board = int(board)
        else:
            raise ArgumentError(f"board is {board!r}; it must be a number from 0 on, or a folder")
        self._completion = checked_choice("completion", completion, (*COMPLETIONS, None))
        self.patience = checked_number("timeout", timeout, above=0, below=1e6)

    def _connect(self, config: BatchConfig) -> tuple[Transport, None]:
        return self.transport_type(self.board, self._completion, self.patience), None
