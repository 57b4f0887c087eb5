"""pearl_port: every request reaches its region or is refused, and its answer comes when it has to."""

from __future__ import annotations

import random
from typing import Any

from bench import each_variant, start
from cocotb.triggers import FallingEdge, ReadOnly

from pearl_marl.memory_map import REGION_NAMES

RESULTS = {"observations", "rewards", "ters"}
READ_ONLY = RESULTS | {"status"}
# What may be read while a step runs.
SHARED = READ_ONLY | {"control", "doorbell"}
OKAY, SLVERR, DECERR = 0, 2, 3


@each_variant()
async def requests_reach_their_regions(dut: Any, given: Any) -> None:
    inputs = ("req_i", "we_i", "addr_i", "wdata_i", "busy_i", "rdata_i")
    await start(dut, **dict.fromkeys(inputs, 0))
    source = random.Random(15)
    asked: tuple[bool, int, int] | None = None
    # (region that is read, its data), and the answers that are due in one cycle and in two.
    read: tuple[int, int] | None = None
    due: list[tuple[int, int | None] | None] = [None, None]
    for cycle in range(3000):
        await FallingEdge(dut.clk_i)
        busy = cycle // 40 % 2
        dut.busy_i.value = busy
        fresh = None
        if source.random() < 0.8:
            address = source.randrange(12 * given.words)
            if source.random() < 0.1:  # far behind the map is a hole, whatever the lower bits are
                address |= 1 << source.randrange((12 * given.words).bit_length(), given.address_bits)
            fresh = source.random() < 0.5, address, source.getrandbits(given.word)
            dut.we_i.value, dut.addr_i.value, dut.wdata_i.value = fresh
        dut.req_i.value = int(fresh is not None)
        # Regions that are not read answer something, too.
        words = [source.getrandbits(given.word) for _ in REGION_NAMES]
        answer = due.pop(0)
        if read is not None:
            words[read[0]] = read[1]
        dut.rdata_i.value = sum(word << (given.word * i) for i, word in enumerate(words))
        await ReadOnly()

        assert dut.rvalid_o.value == int(answer is not None)
        if answer is not None:
            assert int(dut.resp_o.value) == answer[0]
            if answer[1] is not None:
                assert int(dut.rdata_o.value) == answer[1]

        read = None
        strobes = {"re": 0, "we": 0, "busy_write": 0, "busy_doorbell": 0, "torn": 0, "untorn": 0}
        if asked is None:
            due.append(None)
        else:
            write, address, data = asked
            number, index = divmod(address, given.words)
            name = REGION_NAMES[number] if number < len(REGION_NAMES) else None
            allowed = name not in READ_ONLY and not busy if write else name in SHARED or not busy
            if name is None:
                due.append((DECERR, 0))
            elif not allowed:
                due.append((SLVERR, 0))
                strobes["busy_doorbell"] = int(write and busy and name == "doorbell")
                strobes["busy_write"] = int(write and busy and name not in READ_ONLY and name != "doorbell")
            else:
                strobes["we" if write else "re"] = 1 << number
                assert int(dut.index_o.value) == index
                if write:
                    assert int(dut.wdata_o.value) == data
                    due.append((OKAY, None))
                else:
                    read = number, source.getrandbits(given.word)
                    due.append((OKAY, read[1]))
                    strobes["torn"] = int(name in RESULTS and busy)
                    strobes["untorn"] = int(name == "observations" and index == 0 and not busy)
        found = {key: int(getattr(dut, f"{key}_o").value) for key in strobes}
        assert found == strobes, f"cycle {cycle}, request {asked}, busy {busy}"
        asked = fresh
