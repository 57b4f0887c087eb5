r"""A simulated board behind files that another process reads and writes as it would the driver's nodes.

::

    the host's process                           this process

    pwrite --> DIR/xdma0_h2c_0  \  one file,      settings, states, actions  -->  Simulation
                                 > read here      results, states, status    <--  (devices/simulator)
    pread  <-- DIR/xdma0_c2h_0  /
    poll   <-- DIR/xdma0_events_0, a FIFO    <--  an event, once the status is there

The file holds the board's whole address space. The kernel tells of every write (inotify). Where one rang
the doorbell, the regions that the host has changed go to the simulated board, the step is done, and
whatever the host can read goes back into the file: states first, then results, the status last, then
the event. So reads and writes return at once, as on a board, and a step takes its time.

The file is read and written by calls, and not mapped: a mapped one that is cut ends the process that
looks at it.

What a file cannot do: refuse an address, notice that it is read while a step runs, or reset a step that
runs. So the host has to wait for the event. A rollout, which may take long, tells how far it is meanwhile,
and a reset ends it.
"""

from __future__ import annotations

import contextlib
import ctypes
import errno
import fcntl
import os
import select
import stat
import struct
from pathlib import Path

import numpy as np
import numpy.typing as npt

from pearl_marl.base.files import open_lock
from pearl_marl.checks import checked_choice
from pearl_marl.devices.rtl import PATHS
from pearl_marl.devices.simulator.model_build import library
from pearl_marl.devices.simulator.simulation import Simulation
from pearl_marl.devices.xdma import SERVER_LOCK
from pearl_marl.errors import DeviceError
from pearl_marl.hardware.build import Build
from pearl_marl.memory_map import Control, Doorbell, Engine, Mode, Statistics, Status
from pearl_marl.spec import EnvSpec

Bytes = npt.NDArray[np.uint8]

_IN_MODIFY, _IN_NONBLOCK, _IN_CLOEXEC = 0x2, 0o4000, 0o2000000

_libc = ctypes.CDLL(None, use_errno=True)


