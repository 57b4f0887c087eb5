"""pearl_axi_slave against cocotbext-axi's master, and against single beats for FIXED and WRAP."""

from __future__ import annotations

import random
from typing import Any

import cocotb
from bench import axi_master, each_variant, start
from cocotb.triggers import ClockCycles, Combine, FallingEdge, RisingEdge, with_timeout
from cocotbext.axi import AxiMaster
from cocotbext.axi.constants import AxiResp

from pearl_marl.latency.cycles import TRANSFER_WAIT, transfer_cycles

IDLES = (0.0, 0.4)
WORDS, READ_ONLY = 64, 8
FIXED, INCR, WRAP = range(3)


def sizes(given: Any) -> tuple[int, int, int]:
    """The bytes of a word, of the memory, and of what may be written of it."""
    width = given.word // 8
    return width, WORDS * width, (WORDS - READ_ONLY) * width


async def clear(axi: AxiMaster, writable: int) -> bytearray:
    await axi.write(0, bytes(writable))
    return bytearray(writable)


@each_variant(idle=IDLES)
async def memory_is_memory_to_any_burst(dut: Any, given: Any, idle: float) -> None:
    width, _, writable = sizes(given)
    await start(dut)
    source = random.Random(8)
    axi = axi_master(dut, source, idle)
    truth = await clear(axi, writable)
    for _ in range(20):
        begin = source.randrange(writable)
        length = source.randint(1, min(writable - begin, 12 * width))
        beat = source.randint(0, width.bit_length() - 1)
        data = source.randbytes(length)
        answer = await with_timeout(axi.write(begin, data, size=beat), 1, "ms")
        assert answer.resp == AxiResp.OKAY
        truth[begin : begin + length] = data
        begin = source.randrange(writable)
        length = source.randint(1, min(writable - begin, 12 * width))
        beat = source.randint(0, width.bit_length() - 1)
        answer = await with_timeout(axi.read(begin, length, size=beat), 1, "ms")
        assert answer.resp == AxiResp.OKAY
        assert answer.data == truth[begin : begin + length]


@each_variant(idle=IDLES)
async def reads_and_writes_at_once_all_end(dut: Any, given: Any, idle: float) -> None:
    _, _, writable = sizes(given)
    await start(dut)
    source = random.Random(9)
    axi = axi_master(dut, source, idle)
    await clear(axi, writable)
    half = writable // 2

    async def writes() -> None:
        for i in range(20):
            await axi.write(half + i, bytes([i]))

    async def reads() -> None:
        for _ in range(6):
            assert (await axi.read(0, half)).data == bytes(half)

    await with_timeout(Combine(cocotb.start_soon(writes()), cocotb.start_soon(reads())), 1, "ms")
    assert (await axi.read(half, 20)).data == bytes(range(20))


@each_variant(idle=IDLES)
async def errors_are_told_and_change_nothing(dut: Any, given: Any, idle: float) -> None:
    width, whole, writable = sizes(given)
    await start(dut)
    source = random.Random(10)
    axi = axi_master(dut, source, idle)
    await clear(axi, writable)
    before = (await axi.read(writable, whole - writable)).data
    for length in (1, width, 3 * width):
        assert (await axi.write(writable, b"\xff" * length)).resp == AxiResp.SLVERR
        assert (await axi.write(whole, b"\xff" * length)).resp == AxiResp.DECERR
        assert (await axi.read(whole, length)).resp == AxiResp.DECERR
    assert (await axi.read(writable, whole - writable)).data == before
    # One bad beat makes a bad burst, and the worst one names it.
    assert (await axi.write(writable - width, bytes(2 * width))).resp == AxiResp.SLVERR
    assert (await axi.write(whole - width, bytes(2 * width))).resp == AxiResp.DECERR
    assert (await axi.read(whole - width, 2 * width)).resp == AxiResp.DECERR
    # And the next one is good again.
    assert (await axi.write(0, bytes(width))).resp == AxiResp.OKAY


@each_variant()
async def whole_words_stream(dut: Any, given: Any) -> None:
    width, _, _ = sizes(given)
    await start(dut)
    axi = axi_master(dut, random.Random(11), 0)
    beats = {"w": 0, "r": 0}
    # Writes where the memory sees them: the slave takes the first ones before the burst has begun.
    signals = {"w": (dut.req, dut.we), "r": (dut.s_axi_rvalid, dut.s_axi_rready)}

    async def count(channel: str) -> None:
        first = last = cycle = 0
        while beats[channel] < 32:
            await RisingEdge(dut.clk_i)
            cycle += 1
            if all(signal.value == 1 for signal in signals[channel]):
                beats[channel] += 1
                first = first or cycle
                last = cycle
        assert last - first == 31, f"{channel}: 32 beats took {last - first + 1} cycles"

    for channel, work in (("w", axi.write(0, bytes(32 * width))), ("r", axi.read(0, 32 * width))):
        counting = cocotb.start_soon(count(channel))
        await with_timeout(work, 1, "ms")
        await with_timeout(counting, 1, "ms")


