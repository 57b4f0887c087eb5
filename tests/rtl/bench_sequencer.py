"""pearl_sequencer: one start and one end to each ring, and a true count of the cycles between."""

from __future__ import annotations

import random
from typing import Any

from bench import each_variant, start
from cocotb.triggers import FallingEdge, ReadOnly


@each_variant()
async def a_step_takes_its_course(dut: Any, given: Any) -> None:
    await start(dut, ring_i=0, keys_valid_i=0, results_done_i=0)
    source = random.Random(17)
    for _ in range(200):
        keys_after, done_after = source.randrange(5), source.randrange(1, 20)
        await FallingEdge(dut.clk_i)
        # Between steps, what the results say means nothing.
        dut.ring_i.value, dut.keys_valid_i.value, dut.results_done_i.value = 1, source.randrange(2), 1
        await ReadOnly()
        assert (dut.busy_o.value, dut.start_o.value, dut.done_o.value) == (0, 0, 0)
        # The ring's own cycle, those without keys and one with them, the start, the pipeline's, and one more.
        started, ended = 2 + keys_after, 2 + keys_after + done_after
        for cycle in range(1, ended + 2):
            await FallingEdge(dut.clk_i)
            dut.ring_i.value = 0
            dut.keys_valid_i.value = int(cycle > keys_after)
            # Nor do they before the pipeline has started, when they are of the step before.
            dut.results_done_i.value = int(cycle >= ended or cycle <= started)
            await ReadOnly()
            assert dut.busy_o.value == 1
            assert dut.start_o.value == int(cycle == started)
            assert dut.done_o.value == int(cycle == ended + 1)
        assert int(dut.cycles_o.value) == ended + 2
        for _ in range(source.randrange(3)):
            await FallingEdge(dut.clk_i)
            await ReadOnly()
            assert (dut.busy_o.value, dut.start_o.value, dut.done_o.value) == (0, 0, 0)