class ServedBoard:
    """A simulated board, and the nodes through which other processes use it.

    Parameters
    ----------
    folder
        Where the nodes are made; it is made too. Best in memory, as ``/dev/shm`` is.
    spec, n_envs
        What the board is built for.
    pe_num, data_wl, path, engine
        As for :class:`~pearl_marl.devices.rtl.Rtl`.

    Attributes
    ----------
    spec, layout
        The environment, and the board's memory map.
    steps
        How many steps it has done, those of rollouts among them.

    Raises
    ------
    DeviceError
        Another process serves a board there, or it cannot be made.
    """

    _writes: int
    _stopping: int
    _rung: int

    def __init__(
        self,
        folder: str | os.PathLike[str],
        spec: EnvSpec,
        n_envs: int,
        pe_num: int | None = None,
        data_wl: int | None = None,
        path: str = "backdoor",
        engine: Engine | None = None,
    ) -> None:
        checked_choice("path", path, PATHS)
        build = Build.of(spec, n_envs, pe_num, data_wl, engine)
        self.spec, self.layout = build
        self._size = self.layout.end(self.layout.regions[-1].name)
        self.steps = 0
        self._folder = Path(folder)
        with contextlib.ExitStack() as opened:
            try:
                self._folder.mkdir(parents=True, exist_ok=True)
                self._lock(opened)
                for node in self._nodes():
                    node.unlink(missing_ok=True)  # of a killed server: a host that comes now waits for ours
                self._simulation = Simulation(library(build), build.layout, path == "backdoor", None)
                opened.callback(self._simulation.close)
                self._make_nodes(opened)
            except OSError as error:
                raise DeviceError(f"no board can be served at {folder}: {error}") from error
            self._opened = opened.pop_all()

    def serve(self) -> None:
        """Do the steps that are asked for, until :meth:`stop`.

        Raises
        ------
        DeviceError
            The simulation fails, or the file is cut or cannot be written any more.
        """
        try:
            self._serve()
        except OSError as error:
            raise DeviceError(
                f"the board at {self._folder} cannot be served any more: {error.strerror}; "
                "start `pearl serve` again"
            ) from error

    def _serve(self) -> None:
        poller = select.poll()
        poller.register(self._writes, select.POLLIN)
        poller.register(self._stopping, select.POLLIN)
        while True:
            ready = {file for file, _ in poller.poll()}
            if self._stopping in ready:
                return
            os.read(self._writes, 1 << 16)
            if (sequence := self._sequence()) != self._rung:
                self._rung = sequence
                self._step()
            elif self._resets():  # too late for the rollout that it was for
                self._reset()

    def stop(self) -> None:
        """Let :meth:`serve` return after the step that it is at; from any thread, or a signal's handler."""
        os.eventfd_write(self._stopping, 1)

    def close(self) -> None:
        """Remove the nodes and end the simulation."""
        self._opened.close()

    def _lock(self, opened: contextlib.ExitStack) -> None:
        lock = open_lock(self._folder / SERVER_LOCK)
        opened.callback(os.close, lock)
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            owner = os.pread(lock, 20, 0).strip()
            who = f"process {int(owner)}" if owner.isdigit() else "another process"
            raise DeviceError(
                f"{who} serves a board at {self._folder} already: end it first, or choose another folder"
            ) from None
        os.ftruncate(lock, 0)
        os.pwrite(lock, f"{os.getpid()}\n".encode(), 0)

    def _nodes(self) -> list[Path]:
        return [self._folder / f"xdma0_{name}_0" for name in ("h2c", "c2h", "events")]

    def _make_nodes(self, opened: contextlib.ExitStack) -> None:
        layout = self.layout
        h2c, c2h, events = self._nodes()
        for node in (h2c, c2h, events):
            opened.callback(node.unlink, missing_ok=True)
        os.mkfifo(events, 0o600)
        # For reading too, so that a host can tell by it that we are here.
        self._events = os.open(events, os.O_RDWR | os.O_NONBLOCK | os.O_NOFOLLOW)
        opened.callback(os.close, self._events)
        if not stat.S_ISFIFO(os.fstat(self._events).st_mode):
            raise OSError(errno.EEXIST, f"{events} has been replaced by something else")

        self._file = os.open(c2h, os.O_RDWR | os.O_CREAT | os.O_EXCL, 0o600)
        opened.callback(os.close, self._file)
        # Space is there from the beginning, or there would be none when a step needs it.
        os.posix_fallocate(self._file, 0, self._size)
        # What the host has written, and what both sides have seen: the memories of a board that has just
        # started hold anything.
        self._memory = np.zeros(self._size, np.uint8)
        self._shared = ~self._memory
        self._answer = np.empty(layout.step_read[1], np.uint8)
        settings = 4 * Control.SEED_0, 4 * (Control.MAX_CYCLES + 1)
        self._from_host = [settings]
        for name in ("initial_states", "current_states", "elapsed", "reset_mask"):
            self._from_host.append((layout[name].offset, layout.end(name)))
        self._to_host = [settings, (layout["current_states"].offset, layout.end("elapsed"))]
        stated = ["control", "doorbell"]
        if layout.engine is not None:
            self._to_host.append((layout["statistics"].offset, layout.end("statistics")))
            stated.append("statistics")
            # Zeros, so that what the host leaves out need not be written.
            begin, end = layout["policy"].offset, layout.end("policy")
            self._simulation.write(begin, self._memory[begin:end])
            self._shared[begin:end] = 0
        for name in stated:
            begin, end = layout[name].offset, layout.end(name)
            self._simulation.read(begin, self._memory[begin:end])
            self._put(begin, self._memory[begin:end])

        self._rung = self._sequence()

        self._writes = _libc.inotify_init1(_IN_NONBLOCK | _IN_CLOEXEC)
        if self._writes >= 0:
            opened.callback(os.close, self._writes)
        ours = f"/proc/self/fd/{self._file}".encode()  # whatever has its name by now
        if self._writes < 0 or _libc.inotify_add_watch(self._writes, ours, _IN_MODIFY) < 0:
            raise OSError(ctypes.get_errno(), f"inotify: {os.strerror(ctypes.get_errno())}")
        self._stopping = os.eventfd(0, os.EFD_CLOEXEC)
        opened.callback(os.close, self._stopping)
        os.link(c2h, h2c)  # last: a host that finds it finds all

    def _sequence(self) -> int:
        """Return the number of the step that was asked for last."""
        begin = self.layout["doorbell"].offset + 4 * Doorbell.SEQUENCE
        return int(self._get(begin, begin + 4).view("<u4")[0])

    def _get(self, begin: int, end: int) -> Bytes:
        """Read bytes of the file, where they belong in memory; return them."""
        part = self._memory[begin:end]
        done = 0
        while done < len(part):
            moved = os.preadv(self._file, [part.data[done:]], begin + done)
            self._check_size()
            done += moved
        return part

    def _put(self, begin: int, part: Bytes) -> None:
        self._check_size()  # or it would grow again, with zeros where there was something
        done = 0
        while done < len(part):
            done += os.pwrite(self._file, part.data[done:], begin + done)

    def _check_size(self) -> None:
        size, whole = os.fstat(self._file).st_size, self._size
        if size < whole:
            raise DeviceError(
                f"somebody has cut {self._nodes()[1]} to {size:,} of {whole:,} bytes: start `pearl serve` "
                "again, and leave its files to the programs that use the board"
            )

    def _step(self) -> None:
        # The doorbell may have been seen while the rest of its write was still being copied. The kernel
        # lets one change a file at a time, so this returns after that write.
        os.utime(self._file)
        memory, shared, simulation, layout = self._memory, self._shared, self._simulation, self.layout
        for begin, end in self._from_host:
            self._get(begin, end)
            if not np.array_equal(memory[begin:end], shared[begin:end]):
                shared[begin:end] = memory[begin:end]
                simulation.write(begin, shared[begin:end])
        write_at, length = layout.step_write
        read_at, _ = layout.step_read
        self._get(write_at, write_at + length)
        if not self._rings_rollout():
            simulation.step(write_at, memory[write_at : write_at + length], read_at, self._answer)
            self.steps += 1
        elif self._roll_out():
            simulation.read(read_at, self._answer)
        else:
            return
        for begin, end in self._to_host:
            simulation.read(begin, shared[begin:end])
            self._put(begin, shared[begin:end])
        status = layout["status"].offset
        self._put(read_at, self._answer[: status - read_at])
        self._put(status, self._answer[status - read_at :])
        # As in the driver, events that were not read are one.
        with contextlib.suppress(BlockingIOError):
            os.read(self._events, 1 << 12)
        os.write(self._events, struct.pack("=I", 1))

    def _rings_rollout(self) -> bool:
        mode = self.layout["doorbell"].offset + 4 * Doorbell.MODE
        rollout = int(self._memory[mode : mode + 4].view("<u4")[0]) & Mode.ROLLOUT
        return self.layout.engine is not None and bool(rollout)

    def _roll_out(self) -> bool:
        """Do a rollout; return whether it has ended, and was not given up."""
        layout, simulation = self.layout, self._simulation
        self._take_policy()
        steps = 4 * Control.STEPS
        simulation.write(steps, self._get(steps, steps + 4))
        begin, end = layout["doorbell"].offset, layout.end("doorbell")
        simulation.write(begin, self._memory[begin:end])
        status, sums = np.zeros(4 * len(Status), np.uint8), np.zeros(4 * Statistics.ENGINE, np.uint8)
        stopping = select.poll()
        stopping.register(self._stopping, select.POLLIN)
        while True:
            simulation.pause()
            simulation.read(layout["statistics"].offset, sums)
            simulation.read(layout["status"].offset, status)
            if status.view("<u4")[Status.SEQUENCE] == self._rung:
                self.steps += int(sums.view("<u4")[Statistics.STEPS])
                return True
            self._put(layout["statistics"].offset, sums)
            if stopping.poll(0):
                return False
            if self._resets():
                self._reset()
                return False

    def _resets(self) -> bool:
        """Return whether the host has asked for a reset."""
        return bool(self._get(4 * Control.RESET, 4 * Control.RESET + 4).any())

    def _take_policy(self) -> None:
        """Write the words of the policy that the host has changed."""
        begin, end, size = self.layout["policy"].offset, self.layout.end("policy"), self.layout.data_wl // 8
        new, old = self._get(begin, end).reshape(-1, size), self._shared[begin:end].reshape(-1, size)
        changed = np.flatnonzero((new != old).any(1))
        for run in np.split(changed, np.flatnonzero(np.diff(changed) > 1) + 1):
            if run.size:
                self._simulation.write(begin + size * int(run[0]), new[run[0] : run[-1] + 1].ravel())
        old[:] = new

    def _reset(self) -> None:
        """Reset the board in the middle of a rollout, as the host has asked for."""
        layout, simulation, reset = self.layout, self._simulation, 4 * Control.RESET
        simulation.write(reset, self._memory[reset : reset + 4])
        simulation.pause()
        self._rung = 0
        for begin, end in self._to_host:
            simulation.read(begin, self._shared[begin:end])
        for name in ("control", "doorbell", "status"):
            begin, end = layout[name].offset, layout.end(name)
            simulation.read(begin, self._memory[begin:end])
            self._put(begin, self._memory[begin:end])
