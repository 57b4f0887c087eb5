"""pearl_axi_slave against cocotbext-axi's master, and against single beats for FIXED and WRAP."""

from __future__ import annotations

import random
from typing import Any

import cocotb
import harness
from bench import axi_master, start
from cocotb.triggers import Combine, FallingEdge, RisingEdge, with_timeout
from cocotbext.axi import AxiMaster
from cocotbext.axi.constants import AxiResp

WORD = harness.arguments()["word"] // 8
IDLES = (0.0, 0.4)
WORDS, READ_ONLY = 64, 8
SIZE, WRITABLE = WORDS * WORD, (WORDS - READ_ONLY) * WORD
FIXED, INCR, WRAP = range(3)


async def clear(axi: AxiMaster) -> bytearray:
    await axi.write(0, bytes(WRITABLE))
    return bytearray(WRITABLE)


@cocotb.test
@cocotb.parametrize(idle=IDLES)
async def memory_is_memory_to_any_burst(dut: Any, idle: float) -> None:
    await start(dut)
    source = random.Random(8)
    axi = axi_master(dut, source, idle)
    truth = await clear(axi)
    for _ in range(60):
        begin = source.randrange(WRITABLE)
        length = source.randint(1, min(WRITABLE - begin, 12 * WORD))
        beat = source.randint(0, WORD.bit_length() - 1)
        data = source.randbytes(length)
        answer = await with_timeout(axi.write(begin, data, size=beat), 1, "ms")
        assert answer.resp == AxiResp.OKAY
        truth[begin : begin + length] = data
        begin = source.randrange(WRITABLE)
        length = source.randint(1, min(WRITABLE - begin, 12 * WORD))
        beat = source.randint(0, WORD.bit_length() - 1)
        answer = await with_timeout(axi.read(begin, length, size=beat), 1, "ms")
        assert answer.resp == AxiResp.OKAY
        assert answer.data == truth[begin : begin + length]


@cocotb.test
@cocotb.parametrize(idle=IDLES)
async def reads_and_writes_at_once_all_end(dut: Any, idle: float) -> None:
    await start(dut)
    source = random.Random(9)
    axi = axi_master(dut, source, idle)
    await clear(axi)
    half = WRITABLE // 2

    async def writes() -> None:
        for i in range(20):
            await axi.write(half + i, bytes([i]))

    async def reads() -> None:
        for _ in range(20):
            assert (await axi.read(0, half)).data == bytes(half)

    await with_timeout(Combine(cocotb.start_soon(writes()), cocotb.start_soon(reads())), 1, "ms")
    assert (await axi.read(half, 20)).data == bytes(range(20))


@cocotb.test
@cocotb.parametrize(idle=IDLES)
async def errors_are_told_and_change_nothing(dut: Any, idle: float) -> None:
    await start(dut)
    source = random.Random(10)
    axi = axi_master(dut, source, idle)
    await clear(axi)
    before = (await axi.read(WRITABLE, SIZE - WRITABLE)).data
    for length in (1, WORD, 3 * WORD):
        assert (await axi.write(WRITABLE, b"\xff" * length)).resp == AxiResp.SLVERR
        assert (await axi.write(SIZE, b"\xff" * length)).resp == AxiResp.DECERR
        assert (await axi.read(SIZE, length)).resp == AxiResp.DECERR
    assert (await axi.read(WRITABLE, SIZE - WRITABLE)).data == before
    # One bad beat makes a bad burst, and the worst one names it.
    assert (await axi.write(WRITABLE - WORD, bytes(2 * WORD))).resp == AxiResp.SLVERR
    assert (await axi.write(SIZE - WORD, bytes(2 * WORD))).resp == AxiResp.DECERR
    assert (await axi.read(SIZE - WORD, 2 * WORD)).resp == AxiResp.DECERR
    # And the next one is good again.
    assert (await axi.write(0, bytes(WORD))).resp == AxiResp.OKAY


@cocotb.test
async def whole_words_stream(dut: Any) -> None:
    await start(dut)
    axi = axi_master(dut, random.Random(11), 0)
    beats = {"w": 0, "r": 0}

    async def count(channel: str) -> None:
        valid, ready = (getattr(dut, f"s_axi_{channel}{end}") for end in ("valid", "ready"))
        first = last = cycle = 0
        while beats[channel] < 32:
            await RisingEdge(dut.clk_i)
            cycle += 1
            if valid.value == 1 and ready.value == 1:
                beats[channel] += 1
                first = first or cycle
                last = cycle
        assert last - first == 31, f"{channel}: 32 beats took {last - first + 1} cycles"

    for channel, work in (("w", axi.write(0, bytes(32 * WORD))), ("r", axi.read(0, 32 * WORD))):
        counting = cocotb.start_soon(count(channel))
        await with_timeout(work, 1, "ms")
        await with_timeout(counting, 1, "ms")


@cocotb.test
async def fixed_and_wrapping_bursts(dut: Any) -> None:
    names = ("awvalid", "wvalid", "bready", "arvalid", "rready", "awid", "arid")
    await start(dut, **{f"s_axi_{name}": 0 for name in names})
    source = random.Random(12)
    size = WORD.bit_length() - 1

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
            await put(wdata=word, wstrb=(1 << WORD) - 1, wlast=int(i == len(words) - 1), wvalid=1)
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
        words = [source.getrandbits(8 * WORD) for _ in range(length)]
        await write(0, INCR, words)
        shift = source.randrange(length)
        turned = words[shift:] + words[:shift]
        assert await read(shift * WORD, WRAP, length) == turned
        await write(shift * WORD, WRAP, words)
        assert await read(0, INCR, length) == words[-shift:] + words[:-shift] if shift else words
        await write(WORD, FIXED, words)
        assert await read(WORD, FIXED, 3) == [words[-1]] * 3
