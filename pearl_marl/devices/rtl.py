"""The hardware, simulated: the same SystemVerilog as on a board, under Verilator.

PyVerilator loads the model. A step is one call into it, and the host's half of the protocol is the
one that drives a board (:mod:`pearl_marl.devices.comm_bram`).
"""

from __future__ import annotations

import ctypes
import os
from pathlib import Path
from typing import Any

import numpy as np

from pearl_marl.batch.config import BatchConfig
from pearl_marl.devices.comm_bram import CommBram, Transport
from pearl_marl.devices.simulator import pyverilator_mends
from pearl_marl.devices.simulator.model_build import library
from pearl_marl.errors import ArgumentError, DeviceError
from pearl_marl.hardware.build import Build
from pearl_marl.hardware.codec import Stream
from pearl_marl.memory_map import MemoryMap

PATHS = ("backdoor", "axi")

# What simulation.cpp answers.
_ANSWERS = {
    1: "the AXI port did not take or answer a transfer",
    2: "the step did not end",
    3: "an assertion in the hardware failed; its message is on standard output",
    18: "the hardware refused a transfer (SLVERR)",
    19: "there is nothing at an address (DECERR)",
}


class Rtl(CommBram):
    """The simulated hardware.

    The first use of a configuration compiles it, which takes from seconds to a minute; the result is
    kept in the user's cache folder.

    Parameters
    ----------
    pe_num
        Processing elements, 1 to the number of slots; by default those of
        :func:`pearl_marl.memory_map.default_map`.
    data_wl
        Bits of a word, a power of two from 32 to 1024; likewise.
    path
        ``"backdoor"`` moves the bytes of a step straight into and out of the simulated memories, and
        states out, ``"axi"`` every one of them over the AXI port. The results are the same.
    trace
        A file to write the waveforms of all signals to (VCD). Slow, and large.
    pipelined
        Whether groups of slots overlap in the hardware. If not, one is read, computed and written after the
        other, as in the paper's form without pipeline: the same answers in more clock cycles.
    """

    name = "rtl"

    def __init__(
        self,
        pe_num: int | None = None,
        data_wl: int | None = None,
        path: str = "backdoor",
        trace: str | os.PathLike[str] | None = None,
        *,
        pipelined: bool = True,
    ) -> None:
        for name, value in (("pe_num", pe_num), ("data_wl", data_wl)):
            if value is not None and (isinstance(value, bool) or not isinstance(value, (int, np.integer))):
                raise ArgumentError(f"{name} is {value!r}; it must be an integer or None")
        if path not in PATHS:
            raise ArgumentError(f"path is {path!r}; possible are {', '.join(map(repr, PATHS))}")
        if not isinstance(pipelined, bool):
            raise ArgumentError(f"pipelined is {pipelined!r}; it must be True or False")
        self._trace = None if trace is None else os.fspath(trace)
        if self._trace is not None and not (isinstance(self._trace, str) and self._trace.isascii()):
            raise ArgumentError(f"trace is {trace!r}; it must be a file name in ASCII")
        self._pe_num, self._data_wl, self._path = pe_num, data_wl, path
        self._pipelined = pipelined

    @property
    def clock(self) -> int:
        """Clock cycles since the device was opened: of steps, and of every transfer over the AXI port."""
        self._check_idle("clock")
        return self._simulation.clock

    def peek(self, signal: str) -> int:
        """Return the present value of a signal, by its name in the hierarchy under ``pearl_top``.

        For example ``"irq_o"`` or ``"u_backbone.u_sequencer.busy_o"``. Verilator optimises signals
        away; with ``trace`` it keeps them all.

        Raises
        ------
        DeviceError
            The model has no such signal.
        """
        self._check_idle("peek")
        return self._simulation.peek(signal)

    def _connect(self, config: BatchConfig) -> tuple[Transport, MemoryMap]:
        spec, n = config.spec, int(config.n_envs)
        pe_num, data_wl = (None if value is None else int(value) for value in (self._pe_num, self._data_wl))
        build = Build.of(spec, n, pe_num, data_wl)
        built = library(build, traced=self._trace is not None, pipelined=self._pipelined)
        self._simulation = Simulation(built, build.layout, self._path == "backdoor", self._trace)
        return self._simulation, build.layout


