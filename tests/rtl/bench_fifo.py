"""pearl_fifo against a list."""

from __future__ import annotations

import random
from typing import Any

from bench import each_variant, start
from cocotb.triggers import FallingEdge


@each_variant()
async def first_in_first_out(dut: Any, given: Any) -> None:
    await start(dut, push_i=0, data_i=0, pop_i=0)
    source = random.Random(6)
    queue: list[int] = []
    await FallingEdge(dut.clk_i)
    for cycle in range(600):
        # It runs full, then empty, then in between.
        bias = (0.9, 0.1, 0.5)[cycle // 200]
        assert dut.valid_o.value == bool(queue)
        if queue:
            assert int(dut.data_o.value) == queue[0]
        pop = bool(queue) and source.random() > bias
        push = len(queue) < given.depth and source.random() < bias
        data = source.getrandbits(32)
        dut.pop_i.value, dut.push_i.value, dut.data_i.value = int(pop), int(push), data
        await FallingEdge(dut.clk_i)
        if pop:
            queue.pop(0)
        if push:
            queue.append(data)
