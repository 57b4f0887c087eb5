"""pearl_axi_address against the formulas of AXI4 (IHI 0022, section A3.4.1)."""

from __future__ import annotations

import random
from typing import Any

from bench import each_variant, start
from cocotb.triggers import FallingEdge

FIXED, INCR, WRAP = range(3)
BITS, ID_BITS = 16, 4


def some_burst(source: random.Random, longest: int) -> dict[str, int]:
    burst, size = source.choice((FIXED, INCR, WRAP)), source.randrange(8)
    length = source.choice((2, 4, 8, 16)) if burst == WRAP else source.randint(1, longest)
    begin = source.randrange(1 << BITS)
    if burst == WRAP:
        begin -= begin % (1 << size)
    return {"id": source.getrandbits(ID_BITS), "addr": begin, "len": length - 1, "size": size, "burst": burst}


def beats(burst: dict[str, int]) -> list[tuple[int, int, int]]:
    """The identity, the address and the last mark of each beat of a burst."""
    begin, length, bytes_ = burst["addr"], burst["len"] + 1, 1 << burst["size"]
    aligned = begin // bytes_ * bytes_
    wrap = begin // (bytes_ * length) * (bytes_ * length)
    addresses = [begin]
    for beat in range(1, length):
        address = aligned + beat * bytes_
        if burst["burst"] == FIXED:
            address = begin
        elif burst["burst"] == WRAP and address >= wrap + bytes_ * length:
            address -= bytes_ * length
        addresses.append(address % (1 << BITS))
    return [(burst["id"], address, int(k == length - 1)) for k, address in enumerate(addresses)]


async def run(dut: Any, source: random.Random, bursts: list[dict[str, int]], idle: float) -> list[int]:
    """Send bursts and take their beats, each side idle in this share of cycles; return the beats' cycles."""
    await start(dut, valid_i=0, next_i=0, end_i=0)
    await FallingEdge(dut.clk_i)
    left, due, taken, cycle = list(bursts), [beat for burst in bursts for beat in beats(burst)], [], 0
    offered = False
    while len(taken) < len(due):
        # What is valid stays so until it is taken.
        offered = offered or (bool(left) and source.random() >= idle)
        dut.valid_i.value = int(offered)
        for name, bits in (("id", ID_BITS), ("addr", BITS), ("len", 8), ("size", 3), ("burst", 2)):
            getattr(dut, f"{name}_i").value = left[0][name] if offered else source.getrandbits(bits)
        moves = dut.valid_o.value == 1 and source.random() >= idle
        dut.next_i.value = int(moves)
        dut.end_i.value = int(moves and dut.last_o.value == 1)
        if dut.valid_o.value == 1:
            beat = tuple(int(getattr(dut, f"{name}_o").value) for name in ("id", "addr", "last"))
            assert beat == due[len(taken)]
        if moves:
            taken.append(cycle)
        if offered and dut.ready_o.value == 1:
            left.pop(0)
            offered = False
        await FallingEdge(dut.clk_i)
        cycle += 1
    dut.valid_i.value = dut.next_i.value = 0
    await FallingEdge(dut.clk_i)
    assert dut.valid_o.value == 0
    return taken


@each_variant(idle=(0.1, 0.6))
async def addresses_follow_the_standard(dut: Any, given: Any, idle: float) -> None:
    source = random.Random(7)
    bursts = [some_burst(source, 256) for _ in range(20)] + [some_burst(source, 3) for _ in range(80)]
    source.shuffle(bursts)
    await run(dut, source, bursts, idle)


@each_variant()
async def bursts_follow_without_a_gap(dut: Any, given: Any) -> None:
    source = random.Random(8)
    bursts = [{**some_burst(source, 1), "burst": INCR, "len": source.choice((0, 0, 1, 7))} for _ in range(60)]
    taken = await run(dut, source, bursts, 0)
    assert taken == list(range(3, 3 + sum(burst["len"] + 1 for burst in bursts)))