class Simulation(Transport):
    """A simulated board: a model and the C++ around it (``simulation.cpp``).

    Parameters
    ----------
    built
        The model's library.
    layout
        Its memory map.
    backdoor
        Whether the regions of a step bypass the AXI port.
    trace
        Where to write waveforms, if the model was built for them.
    """

    def __init__(self, built: Path, layout: MemoryMap, backdoor: bool, trace: str | None) -> None:
        if trace is not None:
            try:
                Path(trace).touch()
            except OSError as error:
                raise DeviceError(f"the waveform file {trace} cannot be written: {error}") from error
        self._model = pyverilator_mends.load(built)
        self._functions = _declared(self._model.lib)
        self._traced = trace is not None
        if trace is not None:
            self._model.start_vcd_trace(trace, auto_tracing=False)
        names = ("reset_mask", "actions", "observations", "rewards", "ters", "current_states", "elapsed")
        bounds = np.zeros(2 * len(names), np.uint64)
        if backdoor:
            bounds[:] = [bound for name in names for bound in (layout[name].offset, layout.end(name))]
        # No core needs as many cycles for a slot, so a step that takes longer hangs.
        patience = 100_000 + 1000 * layout.n_envs
        self._host = self._functions.pearl_open(
            self._model.model, self._model.vcd_trace, patience, bounds.ctypes.data, layout.groups
        )

    @property
    def clock(self) -> int:
        """See :attr:`Rtl.clock`."""
        return int(self._functions.pearl_clock(self._host))

    def write(self, offset: int, data: Stream) -> None:
        """See :class:`Transport`."""
        self._check(self._functions.pearl_write(self._host, offset, data.ctypes.data, data.size))

    def read(self, offset: int, data: Stream) -> None:
        """See :class:`Transport`."""
        self._check(self._functions.pearl_read(self._host, offset, data.ctypes.data, data.size))

    def wait(self, sequence: int) -> None:
        """Clock until the interrupt."""
        self._check(self._functions.pearl_wait(self._host))

    def exchange(self, offset: int, data: Stream, answer_offset: int, answer: Stream, sequence: int) -> None:
        """Do a whole step in one call."""
        self._check(
            self._functions.pearl_step(
                self._host,
                offset,
                data.ctypes.data,
                data.size,
                answer_offset,
                answer.ctypes.data,
                answer.size,
            )
        )

    def peek(self, signal: str) -> int:
        """See :meth:`Rtl.peek`."""
        found = self._model.all_signals.get(tuple(signal.split(".")))
        if found is None:
            how = "" if self._traced else "; open the device with trace= to keep every signal"
            raise DeviceError(f"the simulated device has no signal {signal!r}{how}")
        return int(found.value)

    def close(self) -> None:
        """End the simulation, and the waveform file."""
        self._functions.pearl_close(self._host)
        if self._traced:
            self._model.stop_vcd_trace()
        del self._model

    @staticmethod
    def _check(answer: int) -> None:
        if answer:
            raise DeviceError(f"the simulated device failed: {_ANSWERS[answer]}")


def _declared(lib: Any) -> Any:
    """Tell ctypes the functions of ``simulation.cpp``."""
    pointer, size = ctypes.c_void_p, ctypes.c_uint64
    transfer = (size, pointer, size)
    for name, result, arguments in (
        ("pearl_open", pointer, (pointer, pointer, size, pointer, size)),
        ("pearl_close", None, (pointer,)),
        ("pearl_clock", size, (pointer,)),
        ("pearl_write", ctypes.c_int, (pointer, *transfer)),
        ("pearl_read", ctypes.c_int, (pointer, *transfer)),
        ("pearl_wait", ctypes.c_int, (pointer,)),
        ("pearl_step", ctypes.c_int, (pointer, *transfer, *transfer)),
    ):
        function = getattr(lib, name)
        function.restype, function.argtypes = result, arguments
    return lib
