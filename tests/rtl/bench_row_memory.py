"""pearl_row_memory: the same rows to the pipeline and, word by word, to the host."""

from __future__ import annotations

import random
from typing import Any

from bench import each_variant, start
from cocotb.triggers import FallingEdge


@each_variant()
async def host_and_pipeline_see_the_same(dut: Any, given: Any) -> None:
    names = ("busy_i", "re_i", "raddr_i", "we_i", "waddr_i", "wdata_i")
    host_names = ("host_re_i", "host_we_i", "host_addr_i", "host_wdata_i")
    await start(dut, **dict.fromkeys(names + host_names, 0))
    source = random.Random(5)
    columns = 1 << (-(-given.row // given.word) - 1).bit_length()
    rows = [0] * given.rows
    await FallingEdge(dut.clk_i)
    for row in range(given.rows):
        dut.busy_i.value, dut.we_i.value, dut.waddr_i.value, dut.wdata_i.value = 1, 1, row, 0
        await FallingEdge(dut.clk_i)
    for _ in range(400):
        row, column, busy = source.randrange(given.rows), source.randrange(columns), source.random() < 0.5
        address, data = row * columns + column, source.getrandbits(given.word)
        write = source.random() < 0.5
        fresh = source.getrandbits(given.row)
        # The side that is not served asks for something all the time, too.
        dut.busy_i.value = int(busy)
        dut.we_i.value, dut.re_i.value = int(write), int(not write)
        dut.waddr_i.value = dut.raddr_i.value = row
        dut.wdata_i.value = fresh
        dut.host_we_i.value, dut.host_re_i.value = int(write), int(not write)
        dut.host_addr_i.value, dut.host_wdata_i.value = address, data
        await FallingEdge(dut.clk_i)
        if not write:
            # What was read goes to the output meanwhile.
            dut.re_i.value = dut.host_re_i.value = 0
            await FallingEdge(dut.clk_i)
        if write and busy:
            rows[row] = fresh
        elif write:
            mask = ((1 << given.word) - 1) << (column * given.word)
            rows[row] = (rows[row] & ~mask | data << (column * given.word)) & ((1 << given.row) - 1)
        elif busy:
            assert int(dut.rdata_o.value) == rows[row]
            assert int(dut.host_rdata_o.value) == 0  # as the words of other memories are added to it
        else:
            assert int(dut.host_rdata_o.value) == rows[row] >> (column * given.word) & ((1 << given.word) - 1)
