"""Joules that the machine itself counts: of the processor (RAPL), of a GPU (NVML)."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from pathlib import Path
from time import perf_counter
from typing import Any, NamedTuple

POWERCAP = Path("/sys/class/powercap")
"""Where Linux has the processor's counters; ``intel-rapl:0`` is a package, also of AMD's."""


class UnmeasuredError(Exception):
    """No energy can be measured here; the message says why."""


class Rapl:
    """All processor packages, idle power and other programs' work included."""

    counts, platform = "RAPL of the whole processor", "CPU"

    def __init__(self) -> None:
        self._packages = sorted(POWERCAP.glob("intel-rapl:[0-9]"))
        if not self._packages:
            raise UnmeasuredError(f"the machine has no RAPL counters ({POWERCAP}/intel-rapl:*)")
        for package in self._packages:
            try:
                _read(package / "energy_uj")
            except OSError as error:
                raise UnmeasuredError(f"{package}/energy_uj cannot be read: {error.strerror}") from None

    def start(self) -> None:
        """Count from now."""
        self._before = [_read(package / "energy_uj") for package in self._packages]

    def joules(self) -> float:
        """Return what was spent since: some seconds at most, in which a counter starts over at most once."""
        total = 0
        for package, before in zip(self._packages, self._before, strict=True):
            spent = _read(package / "energy_uj") - before
            total += spent if spent >= 0 else spent + _read(package / "max_energy_range_uj")
        return total * 1e-6


class Nvml:
    """The whole board of the GPU in use, idle power included."""

    counts, platform = "NVML of the GPU's whole board, without the processor", "GPU"

    def __init__(self) -> None:
        try:
            from cuda.bindings import nvml

            nvml.init_v2()
            # Not by its number: CUDA and NVML count in different orders.
            gpu = importlib.import_module("numba.cuda").get_current_device()
            self._board = nvml.device_get_handle_by_uuid(gpu.uuid)
            self._read = nvml.device_get_total_energy_consumption
            self.start()
        except ImportError as error:
            raise UnmeasuredError(f"NVML is not installed ({error}): pip install '.[cuda]'") from None
        except Exception as error:  # NVML has a class for each of its errors, and others find its library
            raise UnmeasuredError(f"the machine has no GPU that NVML can read: {error}") from None

    def start(self) -> None:
        """Count from now."""
        self._before = self._read(self._board)

    def joules(self) -> float:
        """Return what was spent since."""
        return float(self._read(self._board) - self._before) * 1e-3


Meter = Rapl | Nvml


class Energy(NamedTuple):
    """What a while of work took."""

    joules: float
    seconds: float
    steps: int


def spend(meter: Meter, step: Callable[[], Any], wait: Callable[[], Any], seconds: float) -> Energy:
    """Step for a while, and wait for what steps have only started; return what was spent meanwhile."""
    meter.start()
    began, steps = perf_counter(), 0
    while perf_counter() - began < seconds:
        step()
        steps += 1
    wait()
    return Energy(meter.joules(), perf_counter() - began, steps)


def _read(path: Path) -> int:
    return int(path.read_text())
