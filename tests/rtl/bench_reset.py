"""pearl_reset, with a clock that stops and a ready that comes and goes at any time."""

from __future__ import annotations

import random
from typing import Any

import cocotb
from cocotb.simtime import get_sim_time
from cocotb.triggers import RisingEdge, Timer, ValueChange

PERIOD = 10_000  # ps
TO_RISE = 5
"""Edges of the clock from a ready that stays to the end of reset."""


class Bench:
    """A clock by hand, and whatever rst_no does that it must not."""

    def __init__(self, dut: Any) -> None:
        self.dut = dut
        self.edge = -1
        self.seen = 0
        """Edges at which the design saw the reset."""
        self.broken: list[str] = []
        dut.clk_i.value, dut.ready_i.value = 0, 0
        cocotb.start_soon(self._watch_edges())
        cocotb.start_soon(self._watch_reset())

    async def _watch_edges(self) -> None:
        while True:
            await RisingEdge(self.dut.clk_i)
            self.edge = get_sim_time("ps")
            self.seen += self.dut.rst_no.value == 0

    async def _watch_reset(self) -> None:
        while True:
            await ValueChange(self.dut.rst_no)
            # Before the first edge it is what the registers begin with, which is random.
            if self.edge >= 0 and get_sim_time("ps") != self.edge:
                self.broken.append(f"rst_no became {self.dut.rst_no.value} beside the clock")

    async def cycles(self, count: int) -> None:
        for _ in range(count):
            for level in (1, 0):
                self.dut.clk_i.value = level
                await Timer(PERIOD // 2, "ps")


@cocotb.test
async def it_lasts_until_the_clock_is_ready(dut: Any) -> None:
    bench = Bench(dut)
    await bench.cycles(8)
    assert dut.rst_no.value == 0
    dut.ready_i.value = 1
    await bench.cycles(TO_RISE - 1)
    assert dut.rst_no.value == 0
    await bench.cycles(1)
    assert dut.rst_no.value == 1
    assert not bench.broken


@cocotb.test
@cocotb.parametrize(stopped=(False, True))
async def nothing_is_missed(dut: Any, stopped: bool) -> None:
    """However short ready was gone, and whether or not there was an edge meanwhile."""
    bench = Bench(dut)
    source = random.Random(7)
    for _ in range(200):
        dut.ready_i.value = 1
        await bench.cycles(TO_RISE + source.randrange(3))
        assert dut.rst_no.value == 1
        before = bench.seen
        # From just behind one edge to just before the next.
        running = cocotb.start_soon(bench.cycles(0 if stopped else 12))
        await Timer(source.randrange(1, PERIOD) + PERIOD // 2 * stopped, "ps")
        dut.ready_i.value = 0
        await Timer(source.choice((1, PERIOD // 3, 2 * PERIOD)), "ps")
        dut.ready_i.value = 1
        await running
        if stopped:
            assert dut.rst_no.value == 1, "it has no clock to fall with"
            await bench.cycles(12)
        assert bench.seen > before
        assert dut.rst_no.value == 1
    assert not bench.broken
