"""What the trainers' settings may be, said beside their defaults, and whether this machine can hold them."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from dataclasses import dataclass, field, fields
from numbers import Integral, Real
from typing import Any

import torch

from pearl_marl.devices import Cuda
from pearl_marl.errors import ArgumentError
from pearl_marl.spec import EnvSpec

MANY = 10**12
"""The most of anything that is counted and has no limit of its own: more would never end."""

SLOTS = 2**32
"""Agents that random draws can tell apart: see :mod:`pearl_marl.rng`."""

SEEDS = 2**63 - 1
"""The largest seed that PyTorch takes."""

WIDEST = 2**14
"""The widest layer of a network: its weights take a gigabyte."""


@dataclass(frozen=True)
class Range:
    """The numbers from ``least`` to ``most``; without ``least`` itself, if only those above it."""

    least: float
    most: float
    above: bool
    whole: bool

    def __contains__(self, value: Any) -> bool:
        kind = Integral if self.whole else Real
        if isinstance(value, bool) or not isinstance(value, kind):
            return False
        figure: Any = value
        within = self.least <= figure <= self.most and figure != math.inf
        return bool(within and not (self.above and figure == self.least))

    def __str__(self) -> str:
        kind = "a whole number" if self.whole else "a number"
        if self.most == math.inf:
            return f"{kind} above {self.least:,}" if self.above else f"{kind} of at least {self.least:,}"
        return (
            f"{kind} {'above' if self.above else 'from'} {self.least:,} {'up ' * self.above}to {self.most:,}"
        )


def count(default: int, least: int = 1, most: int = MANY) -> Any:
    """Return a setting that counts something."""
    return field(default=default, metadata={"range": Range(least, most, above=False, whole=True)})


def number(default: float, least: float = 0, most: float = math.inf, above: bool = False) -> Any:
    """Return a setting that is a finite number; of those above ``least`` only, if ``above``."""
    return field(default=default, metadata={"range": Range(least, most, above, whole=False)})


class Checked:
    """A dataclass of :func:`count` and :func:`number`, each within its range."""

    def __post_init__(self) -> None:
        for setting in fields(self):  # type: ignore[arg-type]
            value = getattr(self, setting.name)
            if value not in setting.metadata["range"]:
                raise ArgumentError(
                    f"setting {setting.name!r} is {value!r}; it must be {setting.metadata['range']}"
                )


def check_memory(spec: EnvSpec, settings: Any, names: Sequence[str], needed: int, device: Any) -> None:
    """Refuse a run that takes more memory than there is, before any is taken.

    Parameters
    ----------
    spec, settings
        The environment, and the run's settings.
    names
        The settings that the memory grows with.
    needed
        Bytes that the run takes at least.
    device
        Where agents are stepped: with ``"cuda"``, what is learned from is on the GPU.

    Raises
    ------
    ArgumentError
        There is less.
    """
    there, where = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE"), "this machine"
    if device == Cuda.name and torch.cuda.is_available():
        there, where = torch.cuda.get_device_properties(0).total_memory, "the GPU"
    if needed > there:
        given = ", ".join(f"{name}={getattr(settings, name)}" for name in names)
        raise ArgumentError(
            f"training on {spec.name} with {given} takes at least {needed / 2**30:,.1f} GiB of memory, and "
            f"{where} has {there / 2**30:,.1f} GiB: make one of these settings smaller"
        )


def observation_bytes(spec: EnvSpec) -> int:
    """Return the bytes of one observation."""
    return math.prod(spec.observation_shape) * spec.observation_dtype.itemsize
