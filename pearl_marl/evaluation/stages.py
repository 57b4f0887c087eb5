"""How long each stage of a device's step takes, at no cost to a device that nobody times."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from typing import Any

from pearl_marl.batch.step import Array, BatchStep
from pearl_marl.devices.base import Device
from pearl_marl.devices.comm_bram import CommBram, Transport
from pearl_marl.devices.lockstep import Lockstep
from pearl_marl.devices.rtl import Simulation

STAGES = {"pack": "T1", "write": "T2", "compute": "T3-T5", "read": "T6", "unpack": "T7"}
"""The stages of a step, in their order, with the paper's names for their times."""


class Stopwatch:
    """Times every step of one open device from now on.

    Of hardware behind a link it times every stage: ``"compute"`` is what lies between the end of the write
    and the beginning of the read that brought the results. Of any other device it times the whole
    step, as ``"compute"``. Of a lockstep it times the device that is checked.

    Parameters
    ----------
    device
        Open. Some of its methods are replaced by timed ones, on this one object.

    Attributes
    ----------
    device
        The one that is timed.
    seconds
        The last step's stages by name, of :data:`STAGES`.
    """

    def __init__(self, device: Device) -> None:
        self.device = device.device if isinstance(device, Lockstep) else device
        self.seconds: dict[str, float] = {}
        self._step_words = self.device.step_words
        self.device.step_words = self._timed_step  # type: ignore[method-assign]
        self._times: dict[str, tuple[float, float]] = {}
        if isinstance(self.device, CommBram):
            transport = self.device._transport
            if isinstance(transport, Simulation):  # which does the whole exchange in one call
                transport.exchange = partial(Transport.exchange, transport)  # type: ignore[method-assign]
            transport.write = self._timed("write", transport.write)  # type: ignore[method-assign]
            transport.read = self._timed("read", transport.read)  # type: ignore[method-assign]

    def _timed(self, name: str, call: Callable[..., Any]) -> Callable[..., None]:
        def timed(*arguments: Any) -> None:
            began = time.perf_counter()
            call(*arguments)
            self._times[name] = (began, time.perf_counter())

        return timed

    def _timed_step(self, words: Array) -> BatchStep:
        began = time.perf_counter()
        result = self._step_words(words)
        ended = time.perf_counter()
        if isinstance(self.device, CommBram):
            writing, written = self._times["write"]
            reading, read = self._times["read"]
            lasted = (writing - began, written - writing, reading - written, read - reading, ended - read)
            self.seconds = dict(zip(STAGES, lasted, strict=True))
        else:
            self.seconds = {"compute": ended - began}
        return result
