"""pearl_input_bank: every row in order, and as many a cycle as the memory's words allow."""

from __future__ import annotations

import random
from typing import Any

from bench import each_variant, start
from cocotb.triggers import FallingEdge


@each_variant(idle=[0.0, 0.4])
async def rows_are_the_stream(dut: Any, given: Any, idle: float) -> None:
    names = ("busy_i", "start_i", "take_i", "host_re_i", "host_we_i", "host_addr_i", "host_wdata_i")
    await start(dut, **dict.fromkeys(names, 0))
    await FallingEdge(dut.clk_i)
    source = random.Random(4)
    for repeat in range(3):
        words = [source.getrandbits(given.word) for _ in range(given.words)]
        stream = sum(word << (given.word * i) for i, word in enumerate(words))
        # A partial last row is padded with whatever stands in the last word, and with zeros.
        expected = [(stream >> (given.row * i)) & ((1 << given.row) - 1) for i in range(given.rows)]
        dut.busy_i.value = 0
        for address, word in enumerate(words):
            dut.host_we_i.value, dut.host_addr_i.value, dut.host_wdata_i.value = 1, address, word
            await FallingEdge(dut.clk_i)
        dut.host_we_i.value, dut.busy_i.value, dut.start_i.value = 0, 1, 1
        # The host is not served during a step, whatever it asks for.
        dut.host_re_i.value = 1
        await FallingEdge(dut.clk_i)
        dut.start_i.value = 0
        # The second time over it is cut short, as nothing but a reset of the host could do.
        wanted = given.rows // 2 if repeat == 1 else given.rows
        taken: list[int] = []
        cycles = 0
        while len(taken) < wanted:
            cycles += 1
            assert cycles < 40 + 8 * (given.rows + given.words), f"stuck after {len(taken)} rows"
            take = dut.valid_o.value == 1 and source.random() >= idle
            dut.take_i.value = int(take)
            if take:
                taken.append(int(dut.row_o.value))
            await FallingEdge(dut.clk_i)
        dut.take_i.value, dut.host_re_i.value = 0, 0
        assert taken == expected[:wanted]
        if not idle and repeat != 1:
            assert cycles <= max(given.rows, given.words) + 7


@each_variant()
async def the_host_reads_what_it_wrote(dut: Any, given: Any) -> None:
    names = ("busy_i", "start_i", "take_i", "host_re_i", "host_we_i", "host_addr_i", "host_wdata_i")
    await start(dut, **dict.fromkeys(names, 0))
    await FallingEdge(dut.clk_i)
    source = random.Random(5)
    words = [source.getrandbits(given.word) for _ in range(given.words)]
    for address, word in enumerate(words):
        dut.host_we_i.value, dut.host_addr_i.value, dut.host_wdata_i.value = 1, address, word
        await FallingEdge(dut.clk_i)
    dut.host_we_i.value, dut.host_re_i.value = 0, 1
    # One after the other; each comes two cycles later.
    for address in range(given.words + 2):
        if address >= 2:
            assert int(dut.host_rdata_o.value) == words[address - 2]
        dut.host_addr_i.value = min(address, given.words - 1)
        await FallingEdge(dut.clk_i)
