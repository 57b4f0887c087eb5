"""Choosing a build: processing elements and word width for an environment behind a link."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import groupby
from typing import Any

from pearl_marl.errors import ArgumentError
from pearl_marl.hardware.build import Build
from pearl_marl.hardware.elaboration import clocked
from pearl_marl.hardware.fitting import Part, modelled_bram36, modelled_dsp
from pearl_marl.hardware.synthesis import Usage, synthesised
from pearl_marl.latency.host import HostTimes, measure_host
from pearl_marl.latency.prediction import Link, Overlap, Prediction, predict
from pearl_marl.memory_map import DATA_WIDTHS, MemoryMap, memory_map
from pearl_marl.spec import EnvSpec, check_spec

MAX_PE_NUM = 256
"""The most processing elements that are considered, in powers of two, which need the fewest shifters."""

NEAR = 1.05
"""A smaller design is chosen over the fastest, if its steps take at most so many times as long."""

DSP_SHARE = 0.25
"""Cores take more of a part's multipliers only where fewer would compute longer than the link moves a step:
the rest is for the policy, or for a second design, which steps the other half of the slots."""


@dataclass(frozen=True, slots=True)
class Candidate:
    """A build, what a step of it is predicted to take, the block RAM of its memories, and its multipliers."""

    layout: MemoryMap
    prediction: Prediction
    bram36: float
    dsp: int

    def as_json(self) -> dict[str, Any]:
        """Return it as JSON has it."""
        return {**self.prediction.as_json(), "bram36": self.bram36, "dsp": self.dsp}


@dataclass(frozen=True, slots=True)
class Plan:
    """The build that was chosen, and what it was chosen from.

    ``candidates`` are a build for each ``pe_num``: the chosen one, and of other numbers the one with the
    narrowest word that is nearly as fast as their fastest. ``larger`` is that of the next ``pe_num``, whether
    it fits the part or not; ``None`` if nothing larger was considered.

    ``host`` and ``half_host`` are what the host takes for all slots and for half of them, measured.
    ``overlap`` is of two devices of half the slots that take turns; ``None`` for a single slot. ``usage`` is
    the result of synthesis, if it is in the cache.
    """

    chosen: Candidate
    candidates: tuple[Candidate, ...]
    larger: Candidate | None
    host: HostTimes
    half_host: HostTimes | None
    overlap: Overlap | None
    usage: Usage | None


def plan(
    spec: EnvSpec,
    n_envs: int,
    link: Link,
    clock: float,
    part: Part | None = None,
    pe_num: int | None = None,
    data_wl: int | None = None,
) -> Plan:
    """Choose a build for a link, and a clock in hertz.

    Of all builds that fit the part (``None`` for anything) by their memories and multipliers, the smallest
    that is nearly as fast as the fastest (:data:`NEAR`): fewest processing elements, then the narrowest word.
    Where it takes many of the part's multipliers (:data:`DSP_SHARE`), the same of those that take fewer and
    outrun the link. ``pe_num`` and ``data_wl`` restrict the choice to one value.

    Raises
    ------
    ArgumentError
        A parameter is not possible, or no build fits the part.
    """
    check_spec(spec)
    if not isinstance(link, Link):
        raise ArgumentError(f"link is {link!r}; it must be a Link, such as one of pearl_marl.latency.LINKS")
    if part is not None and not isinstance(part, Part):
        raise ArgumentError(f"part is {part!r}; it must be one of pearl_marl.hardware.fitting.PARTS, or None")
    memory_map(spec, n_envs, 1, DATA_WIDTHS[0])  # refuses an impossible number of slots
    sizes = [1 << k for k in range(MAX_PE_NUM.bit_length()) if 1 << k <= n_envs]
    if pe_num is not None:
        sizes = [pe_num]
    widths = DATA_WIDTHS if data_wl is None else (data_wl,)
    dsp, host = modelled_dsp(spec, clocked("xc7", clock / 1e6)), measure_host(spec, n_envs)
    every = [
        Candidate(
            layout, predict(spec, layout, link, host, clock), modelled_bram36(layout), dsp(layout.pe_num)
        )
        for layout in (memory_map(spec, n_envs, size, width) for size in sizes for width in widths)
    ]
    fitting = [c for c in every if part is None or (c.bram36 <= part.bram36 and c.dsp <= part.dsp)]
    if part is not None and not fitting:
        least = min(every, key=lambda c: max(c.bram36 / part.bram36, c.dsp / part.dsp))
        raise ArgumentError(
            f"{n_envs:,} slots of {spec.name} need {least.bram36:,.1f} BRAM36 and {least.dsp:,} DSP or more, "
            f"the {part.name} has {part.bram36:,} and {part.dsp:,}: take fewer, or a larger part"
        )
    chosen = _smallest(fitting)
    if part is not None and chosen.dsp > DSP_SHARE * part.dsp:
        moved = min(c.prediction.link for c in fitting)  # narrow words make a link slow
        frugal = [c for c in fitting if c.dsp <= DSP_SHARE * part.dsp and c.prediction.device < moved]
        chosen = _smallest(frugal or fitting)
    larger = [c for c in every if c.layout.pe_num > chosen.layout.pe_num]
    half_host = overlap = None
    if n_envs > 1:
        half = memory_map(spec, n_envs // 2, min(chosen.layout.pe_num, n_envs // 2), chosen.layout.data_wl)
        half_host = measure_host(spec, half.n_envs)
        overlap = Overlap(predict(spec, half, link, half_host, clock))
    return Plan(
        chosen,
        # The chosen one for its own size, whose word may be wider than that near the fastest of this size.
        tuple(chosen if chosen in group else _smallest(group) for group in _by_size(fitting)),
        next(map(_smallest, _by_size(larger)), None),
        host,
        half_host,
        overlap,
        synthesised(Build(spec, chosen.layout)),
    )


def _by_size(candidates: list[Candidate]) -> list[list[Candidate]]:
    """Return the candidates in a list for each ``pe_num``, the least first."""
    return [list(group) for _, group in groupby(candidates, lambda c: c.layout.pe_num)]


def _smallest(candidates: list[Candidate]) -> Candidate:
    """Return the smallest candidate that is nearly as fast as the fastest."""
    enough = NEAR * min(c.prediction.total for c in candidates)
    near = [c for c in candidates if c.prediction.total <= enough]
    return min(near, key=lambda c: (c.layout.pe_num, c.layout.data_wl))
