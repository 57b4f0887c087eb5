"""pearl_group_reader: every group once and in order, as fast as may be, and never more than fits."""

from __future__ import annotations

import random
from typing import Any

from bench import each_variant, start
from cocotb.triggers import FallingEdge, ReadOnly


@each_variant(idle=[0.0, 0.4])
async def groups_come_in_order(dut: Any, given: Any, idle: float) -> None:
    await start(dut, start_i=0, first_slot_i=0, rows_valid_i=0)
    source = random.Random(18)
    rows = [given.pe_num * bits for bits in (given.obs, given.reward, 2)]
    # The last one runs over the end of the slot numbers.
    for first_slot in (0, 1 << 31, (1 << 32) - given.pe_num):
        await FallingEdge(dut.clk_i)
        dut.start_i.value, dut.first_slot_i.value, dut.rows_valid_i.value = 1, first_slot, 0
        await FallingEdge(dut.clk_i)
        dut.start_i.value = 0
        fills, issued, cycle, ready_at = [0, 0, 0], 0, 0, 0
        while issued < given.groups:
            assert cycle < 40 + 8 * given.ii * given.groups * max(1, *(row // given.word for row in rows))
            valid = source.random() >= idle
            dut.rows_valid_i.value = int(valid)
            await ReadOnly()
            # A packer writes a word as soon as it has one, and has room for a row beside a part of one.
            fills = [fill - given.word if fill >= given.word else fill for fill in fills]
            may = valid and cycle >= ready_at and all(fill < given.word for fill in fills)
            assert dut.issue_o.value == int(may), f"cycle {cycle}, fills {fills}"
            if may:
                assert int(dut.group_o.value) == issued
                assert dut.last_o.value == int(issued == given.groups - 1)
                assert int(dut.slot_o.value) == (first_slot + issued * given.pe_num) % (1 << 32)
                fills = [fill + row for fill, row in zip(fills, rows, strict=True)]
                issued, ready_at = issued + 1, cycle + given.ii
            cycle += 1
            await FallingEdge(dut.clk_i)
        dut.rows_valid_i.value = 1
        for _ in range(3 * given.ii):
            await ReadOnly()
            assert dut.issue_o.value == 0
            await FallingEdge(dut.clk_i)
