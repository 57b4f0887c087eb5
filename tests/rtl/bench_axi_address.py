"""pearl_axi_address against the formulas of AXI4 (IHI 0022, section A3.4.1)."""

from __future__ import annotations

import random
from typing import Any

from bench import each_variant, start
from cocotb.triggers import FallingEdge

FIXED, INCR, WRAP = range(3)
BITS = 16


@each_variant()
async def addresses_follow_the_standard(dut: Any, given: Any) -> None:
    await start(dut, start_i=0, next_i=0)
    source = random.Random(7)
    await FallingEdge(dut.clk_i)
    for _ in range(100):
        burst, size = source.choice((FIXED, INCR, WRAP)), source.randrange(8)
        length = source.choice((2, 4, 8, 16)) if burst == WRAP else source.randint(1, 256)
        bytes_ = 1 << size
        begin = source.randrange(1 << BITS)
        if burst == WRAP:
            begin -= begin % bytes_
        aligned = begin // bytes_ * bytes_
        wrap = begin // (bytes_ * length) * (bytes_ * length)
        dut.len_i.value, dut.size_i.value, dut.burst_i.value = length - 1, size, burst
        dut.addr_i.value, dut.start_i.value = begin, 1
        await FallingEdge(dut.clk_i)
        # A burst is looked at when it starts, and no longer.
        dut.start_i.value = 0
        for name, bits in (("addr", BITS), ("len", 8), ("size", 3), ("burst", 2)):
            getattr(dut, f"{name}_i").value = source.getrandbits(bits)
        assert int(dut.addr_o.value) == begin
        await FallingEdge(dut.clk_i)
        for beat in range(1, length):
            if source.random() < 0.1:
                held = int(dut.addr_o.value)
                dut.next_i.value = 0
                await FallingEdge(dut.clk_i)
                assert int(dut.addr_o.value) == held
            dut.next_i.value = 1
            await FallingEdge(dut.clk_i)
            expected = aligned + beat * bytes_
            if burst == FIXED:
                expected = begin
            elif burst == WRAP and expected >= wrap + bytes_ * length:
                expected -= bytes_ * length
            assert int(dut.addr_o.value) == expected % (1 << BITS)
        dut.next_i.value = 0
