"""pearl_rng against rng.key."""

from __future__ import annotations

import random
from typing import Any

import numpy as np
from bench import each_variant, start
from cocotb.triggers import ClockCycles, FallingEdge

from pearl_marl.golden import rng, u32, u64

EDGES = (0, 0xFFFFFFFE, 0xFFFFFFFF, 1 << 32, (1 << 64) - 1)
# Cycles of a round.
ROUND = 11


def keys(chain: int, seed: tuple[int, int], tick: int, draws: int) -> list[int]:
    with np.errstate(over="ignore"):
        return [int(rng.key(u32(chain), u32(seed[0]), u32(seed[1]), u64(tick), u32(i))) for i in range(draws)]


@each_variant()
async def keys_equal_the_chain(dut: Any, given: Any) -> None:
    await start(dut, restart_i=0, next_i=0, seed_i=0, tick_i=0)
    source = random.Random(1)
    for case in range(8):
        seed = source.getrandbits(32), source.getrandbits(32)
        tick = EDGES[case] if case < len(EDGES) else source.getrandbits(64)
        await FallingEdge(dut.clk_i)
        dut.seed_i.value = seed[0] | seed[1] << 32
        dut.tick_i.value = tick
        dut.restart_i.value = 1
        await FallingEdge(dut.clk_i)
        dut.restart_i.value = 0
        assert dut.valid_o.value == 0
        # A restart half way must leave no trace.
        if case % 3 == 0:
            await ClockCycles(dut.clk_i, source.randrange(1, 12))
            await FallingEdge(dut.clk_i)
            dut.restart_i.value = 1
            await FallingEdge(dut.clk_i)
            dut.restart_i.value = 0
        await check(dut, given, seed, tick, ROUND * (4 + given.draws))
        # The next ticks, the second one of them of another high word if it is the first case with edges.
        for _ in range(2):
            tick = (tick + 1) & 0xFFFFFFFFFFFFFFFF
            carries = tick & 0xFFFFFFFF == 0
            event = dut.restart_i if carries else dut.next_i
            dut.tick_i.value = tick
            event.value = 1
            await FallingEdge(dut.clk_i)
            event.value = 0
            await check(dut, given, seed, tick, ROUND * ((4 if carries else 1) + given.draws))


async def check(dut: Any, given: Any, seed: tuple[int, int], tick: int, cycles: int) -> None:
    """Wait for the keys, which have to take so many cycles, and the two in which the last of them come."""
    for _ in range(cycles + 2):
        assert dut.valid_o.value == 0
        await FallingEdge(dut.clk_i)
    assert dut.valid_o.value == 1
    for port, chain in ((dut.key_a_o, rng.CHAIN_A), (dut.key_b_o, rng.CHAIN_B)):
        expected = sum(word << (32 * i) for i, word in enumerate(keys(chain, seed, tick, given.draws)))
        assert int(port.value) == expected
