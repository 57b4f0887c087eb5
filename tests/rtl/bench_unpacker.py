"""pearl_unpacker: every row in order, and as many a cycle as the memory's words allow."""

from __future__ import annotations

import random
from typing import Any

import cocotb
from bench import each_variant, start
from cocotb.triggers import FallingEdge


@each_variant(idle=[0.0, 0.4])
async def rows_are_the_stream(dut: Any, given: Any, idle: float) -> None:
    await start(dut, start_i=0, take_i=0, rdata_i=0)
    source = random.Random(4)
    for repeat in range(3):
        words = [source.getrandbits(given.word) for _ in range(given.words)]
        stream = sum(word << (given.word * i) for i, word in enumerate(words))
        # A partial last row is padded with whatever stands in the last word, and with zeros.
        expected = [(stream >> (given.row * i)) & ((1 << given.row) - 1) for i in range(given.rows)]
        await FallingEdge(dut.clk_i)
        dut.start_i.value = 1
        await FallingEdge(dut.clk_i)
        dut.start_i.value = 0
        # The second time over it is cut short, as nothing but a reset of the host could do.
        wanted = given.rows // 2 if repeat == 1 else given.rows
        taken: list[int] = []
        cycles, arriving = 0, None
        while len(taken) < wanted:
            cycles += 1
            assert cycles < 40 + 8 * (given.rows + given.words), f"stuck after {len(taken)} rows"
            dut.rdata_i.value = source.getrandbits(given.word) if arriving is None else words[arriving]
            take = dut.valid_o.value == 1 and source.random() >= idle
            dut.take_i.value = int(take)
            if take:
                taken.append(int(dut.row_o.value))
            await cocotb.triggers.ReadOnly()
            arriving = int(dut.raddr_o.value) if dut.re_o.value == 1 else None
            await FallingEdge(dut.clk_i)
        dut.take_i.value = 0
        assert taken == expected[:wanted]
        if not idle and repeat != 1:
            assert cycles <= max(given.rows, given.words) + 4
