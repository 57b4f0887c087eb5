"""pearl_axi_slave against cocotbext-axi's master, and against single beats for FIXED and WRAP."""

from __future__ import annotations

import random
from typing import Any

import cocotb
from bench import axi_master, each_variant, start
from cocotb.triggers import Combine, FallingEdge, RisingEdge, with_timeout
from cocotbext.axi import AxiMaster
from cocotbext.axi.constants import AxiResp

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
