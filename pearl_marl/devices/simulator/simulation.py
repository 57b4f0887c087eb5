"""A simulated board: a model, loaded by PyVerilator, and the C++ around it (``simulation.cpp``)."""

from __future__ import annotations

import ctypes
from pathlib import Path
from typing import Any

import numpy as np

from pearl_marl.devices.simulator import pyverilator_model
from pearl_marl.devices.transport import Exchange, Transport
from pearl_marl.errors import DeviceError
from pearl_marl.hardware.codec import Stream
from pearl_marl.memory_map import MemoryMap

# What simulation.cpp answers.
_ANSWERS = {
    1: "the AXI port did not take or answer a transfer",
    2: "the step did not end",
    3: "an assertion in the hardware failed; its message is on standard output",
    18: "the hardware refused a transfer (SLVERR)",
    19: "there is nothing at an address (DECERR)",
}


_NOT_ENDED = 2

_PAUSE_CYCLES = 10_000
"""So many take less than a second to simulate, of the largest designs, too."""


class Simulation(Transport):
    """A simulated board as a transport.

    ``built`` is the model's library. With ``backdoor`` the regions of a step bypass the AXI port. ``trace``
    is where to write waveforms, if the model was built for them.
    """

    def __init__(self, built: Path, layout: MemoryMap, backdoor: bool, trace: str | None) -> None:
        self._model = pyverilator_model.load(built)
        self._functions = _declared(self._model.lib)
        self._traced = trace is not None
        if trace is not None:
            self._model.start_vcd_trace(trace, auto_tracing=False)
        names = ("reset_mask", "actions", "observations", "rewards", "ters", "current_states", "elapsed")
        bounds = np.zeros(2 * len(names), np.uint64)
        if backdoor:
            bounds[:] = [bound for name in names for bound in (layout[name].offset, layout.end(name))]
        # No core needs as many cycles for a slot, so a step that takes longer hangs.
        self._patience = 100_000 + 1000 * layout.n_envs
        self._host = self._functions.pearl_open(
            self._model.model, self._model.vcd_trace, self._patience, bounds.ctypes.data, layout.groups
        )

    @property
    def clock(self) -> int:
        """Clock cycles so far: of steps, and of every transfer over the AXI port."""
        return int(self._functions.pearl_clock(self._host))

    def write(self, offset: int, data: Stream) -> None:
        """See :class:`Transport`."""
        self._check(self._functions.pearl_write(self._host, offset, data.ctypes.data, data.size))

    def read(self, offset: int, data: Stream) -> None:
        """See :class:`Transport`."""
        self._check(self._functions.pearl_read(self._host, offset, data.ctypes.data, data.size))

    def wait(self, step: Exchange) -> None:
        """Clock until the interrupt."""
        self._check(self._functions.pearl_wait(self._host, self._patience))

    def pause(self) -> None:
        """Clock until the interrupt, or for many cycles."""
        answer = self._functions.pearl_wait(self._host, _PAUSE_CYCLES)
        if answer != _NOT_ENDED:
            self._check(answer)

    def exchange(self, step: Exchange) -> None:
        """Do a whole step in one call, unless its stages are timed."""
        if self.timed:
            super().exchange(step)
        else:
            self.step(step.write_at, step.data, step.read_at, step.answer)

    def step(self, offset: int, data: Stream, answer_offset: int, answer: Stream) -> None:
        """Write, clock until the interrupt, and read, in one call."""
        sent, room = (data.ctypes.data, data.size), (answer.ctypes.data, answer.size)
        self._check(self._functions.pearl_step(self._host, offset, *sent, answer_offset, *room))

    def peek(self, signal: str) -> int:
        """Return the present value of a signal, by its name in the hierarchy under ``pearl_top``."""
        found: int | None = self._model.value(signal)
        if found is None:
            how = "" if self._traced else "; open the device with trace= to keep every signal"
            raise DeviceError(f"the simulated device has no signal {signal!r}{how}")
        return found

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
        ("pearl_wait", ctypes.c_int, (pointer, size)),
        ("pearl_step", ctypes.c_int, (pointer, *transfer, *transfer)),
    ):
        function = getattr(lib, name)
        function.restype, function.argtypes = result, arguments
    return lib
