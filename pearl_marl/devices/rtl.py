"""The hardware, simulated: the same SystemVerilog as on a board, under Verilator."""

from __future__ import annotations

import os
from pathlib import Path

from pearl_marl.batch.config import BatchConfig
from pearl_marl.checks import checked_choice, checked_count_or_none, checked_flag
from pearl_marl.devices.comm_bram import CommBram
from pearl_marl.devices.simulator.model_build import library
from pearl_marl.devices.simulator.simulation import Simulation
from pearl_marl.devices.transport import Transport
from pearl_marl.errors import ArgumentError, DeviceError
from pearl_marl.hardware.build import Build
from pearl_marl.memory_map import Engine, MemoryMap

PATHS = ("backdoor", "axi")


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
    engine
        What policy engine the hardware has, for rollouts (:mod:`pearl_marl.devices.link_rollout`).
    """

    name = "rtl"
    patience = 600.0
    """A simulated step of a large network on planes may take longer than a board's ten seconds."""

    def __init__(
        self,
        pe_num: int | None = None,
        data_wl: int | None = None,
        path: str = "backdoor",
        trace: str | os.PathLike[str] | None = None,
        *,
        pipelined: bool = True,
        engine: Engine | None = None,
    ) -> None:
        checked_choice("path", path, PATHS)
        self._trace = os.fspath(trace) if isinstance(trace, os.PathLike) else trace
        if self._trace is not None and not (isinstance(self._trace, str) and self._trace.isascii()):
            raise ArgumentError(f"trace is {trace!r}; it must be a file name in ASCII")
        self._pe_num = checked_count_or_none("pe_num", pe_num)
        self._data_wl = checked_count_or_none("data_wl", data_wl)
        self._path, self._pipelined, self._engine = path, checked_flag("pipelined", pipelined), engine

    @property
    def clock(self) -> int:
        """Clock cycles since the device was opened: of steps, and of every transfer over the AXI port."""
        self.check_idle("clock")
        return self._simulation.clock

    def peek(self, signal: str) -> int:
        """Return the present value of a signal, by its name in the hierarchy under ``pearl_top``.

        For example ``"irq_o"`` or ``"u_backbone.u_sequencer.busy_o"``. Verilator optimises signals away, and
        those of an environment's core are left out, which raises DeviceError; with ``trace`` all are kept.
        """
        self.check_idle("peek")
        return self._simulation.peek(signal)

    def _connect(self, config: BatchConfig) -> tuple[Transport, MemoryMap]:
        build = Build.of(config.spec, config.n_envs, self._pe_num, self._data_wl, self._engine)
        if self._trace is not None:  # before a model is compiled, which takes a minute
            try:
                Path(self._trace).touch()
            except OSError as error:
                raise DeviceError(f"the waveform file {self._trace} cannot be written: {error}") from error
        built = library(build, traced=self._trace is not None, pipelined=self._pipelined)
        self._simulation = Simulation(built, build.layout, self._path == "backdoor", self._trace)
        return self._simulation, build.layout
