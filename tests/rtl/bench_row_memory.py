"""pearl_row_memory: the same rows to the pipeline and, word by word, to the host."""

from __future__ import annotations

import random
from typing import Any

import cocotb
import harness
from bench import start
from cocotb.triggers import FallingEdge

ROWS, ROW, WORD = (harness.arguments()[k] for k in ("rows", "row", "word"))
COLUMNS = 1 << (-(-ROW // WORD) - 1).bit_length()


@cocotb.test
async def host_and_pipeline_see_the_same(dut: Any) -> None:
    names = ("busy_i", "re_i", "raddr_i", "we_i", "waddr_i", "wdata_i")
    host_names = ("host_re_i", "host_we_i", "host_addr_i", "host_wdata_i")
    await start(dut, **dict.fromkeys(names + host_names, 0))
    source = random.Random(5)
    rows = [0] * ROWS
    await FallingEdge(dut.clk_i)
    for row in range(ROWS):
        dut.busy_i.value, dut.we_i.value, dut.waddr_i.value, dut.wdata_i.value = 1, 1, row, 0
        await FallingEdge(dut.clk_i)
    for _ in range(400):
        row, column, busy = source.randrange(ROWS), source.randrange(COLUMNS), source.random() < 0.5
        address, data = row * COLUMNS + column, source.getrandbits(WORD)
        write = source.random() < 0.5
        fresh = source.getrandbits(ROW)
        # The side that is not served asks for something all the time, too.
        dut.busy_i.value = int(busy)
        dut.we_i.value, dut.re_i.value = int(write), int(not write)
        dut.waddr_i.value = dut.raddr_i.value = row
        dut.wdata_i.value = fresh
        dut.host_we_i.value, dut.host_re_i.value = int(write), int(not write)
        dut.host_addr_i.value, dut.host_wdata_i.value = address, data
        await FallingEdge(dut.clk_i)
        if write and busy:
            rows[row] = fresh
        elif write:
            mask = ((1 << WORD) - 1) << (column * WORD)
            rows[row] = (rows[row] & ~mask | data << (column * WORD)) & ((1 << ROW) - 1)
        elif busy:
            assert int(dut.rdata_o.value) == rows[row]
        else:
            assert int(dut.host_rdata_o.value) == rows[row] >> (column * WORD) & ((1 << WORD) - 1)
