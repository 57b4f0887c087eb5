"""pearl_xdma_irq between a design that steps and a core that sends late, or not at all."""

from __future__ import annotations

import random
from typing import Any

import cocotb
from bench import reset, start
from cocotb.triggers import ClockCycles, FallingEdge


class Core:
    """What the XDMA core sees: requests, each sent ``delay`` cycles after it rose."""

    def __init__(self, dut: Any, delay: Any) -> None:
        self.dut, self.delay = dut, delay
        self.raised = self.sent = 0
        self.broken: list[str] = []
        cocotb.start_soon(self._watch())

    async def _watch(self) -> None:
        before, waiting = 0, None
        while True:
            await FallingEdge(self.dut.clk_i)
            request = int(self.dut.usr_irq_req_o.value)
            self.dut.usr_irq_ack_i.value = 0
            if request and not before:
                self.raised += 1
                waiting = self.delay()
            if not request and before and waiting is not None:
                self.broken.append("a request fell before it was sent")
            before = request
            if waiting is not None:
                waiting -= 1
                if waiting <= 0:
                    self.dut.usr_irq_ack_i.value = 1
                    self.sent += 1
                    waiting = None


async def begin(dut: Any) -> None:
    """Start with a reset that is as long as it takes to come across from the other clock, as a link's is."""
    await start(dut, irq_i=0, usr_irq_ack_i=0)
    await reset(dut, 4)


async def step(dut: Any, cycles: int) -> None:
    """From the doorbell to the step's end."""
    dut.irq_i.value = 0
    await ClockCycles(dut.clk_i, cycles)
    dut.irq_i.value = 1


@cocotb.test
async def a_host_that_waits_gets_one_for_each_step(dut: Any) -> None:
    await begin(dut)
    source = random.Random(1)
    core = Core(dut, lambda: source.randint(1, 30))
    assert dut.usr_irq_req_o.value == 0
    for steps in range(1, 50):
        await step(dut, source.randint(20, 40))
        while core.sent < steps:
            await ClockCycles(dut.clk_i, 1)
        await ClockCycles(dut.clk_i, source.randint(1, 30))
        assert (core.raised, core.sent) == (steps, steps)
        assert dut.usr_irq_req_o.value == 1, "held until the host has rung again"
    assert not core.broken


@cocotb.test
async def a_host_that_polls_breaks_no_rule(dut: Any) -> None:
    await begin(dut)
    source = random.Random(2)
    core = Core(dut, lambda: source.randint(1, 200))
    for _ in range(200):
        await step(dut, source.randint(20, 40))
        await ClockCycles(dut.clk_i, source.randint(1, 40))
    assert not core.broken
    # The last step is told of, however late.
    await ClockCycles(dut.clk_i, 500)
    assert core.raised == core.sent
    last = core.sent
    await step(dut, 20)
    await ClockCycles(dut.clk_i, 500)
    assert core.sent == last + 1


@cocotb.test
async def what_is_never_sent_is_held(dut: Any) -> None:
    await begin(dut)
    for _ in range(5):
        await step(dut, 20)
        await ClockCycles(dut.clk_i, 20)
        assert dut.usr_irq_req_o.value == 1


@cocotb.test
async def an_acknowledgement_of_nothing_does_nothing(dut: Any) -> None:
    """Legacy interrupts are acknowledged a second time, when they have fallen."""
    await start(dut, irq_i=0, usr_irq_ack_i=1)
    await ClockCycles(dut.clk_i, 5)
    dut.usr_irq_ack_i.value = 0
    await step(dut, 20)
    await ClockCycles(dut.clk_i, 5)
    assert dut.usr_irq_req_o.value == 1
