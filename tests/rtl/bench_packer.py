"""pearl_packer: no bit lost, doubled or moved, and a word a cycle when there is one."""

from __future__ import annotations

import random
from typing import Any

from bench import each_variant, start
from cocotb.triggers import FallingEdge


@each_variant(idle=[0.0, 0.4])
async def words_are_the_stream(dut: Any, given: Any, idle: float) -> None:
    await start(dut, start_i=0, valid_i=0, last_i=0, row_i=0)
    source = random.Random(3)
    for _ in range(3):
        rows = [source.getrandbits(given.row) for _ in range(given.rows)]
        stream = sum(row << (given.row * i) for i, row in enumerate(rows))
        expected = [(stream >> (given.word * i)) & ((1 << given.word) - 1) for i in range(given.words)]
        await FallingEdge(dut.clk_i)
        dut.start_i.value = 1
        await FallingEdge(dut.clk_i)
        dut.start_i.value = 0
        written, sent, cycles = [], 0, 0
        while dut.done_o.value == 0:
            cycles += 1
            assert cycles < 40 + 8 * (given.rows + given.words), (
                f"stuck after {sent} rows and {len(written)} words"
            )
            send = sent < given.rows and dut.room.value == 1 and source.random() >= idle
            dut.valid_i.value = int(send)
            dut.last_i.value = int(send and sent == given.rows - 1)
            dut.row_i.value = rows[sent] if send else source.getrandbits(given.row)
            sent += send
            if dut.we_o.value == 1:
                assert int(dut.waddr_o.value) == len(written)
                written.append(int(dut.wdata_o.value))
            await FallingEdge(dut.clk_i)
        dut.valid_i.value = 0
        assert sent == given.rows
        assert written == expected
        if not idle:
            assert cycles <= max(given.rows, given.words) + 3
