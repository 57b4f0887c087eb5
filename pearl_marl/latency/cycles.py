"""T3 to T5: the clock cycles of a step in the hardware, and of what passes its AXI port."""

from __future__ import annotations

from typing import NamedTuple

from pearl_marl.compiler.targets import Target
from pearl_marl.hardware import elaboration
from pearl_marl.memory_map import MemoryMap
from pearl_marl.spec import EnvSpec

_FIRST_ISSUE = 9
"""Cycles of a step in which the sequencer starts and the first row of actions comes out of its memory."""

FETCH = 4
"""Cycles from a group's issue to when cores get its states (``issue_to_core`` of ``rtl/pearl_pkg.sv``)."""

DRAW_LATENCY = 11
"""The same for its random draws (``DRAW_LATENCY``), for which states wait; and of a round of their keys."""

RESULTS = ("observations", "rewards", "ters")
"""The regions that a step's results leave in, each from a memory of its own."""

_INPUTS = ("actions", "reset_mask")


def step_cycles(
    spec: EnvSpec, layout: MemoryMap, pipelined: bool = True, target: Target = elaboration.TARGET
) -> int:
    """Return the clock cycles of a step in the hardware, from doorbell to last result.

    In closed form, from what happens in ``rtl/``: groups are issued one every ``II`` cycles, and not
    before their actions have come, a word a cycle; results leave in three banks, a word a cycle each.
    Not pipelined, a group is issued when the one before has been read, computed and written: with one
    processing element the paper's Eq. 2, ``env_num * (c_r + c_c + c_w)``.
    The random draws are there in time; where a link is as short as a simulated one, see :func:`draws_wait`.

    ``target`` is what the core is generated for; its default is that of the simulated device, and then it is
    what ``Rtl.cycles`` counts. Where words do not divide into rows, nor rows into words, it may be a
    few per cent too low.
    """
    timing = elaboration.core_timing(spec, target)
    groups, word = layout.groups, layout.data_wl
    fetch = DRAW_LATENCY if spec.reset_draws + spec.step_draws else FETCH
    to_words = fetch + timing.latency + 3

    def row(name: str) -> int:
        return layout.pe_num * layout[name].slot_bits

    interval = timing.interval
    if not pipelined:
        written = max(-(-row(name) // word) for name in RESULTS)
        interval = max(interval, fetch + timing.latency + 1 + written)

    def issued(count: int) -> int:
        """Return the cycle in which that many groups have been issued, were there room for results."""
        came = [min(-(-count * row(name) // word), layout[name].words) for name in _INPUTS]
        first = max(min(-(-row(name) // word), layout[name].words) for name in _INPUTS)
        return _FIRST_ISSUE + max(*came, first + (count - 1) * interval)

    ends = []
    for name in RESULTS:
        words = layout[name].words
        for_first_word = min(groups, -(-word // row(name)))
        with_last_group = words - (groups - 1) * row(name) // word
        ends += [issued(for_first_word) + words, issued(groups) + with_last_group]
    return to_words + max(ends)


class LoopCycles(NamedTuple):
    """The paper's loop times, T3 to T5 of all slots together, for one build of ours, in clock cycles.

    ``c_r`` and ``c_w`` are a slot's share of the words in and out, ``c_c`` the core's latency.
    """

    serial: float
    """Eq. 2, one unit that computes slot after slot: ``env_num * (c_r + c_c + c_w)``."""
    parallel: float
    """Eq. 3, a unit for each slot: ``env_num * (c_r + c_w) + c_c``."""
    ours: int
    """:func:`step_cycles`: reading, computing and writing overlap, and so do the three result banks."""


def loop_cycles(spec: EnvSpec, layout: MemoryMap, target: Target = elaboration.TARGET) -> LoopCycles:
    """Return the paper's Eq. 2 and Eq. 3 for a build, beside what this hardware takes."""
    moved = layout["actions"].words + sum(layout[name].words for name in RESULTS)
    compute = elaboration.core_timing(spec, target).latency
    ours = step_cycles(spec, layout, target=target)
    return LoopCycles(moved + layout.n_envs * compute, moved + compute, ours)


_BURST_BYTES, _BURST_BEATS = 4096, 256
"""AXI4: no burst crosses a multiple of the one, or has more beats than the other."""

_PORT_LATENCY = 7
"""Cycles from a request behind the AXI slave to its answer (``PORT_LATENCY`` of ``rtl/pearl_pkg.sv``)."""

TRANSFER_WAIT = _PORT_LATENCY + 4
"""Cycles from the first address of a transfer to its last answer, both included, besides one a beat."""

_UNTIL_RUNNING = 5
"""Cycles of a step that pass while its write is still being answered."""


def transfer_cycles(start: int, length: int, beat: int, burst: int | None = None) -> int:
    """Return the clock cycles of a transfer over the AXI port, ``beat`` bytes each.

    The port takes queued bursts without a gap, so those of any length take as long. ``burst`` is for a
    master that asks for the next burst only after the last one's answer: the most bytes that it takes in one.
    """
    if burst is None:
        return -(-length // beat) + (TRANSFER_WAIT if length else 0)
    end, cycles = start + length, 0
    while start < end:
        stop = min(end, start + _BURST_BEATS * beat, (start // _BURST_BYTES + 1) * _BURST_BYTES)
        stop = min(stop, (start // burst + 1) * burst)
        cycles += TRANSFER_WAIT + -(-(stop - start) // beat)
        start = stop
    return cycles


def write_cycles(layout: MemoryMap, burst: int | None = None) -> int:
    """Return the clock cycles in which what a step writes passes the AXI port: :func:`transfer_cycles`."""
    return transfer_cycles(*layout.step_write, layout.data_wl // 8, burst)


def read_cycles(layout: MemoryMap, burst: int | None = None) -> int:
    """Return the same of what a step reads."""
    return transfer_cycles(*layout.step_read, layout.data_wl // 8, burst)


def draws_wait(spec: EnvSpec, layout: MemoryMap) -> int:
    """Return the cycles that a step waits for its random draws, if it follows the last one at once.

    Their keys are made as soon as a step is done (``rtl/pearl_rng.sv``), while results are read and actions
    written. A link takes longer than they do; the simulated port may not.
    """
    draws = spec.reset_draws + spec.step_draws
    keys = DRAW_LATENCY * (1 + draws) + 2 if draws else 0
    return max(0, keys - read_cycles(layout) - (write_cycles(layout) - _UNTIL_RUNNING))


def axi_cycles(spec: EnvSpec, layout: MemoryMap, pipelined: bool = True) -> int:
    """Return the clock cycles of a whole step of ``Rtl(path="axi")``: write, step, read."""
    step = max(1, draws_wait(spec, layout) + step_cycles(spec, layout, pipelined) - _UNTIL_RUNNING)
    return write_cycles(layout) + step + read_cycles(layout)
