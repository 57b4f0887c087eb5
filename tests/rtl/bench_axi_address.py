"""pearl_axi_address against the formulas of AXI4 (IHI 0022, section A3.4.1)."""

from __future__ import annotations

import random
from typing import Any

from bench import each_variant
from cocotb.triggers import Timer

FIXED, INCR, WRAP = range(3)
BITS = 16


@each_variant()
async def addresses_follow_the_standard(dut: Any, given: Any) -> None:
    source = random.Random(7)
    for _ in range(300):
        burst, size = source.choice((FIXED, INCR, WRAP)), source.randrange(8)
        length = source.choice((2, 4, 8, 16)) if burst == WRAP else source.randint(1, 256)
        bytes_ = 1 << size
        begin = source.randrange(1 << BITS)
        if burst == WRAP:
            begin -= begin % bytes_
        aligned = begin // bytes_ * bytes_
        wrap = begin // (bytes_ * length) * (bytes_ * length)
        dut.len_i.value, dut.size_i.value, dut.burst_i.value = length - 1, size, burst
        address = begin
        for beat in range(1, length):
            dut.addr_i.value = address
            await Timer(1, "ns")
            expected = aligned + beat * bytes_
            if burst == FIXED:
                expected = begin
            elif burst == WRAP and expected >= wrap + bytes_ * length:
                expected -= bytes_ * length
            address = expected % (1 << BITS)
            assert int(dut.next_o.value) == address
