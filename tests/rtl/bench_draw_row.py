"""pearl_draw_row against rng.draw."""

from __future__ import annotations

import random
from typing import Any

import numpy as np
from bench import each_variant, start
from cocotb.triggers import FallingEdge

from pearl_marl.golden import rng, u32

DRAW_LATENCY = 11


@each_variant()
async def draws_equal_the_hash(dut: Any, given: Any) -> None:
    await start(dut, slot_i=0, key_a_i=0, key_b_i=0)
    source = random.Random(2)
    for _ in range(4):
        keys = [(source.getrandbits(32), source.getrandbits(32)) for _ in range(given.draws)]
        dut.key_a_i.value = sum(a << (32 * i) for i, (a, _) in enumerate(keys))
        dut.key_b_i.value = sum(b << (32 * i) for i, (_, b) in enumerate(keys))
        await FallingEdge(dut.clk_i)
        due: list[int] = []
        for cycle in range(50):
            slot = 0xFFFFFFFF if cycle == 0 else source.getrandbits(32)
            dut.slot_i.value = slot
            # Slot numbers wrap at 32 bits.
            slots = np.arange(slot, slot + given.pe_num, dtype=np.uint64).astype(np.uint32)
            with np.errstate(over="ignore"):
                words = [[int(rng.draw(u32(s), u32(a), u32(b))) for a, b in keys] for s in slots]
            flat = [word for row in words for word in row]
            due.append(sum(word << (32 * i) for i, word in enumerate(flat)))
            await FallingEdge(dut.clk_i)
            if cycle >= DRAW_LATENCY - 1:
                assert int(dut.draws_o.value) == due[cycle - DRAW_LATENCY + 1]
