"""The whole design of the ULX3S at its serial line: the protocol, and what may go wrong on it."""

from __future__ import annotations

import random
import struct
import zlib
from typing import Any

import cocotb
import harness
from bench import spec_of
from cocotb.clock import Clock
from cocotb.triggers import ClockCycles, FallingEdge, Timer

from pearl_marl.devices.serial import answer_bytes, request
from pearl_marl.hardware import elaboration
from pearl_marl.memory_map import MAGIC, Control, memory_map

ARGUMENTS = harness.arguments()
SPEC = spec_of(ARGUMENTS["env"], {})
LAYOUT = memory_map(SPEC, *ARGUMENTS["size"])
PERIOD = 10  # ns
BIT = ARGUMENTS["clocks_per_bit"] * PERIOD
OKAY, SLVERR, DECERR = 0, 2, 3


class Line:
    """The host's end; it sends bits of ``bit`` ns."""

    def __init__(self, dut: Any, bit: int) -> None:
        self.dut, self.bit = dut, bit
        self.received = bytearray()
        cocotb.start_soon(self._listen())

    async def _listen(self) -> None:
        line = self.dut.ftdi_rxd
        while True:
            await FallingEdge(line)
            await Timer(BIT // 2, "ns")
            assert line.value == 0, "the start bit is as long as any"
            value = 0
            for i in range(8):
                await Timer(BIT, "ns")
                value |= int(line.value) << i
            await Timer(BIT, "ns")
            assert line.value == 1, "a stop bit ends every byte"
            self.received.append(value)

    async def send(self, data: bytes) -> None:
        for byte in data:
            for level in (0, *((byte >> i) & 1 for i in range(8)), 1):
                self.dut.ftdi_txd.value = level
                await Timer(self.bit, "ns")

    async def break_off(self) -> None:
        """Hold the line low for longer than any byte does."""
        self.dut.ftdi_txd.value = 0
        await Timer(12 * self.bit, "ns")
        self.dut.ftdi_txd.value = 1
        await Timer(20 * self.bit, "ns")
        self.received.clear()

    async def answer(self, length: int) -> bytes:
        # With time for a byte that would be too many.
        await Timer((length + 4) * 11 * BIT, "ns")
        assert len(self.received) == length
        answer = bytes(self.received)
        self.received.clear()
        if answer:
            assert struct.unpack("<I", answer[-4:])[0] == zlib.crc32(answer[:-4])
        return answer[:-4]

    async def write(self, address: int, data: bytes) -> int:
        await self.send(request("W", address, len(data) // 4, data))
        return (await self.answer(answer_bytes(0)))[-1]

    async def read(self, address: int, words: int) -> tuple[bytes, int]:
        await self.send(request("R", address, words))
        answer = await self.answer(answer_bytes(words))
        return answer[:-1], answer[-1]


async def start(dut: Any, bit: int = BIT) -> Line:
    """Come to a board that has been on: there is no reset but its power."""
    dut.ftdi_txd.value = 1
    dut.u_pll.locked.value = 1
    cocotb.start_soon(Clock(dut.clk_25mhz, PERIOD, unit="ns").start())
    await ClockCycles(dut.clk_25mhz, 50)
    line = Line(dut, bit)
    await line.break_off()
    return line


@cocotb.test
async def it_is_in_reset_until_its_clock_is_ready(dut: Any) -> None:
    dut.ftdi_txd.value = 1
    dut.u_pll.locked.value = 0
    cocotb.start_soon(Clock(dut.clk_25mhz, PERIOD, unit="ns").start())
    for locked in (0, 1, 0, 1):
        dut.u_pll.locked.value = locked
        await ClockCycles(dut.clk_25mhz, 8)
        assert dut.rst_n.value == locked
        assert dut.led.value == locked


@cocotb.test
async def identity_is_readable(dut: Any) -> None:
    line = await start(dut)
    assert dut.led.value == 0b01
    assert dut.wifi_gpio0.value == 1
    data, response = await line.read(0, len(Control))
    words = struct.unpack(f"<{len(Control)}I", data)
    assert response == OKAY
    assert words[Control.MAGIC] == MAGIC
    assert words[Control.ENV_HASH] == elaboration.env_hash(SPEC)
    sizes = (LAYOUT.n_envs, LAYOUT.pe_num, LAYOUT.data_wl)
    assert words[Control.N_ENVS : Control.DATA_WL + 1] == sizes


# The ends of a cable may differ by some per cent.
@cocotb.test
@cocotb.parametrize(share=(0.97, 1.0, 1.03))
async def memory_is_memory(dut: Any, share: float) -> None:
    line = await start(dut, round(BIT * share))
    source = random.Random(5)
    region = LAYOUT["actions"]
    data = source.randbytes(LAYOUT.size("actions"))
    assert await line.write(region.offset, data) == OKAY
    assert await line.read(region.offset, len(data) // 4) == (data, OKAY)
    # Part of it, and none.
    assert await line.write(region.offset + 4, data[:4]) == OKAY
    expected = data[:4] + data[:4] + data[8:]
    assert await line.read(region.offset, len(data) // 4) == (expected, OKAY)
    assert await line.write(region.offset, b"") == OKAY
    assert await line.read(region.offset, 0) == (b"", OKAY)
    assert await line.read(region.offset + 8, 1) == (data[8:12], OKAY)


@cocotb.test
async def the_worst_response_is_the_answers(dut: Any) -> None:
    line = await start(dut)
    end = LAYOUT.end("status")
    assert (await line.read(end - 4, 2))[1] == DECERR
    assert (await line.read(end - 4, 1))[1] == OKAY
    assert await line.write(LAYOUT["status"].offset, bytes(4)) == SLVERR
    assert await line.write(end - 4, bytes(8)) == DECERR
    # Far addresses are not near ones come round again, but the last is followed by the first.
    assert (await line.read(1 << 31, 1))[1] == DECERR
    data, response = await line.read((1 << 32) - 4, 2)
    assert (data[4:], response) == (struct.pack("<I", MAGIC), DECERR)
    assert await line.write(0, bytes(4)) == OKAY
    assert await line.write((1 << 32) - 4, bytes(8)) == DECERR


@cocotb.test
async def what_is_damaged_is_not_answered(dut: Any) -> None:
    line = await start(dut)
    good = request("R", 0, 1)
    for i in range(len(good) - 6):
        # Words come after the address: with more of them it would be no whole request.
        await line.send(good[:i] + bytes([good[i] ^ 0x10]) + good[i + 1 :])
        assert await line.answer(0) == b""
        await line.break_off()
    for damaged in (good[:-1] + bytes([good[-1] ^ 1]), request("X", 0, 1), good[:5], b"\x00"):
        await line.send(damaged)
        assert await line.answer(0) == b""
        await line.break_off()
        assert (await line.read(0, 1))[0] == struct.pack("<I", MAGIC)


@cocotb.test
async def a_break_ends_an_answer(dut: Any) -> None:
    line = await start(dut)
    await line.send(request("R", 0, 16))
    await Timer(100 * BIT, "ns")
    assert 0 < len(line.received) < 16 * 4
    await line.break_off()
    assert await line.answer(0) == b""
    assert (await line.read(0, 1))[0] == struct.pack("<I", MAGIC)


@cocotb.test
async def a_glitch_is_no_byte(dut: Any) -> None:
    line = await start(dut)
    dut.ftdi_txd.value = 0
    await Timer(BIT // 4, "ns")
    dut.ftdi_txd.value = 1
    await Timer(2 * BIT, "ns")
    assert (await line.read(0, 1))[0] == struct.pack("<I", MAGIC)
