"""pearl_registers against a model of its words, under random writes, ends of steps and errors."""

from __future__ import annotations

import random
from typing import Any

from bench import READ_LATENCY, each_variant, start
from cocotb.triggers import FallingEdge, ReadOnly

from pearl_marl.memory_map import MAGIC, PROTOCOL_VERSION, Control, Doorbell, Mode, Status, StatusError


@each_variant()
async def words_equal_the_model(dut: Any, given: Any) -> None:
    per_word = given.word // 32
    identity = [MAGIC, PROTOCOL_VERSION | given.engine << 16, 0x1234, 7, 4, given.word, 6, 9]

    def words_of(data: int) -> list[int]:
        return [data >> (32 * i) & 0xFFFFFFFF for i in range(per_word)]

    flags = ("done_i", "busy_write_i", "busy_doorbell_i", "untorn_i", "draining_i")
    inputs = ("index_i", "control_we_i", "doorbell_we_i", "wdata_i", "next_wdata_i", "cycles_i", *flags)
    await start(dut, **dict.fromkeys(inputs, 0), last_i=1)
    source = random.Random(16)
    control, doorbell, status = [*identity, *[0] * 8], [0, 0], [0, 0, int(StatusError.RESET)]
    stale = False
    for _ in range(1000):
        await FallingEdge(dut.clk_i)
        kind = source.choice(("control", "doorbell", "again", "none"))
        # A second write of a doorbell is one of the same words.
        data = sum(word << (32 * i) for i, word in enumerate(doorbell)) if kind == "again" else 0
        if kind != "again":
            edges = (0, 1, 0xFFFFFFFF, source.getrandbits(32))
            data = sum(source.choice(edges) << (32 * i) for i in range(per_word))
        data &= (1 << given.word) - 1
        dut.next_wdata_i.value = data
        await FallingEdge(dut.clk_i)
        size = len(Control) if kind == "control" else len(Doorbell)
        index = 0 if kind == "again" and per_word > 1 else source.randrange(-(-size // per_word))
        event = source.choice((*flags, *["none"] * 15))
        # What the port refuses does not come.
        if event == "draining_i" or (event == "done_i" and kind == "control"):
            kind = "none"
        cycles = source.getrandbits(32)
        dut.index_i.value, dut.wdata_i.value, dut.cycles_i.value = index, data, cycles
        dut.control_we_i.value = int(kind == "control")
        dut.doorbell_we_i.value = int(kind in ("doorbell", "again"))
        for flag in flags:
            getattr(dut, flag).value = int(flag == event)
        await ReadOnly()

        written = dict(zip(range(index * per_word, (index + 1) * per_word), words_of(data), strict=True))
        rung = doorbell[Doorbell.SEQUENCE]
        rings = kind in ("doorbell", "again") and written.get(Doorbell.SEQUENCE, rung) != rung
        assert dut.ring_o.value == int(rings)
        tick = control[Control.TICK_LOW] | control[Control.TICK_HIGH] << 32
        assert int(dut.tick_o.value) == tick
        assert int(dut.seed_o.value) == control[Control.SEED_0] | control[Control.SEED_1] << 32
        assert int(dut.first_slot_o.value) == control[Control.FIRST_SLOT]
        assert int(dut.limited_o.value) == int(control[Control.MAX_CYCLES] != 0)
        assert int(dut.limit_o.value) == (control[Control.MAX_CYCLES] - 1) % (1 << 32)
        assert int(dut.mode_o.value) == doorbell[Doorbell.MODE] % (1 << len(Mode))
        assert dut.keys_stale_o.value == int(stale)

        carries = event == "done_i" and control[Control.TICK_LOW] == 0xFFFFFFFF
        stale = kind == "control" or event == "draining_i" or carries
        if event == "draining_i":
            control, doorbell, status = [*identity, *[0] * 8], [0, 0], [0, 0, 0]
        if event == "done_i":
            status[Status.SEQUENCE], status[Status.CYCLES] = rung, cycles
            tick = (tick + 1) % (1 << 64)
            control[Control.TICK_LOW], control[Control.TICK_HIGH] = tick & 0xFFFFFFFF, tick >> 32
        if kind == "control":
            status[Status.ERROR] &= ~StatusError.RESET
            settings = [*range(Control.SEED_0, Control.RESET), *[Control.STEPS] * bool(given.engine)]
            for word in settings:
                control[word] = written.get(word, control[word])
        elif kind != "none":
            doorbell = [written.get(word, doorbell[word]) for word in Doorbell]
        if rings:
            status[Status.ERROR] &= ~(StatusError.BUSY_WRITE | StatusError.BUSY_DOORBELL)
            status[Status.ERROR] |= StatusError.TORN_READ
        for flag, bit in (
            ("busy_write_i", StatusError.BUSY_WRITE),
            ("busy_doorbell_i", StatusError.BUSY_DOORBELL),
        ):
            status[Status.ERROR] |= bit if event == flag else 0
        if event == "untorn_i" and not rings:
            status[Status.ERROR] &= ~StatusError.TORN_READ

        # What is read one cycle later is what the registers hold then.
        await FallingEdge(dut.clk_i)
        for name in ("control_we_i", "doorbell_we_i", *flags):
            getattr(dut, name).value = int(name == event == "draining_i")
        assert dut.keys_stale_o.value == int(stale)
        assert dut.keys_next_o.value == int(event == "done_i" and not carries)
        stale = event == "draining_i"
        for _ in range(READ_LATENCY - 1):
            await FallingEdge(dut.clk_i)
        for port, words in (("control_o", control), ("doorbell_o", doorbell), ("status_o", status)):
            padded = [*words, *[0] * (len(control) + per_word)]
            found = words_of(int(getattr(dut, port).value))
            assert found == padded[index * per_word : (index + 1) * per_word], port
        if event == "draining_i":
            status[Status.ERROR] = int(StatusError.RESET)