async def span(dut: Any, first: str, last: str, count: int) -> int:
    """The cycles from the first handshake of a channel to a channel's so-manieth, both included."""
    began = done = cycle = 0
    while done < count:
        await RisingEdge(dut.clk_i)
        cycle += 1
        if not began and moves(dut, first):
            began = cycle
        done += moves(dut, last)
    return cycle - began + 1


def moves(dut: Any, channel: str) -> bool:
    return all(getattr(dut, f"s_axi_{channel}{end}").value == 1 for end in ("valid", "ready"))


@each_variant(beats=(1, 8, 16, 64))
async def queued_bursts_follow_without_a_gap(dut: Any, given: Any, beats: int) -> None:
    """So the latency model holds for bursts of any length (pearl_marl/latency/cycles.py)."""
    width, _, writable = sizes(given)
    await start(dut)
    axi = axi_master(dut, random.Random(13), 0)
    await clear(axi, writable)
    axi.write_if.max_burst_len = axi.read_if.max_burst_len = beats
    beats = min(beats, 4096 // width)  # AXI4's limit
    words = WORDS // beats * beats
    await ClockCycles(dut.clk_i, 20)
    counting = cocotb.start_soon(span(dut, "aw", "b", words // beats))
    await with_timeout(axi.write(0, bytes(words * width)), 1, "ms")
    assert await counting == words + TRANSFER_WAIT
    await ClockCycles(dut.clk_i, 20)
    counting = cocotb.start_soon(span(dut, "ar", "r", words))
    await with_timeout(axi.read(0, words * width), 1, "ms")
    assert await counting == words + TRANSFER_WAIT
    # One at a time, each of them takes as long as that.
    alone = 0
    for begin in range(0, words * width, beats * width):
        counting = cocotb.start_soon(span(dut, "ar", "r", beats))
        await with_timeout(axi.read(begin, beats * width), 1, "ms")
        alone += await counting
    assert alone == transfer_cycles(0, words * width, width, beats * width)


@each_variant()
async def reads_and_writes_share_the_port(dut: Any, given: Any) -> None:
    width, _, writable = sizes(given)
    await start(dut)
    axi = axi_master(dut, random.Random(14), 0)
    await clear(axi, writable)
    axi.write_if.max_burst_len = axi.read_if.max_burst_len = 8
    await ClockCycles(dut.clk_i, 20)
    words = 48
    both = [
        cocotb.start_soon(span(dut, first, last, count))
        for first, last, count in (("aw", "b", words // 8), ("ar", "r", words))
    ]
    work = axi.write(0, bytes(words * width)), axi.read(0, words * width)
    await with_timeout(Combine(*map(cocotb.start_soon, work)), 1, "ms")
    for counting in both:
        assert 2 * words - 8 <= await counting <= 2 * words + TRANSFER_WAIT


STALLS = {"aw": "write", "w": "write", "b": "write", "ar": "read", "r": "read"}
"""Channels that a master may keep from moving, and what that stops."""


@each_variant(channel=tuple(STALLS))
async def neither_kind_waits_for_the_others_master(dut: Any, given: Any, channel: str) -> None:
    width, _, writable = sizes(given)
    await start(dut)
    source = random.Random(15)
    axi = axi_master(dut, source, 0)
    truth = await clear(axi, writable)
    half = writable // 2 // width * width
    axi.write_if.max_burst_len = axi.read_if.max_burst_len = 1
    stopped = axi.write_if if STALLS[channel] == "write" else axi.read_if
    getattr(stopped, f"{channel}_channel").pause = True
    data = source.randbytes(half)
    # More than the slave has room for.
    waiting = axi.write(half, data) if stopped is axi.write_if else axi.read(half, half)
    held = cocotb.start_soon(waiting)
    await ClockCycles(dut.clk_i, 60)
    for _ in range(8):
        begin, length = source.randrange(half - 2 * width), source.randint(1, 2 * width)
        if stopped is axi.write_if:
            answer = await with_timeout(axi.read(begin, length), 3, "us")
            assert answer.data == truth[begin : begin + length]
        else:
            some = source.randbytes(length)
            assert (await with_timeout(axi.write(begin, some), 3, "us")).resp == AxiResp.OKAY
            truth[begin : begin + length] = some
    assert not held.done()
    getattr(stopped, f"{channel}_channel").pause = False
    answer = await with_timeout(held, 1, "ms")
    assert answer.resp == AxiResp.OKAY
    if stopped is axi.write_if:
        truth[half : 2 * half] = data
    assert (await axi.read(0, writable)).data == truth


@each_variant(idle=IDLES)
async def many_masters_with_many_ids_see_a_memory(dut: Any, given: Any, idle: float) -> None:
    """Each has a share of the memory for itself, with words that it shares with its neighbours."""
    width, _, writable = sizes(given)
    await start(dut)
    source = random.Random(16)
    axi = axi_master(dut, source, idle)
    truth = await clear(axi, writable)
    masters = 6

    async def work(master: int) -> None:
        low, high = writable * master // masters, writable * (master + 1) // masters
        low, high = low + master % 2, high - 1
        for _ in range(8):
            begin = source.randrange(low, high)
            beat = source.randint(0, width.bit_length() - 1)
            # Many beats of single bytes would be most of the time where words are wide.
            length = source.randint(1, min(high - begin, 5 * width, 40 << beat))
            name = source.randrange(16)
            if source.random() < 0.5:
                data = source.randbytes(length)
                answer = await axi.write(begin, data, awid=name, size=beat)
                truth[begin : begin + length] = data
            else:
                answer = await axi.read(begin, length, arid=name, size=beat)
                assert answer.data == truth[begin : begin + length]
            assert answer.resp == AxiResp.OKAY

    await with_timeout(Combine(*(cocotb.start_soon(work(master)) for master in range(masters))), 2, "ms")
    assert (await axi.read(0, writable)).data == truth


@each_variant()
async def answers_come_in_the_order_of_addresses(dut: Any, given: Any) -> None:
    width, whole, writable = sizes(given)
    await start(dut)
    source = random.Random(17)
    axi = axi_master(dut, source, 0.3)
    truth = bytearray(source.randbytes(writable))
    await axi.write(0, bytes(truth))
    ids: dict[str, list[int]] = {name: [] for name in ("ar", "r", "aw", "b")}

    async def watch() -> None:
        while True:
            await RisingEdge(dut.clk_i)
            for name, seen in ids.items():
                if moves(dut, name) and (name != "r" or dut.s_axi_rlast.value == 1):
                    seen.append(int(getattr(dut, f"s_axi_{name}id").value))

    cocotb.start_soon(watch())
    reads, writes = [], []
    for k in range(30):
        begin = source.randrange(writable - width)
        reads.append((begin, axi.init_read(begin, source.randint(1, width), arid=source.randrange(16))))
        # Half of them are refused, and say so in their turn.
        refused = k % 2
        writes.append(
            (
                refused,
                axi.init_write(whole - width if refused else 0, truth[:width], awid=source.randrange(16)),
            )
        )
    for begin, event in reads:
        await with_timeout(event.wait(), 1, "ms")
        assert event.data.data == truth[begin : begin + len(event.data.data)]
        assert event.data.resp == AxiResp.OKAY
    for refused, event in writes:
        await with_timeout(event.wait(), 1, "ms")
        assert event.data.resp == (AxiResp.SLVERR if refused else AxiResp.OKAY)
    assert ids["r"] == ids["ar"]
    assert ids["b"] == ids["aw"]
    assert len(ids["r"]) == len(ids["b"]) == 30


@each_variant()
async def fixed_and_wrapping_bursts(dut: Any, given: Any) -> None:
    width, _, _ = sizes(given)
    names = ("awvalid", "wvalid", "bready", "arvalid", "rready", "awid", "arid")
    await start(dut, **{f"s_axi_{name}": 0 for name in names})
    source = random.Random(12)
    size = width.bit_length() - 1

    async def put(**values: int) -> None:
        for name, value in values.items():
            getattr(dut, f"s_axi_{name}").value = value

    async def until(name: str) -> None:
        while True:
            await cocotb.triggers.ReadOnly()
            done = getattr(dut, f"s_axi_{name}").value == 1
            await FallingEdge(dut.clk_i)
            if done:
                return

    async def write(begin: int, burst: int, words: list[int]) -> None:
        await put(awaddr=begin, awlen=len(words) - 1, awsize=size, awburst=burst, awvalid=1, awid=5)
        await until("awready")
        await put(awvalid=0)
        for i, word in enumerate(words):
            await put(wdata=word, wstrb=(1 << width) - 1, wlast=int(i == len(words) - 1), wvalid=1)
            await until("wready")
        await put(wvalid=0, bready=1)
        while dut.s_axi_bvalid.value == 0:
            await FallingEdge(dut.clk_i)
        assert (int(dut.s_axi_bid.value), int(dut.s_axi_bresp.value)) == (5, 0)
        await FallingEdge(dut.clk_i)
        await put(bready=0)

    async def read(begin: int, burst: int, count: int) -> list[int]:
        await put(araddr=begin, arlen=count - 1, arsize=size, arburst=burst, arvalid=1, arid=6)
        await until("arready")
        await put(arvalid=0)
        words = []
        while len(words) < count:
            ready = source.random() < 0.7
            await put(rready=int(ready))
            if ready and dut.s_axi_rvalid.value == 1:
                words.append(int(dut.s_axi_rdata.value))
                assert dut.s_axi_rlast.value == (len(words) == count)
                assert int(dut.s_axi_rid.value) == 6
            await FallingEdge(dut.clk_i)
        await put(rready=0)
        return words

    await FallingEdge(dut.clk_i)
    for length in (2, 4, 8, 16):
        words = [source.getrandbits(8 * width) for _ in range(length)]
        await write(0, INCR, words)
        shift = source.randrange(length)
        turned = words[shift:] + words[:shift]
        assert await read(shift * width, WRAP, length) == turned
        await write(shift * width, WRAP, words)
        assert await read(0, INCR, length) == words[-shift:] + words[:-shift] if shift else words
        await write(width, FIXED, words)
        assert await read(width, FIXED, 3) == [words[-1]] * 3
