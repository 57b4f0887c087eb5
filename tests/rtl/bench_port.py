"""pearl_port: every request reaches its region or is refused, and its answer comes when it has to."""

from __future__ import annotations

import random
from typing import Any

from bench import READ_LATENCY, each_variant, start
from cocotb.triggers import FallingEdge, ReadOnly

from pearl_marl.memory_map import ENGINE_REGION_NAMES, Control, Doorbell
from pearl_marl.memory_map import REGION_NAMES as OTHER_NAMES

REGION_NAMES = (*OTHER_NAMES, *ENGINE_REGION_NAMES)
RESULTS = {"observations", "rewards", "ters"}
READ_ONLY = RESULTS | {"status", "statistics"}
# What may be read while a step runs.
SHARED = READ_ONLY | {"control", "doorbell"}
# What answers a cycle later than the others.
LATE = {"initial_states", "current_states", "elapsed"}
OKAY, SLVERR, DECERR = 0, 2, 3


@each_variant()
async def requests_reach_their_regions(dut: Any, given: Any) -> None:
    inputs = ("req_i", "we_i", "fetch_i", "addr_i", "wdata_i", "busy_i", "rdata_i", "late_rdata_i")
    await start(dut, **dict.fromkeys(inputs, 0))
    source = random.Random(15)
    size = len(REGION_NAMES) * given.words
    doorbell = REGION_NAMES.index("doorbell")
    reset_word, reset_bit = divmod(32 * Control.RESET, given.word)
    special = [reset_word] + [REGION_NAMES.index(name) * given.words for name in ("observations", "doorbell")]
    # Requests that have not been judged yet, the words that regions owe, and the answers that are due.
    waiting: list[tuple[str, int, int] | None] = [None, None]
    owed: list[tuple[int, int] | None] = [None] * (READ_LATENCY + 1)
    due: list[tuple[int, int | None] | None] = [None] * (READ_LATENCY + 3)
    names = ("re", "we", "busy_write", "busy_doorbell", "untorn", "soft_reset")
    strobes = dict.fromkeys(names, 0)
    at: tuple[int, int] | None = None
    late = 0
    outdated = False
    for cycle in range(4000):
        await FallingEdge(dut.clk_i)
        busy = cycle // 40 % 2
        dut.busy_i.value = busy
        fresh = None
        if source.random() < 0.8:
            address = source.randrange(size + given.words)
            if source.random() < 0.3:
                address = source.choice(special)
            if source.random() < 0.1:  # far behind the map is a hole, whatever the lower bits are
                address |= 1 << source.randrange((size + given.words).bit_length(), given.address_bits)
            data = source.getrandbits(given.word)
            if source.random() < 0.5:  # nothing that resets
                data &= ~(0xFFFFFFFF << reset_bit)
            fresh = source.choice(("read", "fetch", "write")), address, data
            dut.we_i.value, dut.fetch_i.value = int(fresh[0] == "write"), int(fresh[0] == "fetch")
            dut.addr_i.value, dut.wdata_i.value = address, data
        dut.req_i.value = int(fresh is not None)
        # Regions that are not read answer something, too.
        words = [source.getrandbits(given.word) for _ in REGION_NAMES]
        dut.late_rdata_i.value, late = late, 0
        if (answering := owed.pop(0)) is not None:
            region, word = answering
            if REGION_NAMES[region] in LATE:
                words[region], late = 0, word
            else:
                words[region] = word
        dut.rdata_i.value = sum(word << (given.word * i) for i, word in enumerate(words))
        await ReadOnly()

        answer = due.pop(0)
        assert dut.rvalid_o.value == int(answer is not None)
        if answer is not None:
            assert int(dut.resp_o.value) == answer[0]
            if answer[1] is not None:
                assert int(dut.rdata_o.value) == answer[1]
        found = {name: int(getattr(dut, f"{name}_o").value) for name in names}
        assert found == strobes, f"cycle {cycle}"
        if at is not None:
            assert (int(dut.index_o.value), int(dut.wdata_o.value)) == at

        # What the request of two cycles ago comes to in the next cycle, when its access is.
        busy |= strobes["soft_reset"]
        if strobes["we"] >> doorbell & 1 and at is not None:
            busy |= int(at[0] == 32 * Doorbell.SEQUENCE // given.word)
        strobes, at = dict.fromkeys(names, 0), None
        waiting.append(fresh)
        judged = waiting.pop(0)
        if judged is None:
            owed.append(None)
            due.append(None)
            continue
        kind, address, data = judged
        number, index = divmod(address, given.words)
        name = REGION_NAMES[number] if number < len(REGION_NAMES) else None
        resets = kind == "write" and address == reset_word and data >> reset_bit & 0xFFFFFFFF
        if kind == "read":
            allowed = name in SHARED or not busy
        else:
            allowed = name not in READ_ONLY and not (busy or outdated)
        fetches_reset = kind == "fetch" and address == reset_word
        outdated = bool(fetches_reset and busy)
        accepted = allowed or resets or fetches_reset
        answered = None if kind == "write" and accepted else 0
        if name is not None and accepted:
            at = index, data
            strobes["soft_reset"] = int(bool(resets))
            if kind == "write":
                strobes["we"] = int(allowed) << number
            else:
                strobes["re"] = 1 << number
                answered = source.getrandbits(given.word)
            strobes["untorn"] = int(kind == "read" and name == "observations" and index == 0 and not busy)
        elif name is not None and kind != "read" and name not in READ_ONLY:
            strobes["busy_doorbell" if name == "doorbell" else "busy_write"] = 1
        owed.append((number, answered) if strobes["re"] and answered is not None else None)
        due.append((DECERR if name is None else OKAY if accepted else SLVERR, answered))
