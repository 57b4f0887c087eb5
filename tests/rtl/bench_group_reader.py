"""pearl_group_reader: every group once and in order, as fast as may be, and never more than fits."""

from __future__ import annotations

import random
from typing import Any

import cocotb
import harness
from bench import start
from cocotb.triggers import FallingEdge, ReadOnly

GROUPS, PE_NUM, WORD, II, OBS, REWARD = (
    harness.arguments()[k] for k in ("groups", "pe_num", "word", "ii", "obs", "reward")
)
ROWS = [PE_NUM * bits for bits in (OBS, REWARD, 2)]


@cocotb.test
@cocotb.parametrize(idle=[0.0, 0.4])
async def groups_come_in_order(dut: Any, idle: float) -> None:
    await start(dut, start_i=0, first_slot_i=0, rows_valid_i=0)
    source = random.Random(18)
    # The last one runs over the end of the slot numbers.
    for first_slot in (0, 1 << 31, (1 << 32) - PE_NUM):
        await FallingEdge(dut.clk_i)
        dut.start_i.value, dut.first_slot_i.value, dut.rows_valid_i.value = 1, first_slot, 0
        await FallingEdge(dut.clk_i)
        dut.start_i.value = 0
        fills, issued, cycle, ready_at = [0, 0, 0], 0, 0, 0
        while issued < GROUPS:
            assert cycle < 40 + 8 * II * GROUPS * max(1, *(row // WORD for row in ROWS))
            valid = source.random() >= idle
            dut.rows_valid_i.value = int(valid)
            await ReadOnly()
            # A packer writes a word as soon as it has one, and has room for a row beside a part of one.
            fills = [fill - WORD if fill >= WORD else fill for fill in fills]
            may = valid and cycle >= ready_at and all(fill < WORD for fill in fills)
            assert dut.issue_o.value == int(may), f"cycle {cycle}, fills {fills}"
            if may:
                assert int(dut.group_o.value) == issued
                assert dut.last_o.value == int(issued == GROUPS - 1)
                assert int(dut.slot_o.value) == (first_slot + issued * PE_NUM) % (1 << 32)
                fills = [fill + row for fill, row in zip(fills, ROWS, strict=True)]
                issued, ready_at = issued + 1, cycle + II
            cycle += 1
            await FallingEdge(dut.clk_i)
        dut.rows_valid_i.value = 1
        for _ in range(3 * II):
            await ReadOnly()
            assert dut.issue_o.value == 0
            await FallingEdge(dut.clk_i)
