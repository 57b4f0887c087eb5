"""pearl_unpacker: every row in order, and as many a cycle as the memory's words allow."""

from __future__ import annotations

import random
from typing import Any

import cocotb
import harness
from bench import start
from cocotb.triggers import FallingEdge

ROW, WORD, ROWS, WORDS = (harness.arguments()[k] for k in ("row", "word", "rows", "words"))


@cocotb.test
@cocotb.parametrize(idle=[0.0, 0.4])
async def rows_are_the_stream(dut: Any, idle: float) -> None:
    await start(dut, start_i=0, take_i=0, rdata_i=0)
    source = random.Random(4)
    for repeat in range(3):
        words = [source.getrandbits(WORD) for _ in range(WORDS)]
        stream = sum(word << (WORD * i) for i, word in enumerate(words))
        # A partial last row is padded with whatever stands in the last word, and with zeros.
        expected = [(stream >> (ROW * i)) & ((1 << ROW) - 1) for i in range(ROWS)]
        await FallingEdge(dut.clk_i)
        dut.start_i.value = 1
        await FallingEdge(dut.clk_i)
        dut.start_i.value = 0
        # The second time over it is cut short, as nothing but a reset of the host could do.
        wanted = ROWS // 2 if repeat == 1 else ROWS
        taken: list[int] = []
        cycles, arriving = 0, None
        while len(taken) < wanted:
            cycles += 1
            assert cycles < 40 + 8 * (ROWS + WORDS), f"stuck after {len(taken)} rows"
            dut.rdata_i.value = source.getrandbits(WORD) if arriving is None else words[arriving]
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
            assert cycles <= max(ROWS, WORDS) + 4
