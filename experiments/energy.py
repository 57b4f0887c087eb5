"""Joules that the processor counts (RAPL), where the machine lets them be read."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from time import perf_counter
from typing import Any, NamedTuple

POWERCAP = Path("/sys/class/powercap")
"""Where Linux has the counters; ``intel-rapl:0`` is a processor package, also of AMD's."""


class Energy(NamedTuple):
    """What a while of work took."""

    joules: float
    seconds: float
    steps: int


def unavailable() -> str | None:
    """Return why no energy can be measured here, or ``None`` if it can."""
    packages = _packages()
    if not packages:
        return f"not measured here: the machine has no RAPL counters ({POWERCAP}/intel-rapl:*)"
    for package in packages:
        try:
            _read(package / "energy_uj")
        except OSError as error:
            return f"not measured here: {package}/energy_uj cannot be read: {error.strerror}"
    return None


def spend(step: Callable[[], Any], seconds: float) -> Energy:
    """Step for a while; return what all processor packages took meanwhile.

    That includes idle power, and other programs' work.
    """
    packages = _packages()
    before = [_read(package / "energy_uj") for package in packages]
    began, steps = perf_counter(), 0
    while perf_counter() - began < seconds:
        step()
        steps += 1
    elapsed = perf_counter() - began
    total = 0
    for package, start in zip(packages, before, strict=True):
        spent = _read(package / "energy_uj") - start
        # The counter starts over from zero; within some seconds it does so once at most.
        total += spent if spent >= 0 else spent + _read(package / "max_energy_range_uj")
    return Energy(total * 1e-6, elapsed, steps)


def _packages() -> list[Path]:
    return sorted(POWERCAP.glob("intel-rapl:[0-9]"))


def _read(path: Path) -> int:
    return int(path.read_text())
