"""How many slots fit an FPGA: the shapes of a build's memories, scaled by what synthesis made of them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any

from pearl_marl.compiler.cores import multipliers
from pearl_marl.compiler.targets import Target
from pearl_marl.errors import ArgumentError, DeviceError
from pearl_marl.hardware.build import Build
from pearl_marl.hardware.synthesis import Usage, synthesise
from pearl_marl.memory_map import MemoryMap, memory_map
from pearl_marl.spec import EnvSpec


@dataclass(frozen=True, slots=True)
class Part:
    """What an FPGA has; the figures are those of its data sheet."""

    name: str
    lut: int
    ff: int
    bram36: int
    dsp: int

    def lacks(self, usage: Usage) -> list[str]:
        """Return what a build needs more of than the part has."""
        return [name for name in ("lut", "ff", "bram36", "dsp") if getattr(usage, name) > getattr(self, name)]


PARTS = {
    "vc707": Part("xc7vx485t", lut=303_600, ff=607_200, bram36=1_030, dsp=2_800),
    "kc705": Part("xc7k325t", lut=203_800, ff=407_600, bram36=445, dsp=840),
    "arty-a7-100t": Part("xc7a100t", lut=63_400, ff=126_800, bram36=135, dsp=240),
}
"""Boards by name, all of the 7 series; the first is the paper's."""

GROUPED_REGIONS = ("initial_states", "current_states", "elapsed")
"""The regions that :mod:`pearl_marl.memory_map` lays out as a stream per group."""

# Depth and width of a BRAM36 in each of its shapes (Xilinx UG473); a BRAM18 is half of one, in depth or,
# in its widest shape, in width.
_SHAPES = ((512, 72), (1024, 36), (2048, 18), (4096, 9), (8192, 4), (16384, 2), (32768, 1))


def modelled_bram36(layout: MemoryMap) -> float:
    """Return how many BRAM36 the memories of a 7-series build need by their shapes alone."""
    total = 0.0
    for region in layout.regions:
        if region.slot_bits == 0:
            continue
        if region.name in GROUPED_REGIONS:  # a memory for each word of a row
            depth, bits = region.rows, region.row_slots * region.slot_bits
        else:
            depth, bits = region.words, layout.data_wl
        widths = [min(layout.data_wl, bits - low) for low in range(0, bits, layout.data_wl)]
        total += sum(_bram36(width, depth) for width in widths)
    return total


def _bram36(width: int, depth: int) -> float:
    def halves(deep: int, wide: int) -> int:
        if deep == 512:  # half of the widest shape is 512 x 36
            return -(-depth // deep) * -(-2 * width // wide)
        return -(-2 * depth // deep) * -(-width // wide)

    return min(halves(deep, wide) for deep, wide in _SHAPES) / 2


DRAW_DSP = 6
"""Multipliers of a random draw: three for each of two products of 32 bits, of which the lower half counts."""


def modelled_dsp(spec: EnvSpec, target: Target) -> Callable[[int], int]:
    """Return what says how many DSPs a 7-series build of so many processing elements needs.

    Those of a core that the spec names are not counted.
    """
    draws = spec.reset_draws + spec.step_draws
    core = multipliers(spec, target) if spec.core is None else 0
    # The keys of a step's draws are made once for all elements.
    return lambda pe_num: DRAW_DSP * (draws > 0) + pe_num * (DRAW_DSP * draws + core)


@dataclass(frozen=True, slots=True)
class Fit:
    """The largest build for a part: predicted, and synthesised if ``usage`` is set."""

    part: Part
    n_envs: int
    bram36: float
    calibration: float
    """What synthesis took of what the model says, at the largest point that both know."""
    usage: Usage | None = field(default=None)

    def as_json(self) -> dict[str, Any]:
        """Return it as JSON has it."""
        return {
            "part": asdict(self.part),
            "n_envs": self.n_envs,
            "bram36": self.bram36,
            "calibration": self.calibration,
            "confirmed": self.usage is not None,
            "usage": None if self.usage is None else self.usage.as_json(),
        }


def largest_fit(spec: EnvSpec, points: Sequence[Usage], part: Part) -> Fit:
    """Predict the largest ``n_envs`` whose memories fit a part.

    ``points`` are synthesised builds of one ``(pe_num, data_wl)``. The model of the memories' shapes is
    scaled by what synthesis made of the largest one; it only holds where memories are block RAM.

    Raises
    ------
    ArgumentError
        No point has its memories in block RAM, or not even the smallest build fits.
    """
    largest = max(points, key=lambda usage: usage.n_envs)
    if all(memory.kind != "block RAM" for memory in largest.memories):
        raise ArgumentError(
            f"at {largest.n_envs:,} slots nothing is block RAM yet: synthesise a larger n_envs"
        )

    known = memory_map(spec, largest.n_envs, largest.pe_num, largest.data_wl)
    calibration = largest.bram36 / modelled_bram36(known)

    def predicted(groups: int) -> float:
        layout = memory_map(spec, groups * largest.pe_num, largest.pe_num, largest.data_wl)
        return modelled_bram36(layout) * calibration

    groups = most(lambda groups: predicted(groups) <= part.bram36)
    if groups == 0:
        raise ArgumentError(f"not even one group of {largest.pe_num} slots fits the {part.name}")
    return Fit(part, groups * largest.pe_num, predicted(groups), calibration)


def most(fits: Callable[[int], bool]) -> int:
    """Return the largest number that fits, or 0; none fits that is larger than one that does not."""
    low, high = 0, 1
    while fits(high):
        low, high = high, high * 2
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (middle, high) if fits(middle) else (low, middle)
    return low


def confirm(spec: EnvSpec, fit: Fit, pe_num: int, data_wl: int) -> Fit:
    """Synthesise a predicted build; if its block RAM does not fit after all, go down until one does.

    Where something else does not fit, it raises a DeviceError.
    """
    while True:
        usage = synthesise(Build.of(spec, fit.n_envs, pe_num, data_wl))
        over = fit.part.lacks(usage)
        if not over:
            return replace(fit, bram36=usage.bram36, usage=usage)
        if over != ["bram36"]:
            raise DeviceError(
                f"{fit.n_envs:,} slots need more {', '.join(over)} than the {fit.part.name} has"
            )
        fit = largest_fit(spec, [usage], fit.part)
