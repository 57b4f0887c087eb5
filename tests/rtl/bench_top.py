"""The whole design over AXI against the model."""

from __future__ import annotations

import random
import struct
from typing import Any

import cocotb
import harness
import numpy as np
from bench import axi_master, reset, spec_of, start
from cocotb.triggers import ClockCycles, FallingEdge, with_timeout
from cocotbext.axi.constants import AxiResp
from model import ELAPSED, Model, unpack_region

from pearl_marl.hardware import elaboration
from pearl_marl.memory_map import (
    MAGIC,
    PROTOCOL_VERSION,
    Control,
    Doorbell,
    Mode,
    Status,
    StatusError,
    memory_map,
)
from pearl_marl.spec import word_bits

ARGUMENTS = harness.arguments()
SPEC = spec_of(ARGUMENTS["env"], ARGUMENTS["options"])
LAYOUT = memory_map(SPEC, *ARGUMENTS["size"])
WORD = LAYOUT.data_wl // 8


class Host:
    """The host's half of the protocol."""

    def __init__(self, dut: Any, idle: float = 0.0) -> None:
        self.dut = dut
        if "fault" in ARGUMENTS:  # of a netlist that has one to switch on
            dut.fault_i.value = ARGUMENTS["fault"]
        self.random = random.Random(1)
        self.axi = axi_master(dut, self.random, idle)
        self.sequence = 0

    async def write(self, address: int, data: bytes, expected: AxiResp = AxiResp.OKAY, **kind: Any) -> None:
        answer = await with_timeout(self.axi.write(address, data, **kind), 10, "ms")
        assert answer.resp == expected, f"write of {len(data)} bytes at {address:#x}: {answer.resp}"

    async def read(self, address: int, length: int, expected: AxiResp = AxiResp.OKAY, **kind: Any) -> bytes:
        answer = await with_timeout(self.axi.read(address, length, **kind), 10, "ms")
        assert answer.resp == expected, f"read of {length} bytes at {address:#x}: {answer.resp}"
        return bytes(answer.data)

    async def read_region(self, name: str) -> bytes:
        return await self.read(LAYOUT[name].offset, LAYOUT.size(name))

    async def control(self, **words: int) -> None:
        for name, value in words.items():
            await self.write(4 * Control[name], struct.pack("<I", value))

    async def load(self, model: Model) -> None:
        """Bring the device to the model's settings."""
        await self.control(
            SEED_0=model.seed[0],
            SEED_1=model.seed[1],
            TICK_LOW=model.tick & 0xFFFFFFFF,
            TICK_HIGH=model.tick >> 32,
            FIRST_SLOT=model.first_slot,
            MAX_CYCLES=model.max_cycles,
        )
        initial = model.bytes_of("initial_states", SPEC.state, model.initial_states)
        await self.write(LAYOUT["initial_states"].offset, initial)

    def doorbell(self, mode: Mode) -> bytes:
        self.sequence += 1
        words = [0] * len(Doorbell)
        words[Doorbell.MODE], words[Doorbell.SEQUENCE] = mode, self.sequence
        return struct.pack("<2I", *words)

    async def status(self, **kind: Any) -> list[int]:
        data = await self.read(LAYOUT["status"].offset, 4 * len(Status), **kind)
        return list(struct.unpack("<3I", data))

    async def ring(self, mode: Mode, mask: Any, actions: Any) -> None:
        """Write reset mask, actions and doorbell in one transfer."""
        model = Model(SPEC, LAYOUT)
        data = model.bytes_of("reset_mask", (SPEC.action.__class__("bit", 1),), [mask.astype(np.uint8)])
        by_agent = list(actions.reshape(len(mask), SPEC.agents).T)
        data += model.bytes_of("actions", (SPEC.action,) * SPEC.agents, by_agent)
        await self.write(LAYOUT["reset_mask"].offset, data + self.doorbell(mode))

    async def finish(self, **kind: Any) -> list[int]:
        """Poll until the step is done; return its status."""
        for _ in range(1000):
            status = await self.status(**kind)
            if status[Status.SEQUENCE] == self.sequence:
                assert self.dut.irq_o.value == 1
                return status
        raise AssertionError(f"step {self.sequence} never ended")

    async def results(self) -> tuple[dict[str, bytes], list[int]]:
        """Read results and status in one transfer."""
        base, length = LAYOUT.step_read
        data = await self.read(base, length)
        cut = {
            name: data[LAYOUT[name].offset - base : LAYOUT.end(name) - base]
            for name in ("observations", "rewards", "ters")
        }
        return cut, list(struct.unpack_from("<3I", data, LAYOUT["status"].offset - base))


def cycle_bound() -> int:
    """What a step may cost: its widest stream, 10 %, and the way through the pipeline."""
    interval = {"ShiftAdd": 4}.get(SPEC.name, 1)
    words = max(LAYOUT[name].words for name in ("actions", "observations", "rewards", "ters"))
    # Doorbell, first words, pipeline and last words.
    latency = 24 + 4 * interval
    return int(1.1 * max(LAYOUT.groups * interval, words)) + latency


@cocotb.test
async def identity_is_readable(dut: Any) -> None:
    await start(dut)
    host = Host(dut)
    words = struct.unpack("<16I", await host.read(0, 64))
    assert words[Control.MAGIC] == MAGIC
    assert words[Control.PROTOCOL_VERSION] == PROTOCOL_VERSION
    assert words[Control.ENV_HASH] == elaboration.env_hash(SPEC)
    assert words[Control.N_ENVS] == LAYOUT.n_envs
    assert words[Control.PE_NUM] == LAYOUT.pe_num
    assert words[Control.DATA_WL] == LAYOUT.data_wl
    assert words[Control.STATE_BITS] == word_bits(SPEC.state)
    assert (
        words[Control.RESULT_BITS] == SPEC.agents * (word_bits(SPEC.agent_fields) + SPEC.reward.bits + 1) + 1
    )
    assert words[Control.SEED_0 :] == (0,) * 8


@cocotb.test
async def steps_equal_the_model_in_every_mode(dut: Any) -> None:
    await start(dut)
    host = Host(dut, ARGUMENTS["idle"])
    generator = np.random.default_rng(3)
    model = Model(SPEC, LAYOUT)
    n = LAYOUT.n_envs
    slowest = 0
    for base in (Mode(0), Mode.NEXT_STEP, Mode.STORED, Mode.STORED | Mode.NEXT_STEP):
        for max_cycles in (0, 1, 4):
            model.seed = tuple(int(w) for w in generator.integers(0, 1 << 32, 2))
            model.tick = int(generator.choice([0, 0xFFFFFFFF, 1 << 40]))
            model.first_slot = int(generator.integers(0, 1 << 31))
            model.max_cycles = max_cycles
            model.initial_states = [
                generator.integers(*f.range, n, f.dtype, endpoint=True) for f in SPEC.state
            ]
            await host.load(model)
            for step in range(ARGUMENTS["steps"]):
                mode = base | (Mode.RESET_ALL if step == 0 else Mode(0))
                mode |= Mode.RESET_MASK if generator.random() < 0.4 else Mode(0)
                mask = generator.random(n) < 0.3
                actions = generator.integers(0, SPEC.action_space.n, n * SPEC.agents).astype(np.uint8)
                await host.ring(mode, mask, actions)
                status = await host.finish()
                results, tail = await host.results()
                assert tail == [host.sequence, status[Status.CYCLES], 0]
                # For other settings, or a tick of another high word, a step waits for new random keys.
                waits = step == 0 or model.tick & 0xFFFFFFFF == 0
                expected = model.step(mode, mask, actions)
                assert results == expected, f"{mode!r}, max_cycles {max_cycles}, step {step}"
                slowest = max(slowest, 0 if waits else status[Status.CYCLES])
            current = unpack_region(
                LAYOUT,
                LAYOUT["current_states"],
                (*SPEC.state, *model.ter),
                await host.read_region("current_states"),
            )
            for column, truth in zip(current, [*model.states, model.ters], strict=True):
                np.testing.assert_array_equal(column, truth)
            (elapsed,) = unpack_region(LAYOUT, LAYOUT["elapsed"], ELAPSED, await host.read_region("elapsed"))
            np.testing.assert_array_equal(elapsed, model.elapsed)
    dut._log.info(f"CYCLES {LAYOUT.n_envs}/{LAYOUT.pe_num}/{LAYOUT.data_wl}: {slowest} of {cycle_bound()}")
    assert slowest <= cycle_bound()


@cocotb.test
async def a_saved_state_goes_on_where_it_was(dut: Any) -> None:
    await start(dut)
    host = Host(dut)
    generator = np.random.default_rng(5)
    n = LAYOUT.n_envs
    model = Model(SPEC, LAYOUT)
    model.max_cycles = 9
    model.tick = 77
    model.states = [generator.integers(*f.range, n, f.dtype, endpoint=True) for f in SPEC.state]
    model.elapsed = generator.integers(0, 9, n).astype(np.uint32)
    model.ters = generator.integers(0, 2 << SPEC.agents, n).astype(model.ters.dtype)
    await host.load(model)
    states = model.bytes_of("current_states", (*SPEC.state, *model.ter), [*model.states, model.ters])
    await host.write(LAYOUT["current_states"].offset, states)
    assert await host.read_region("current_states") == states
    elapsed = model.bytes_of("elapsed", ELAPSED, [model.elapsed])
    await host.write(LAYOUT["elapsed"].offset, elapsed)
    assert await host.read_region("elapsed") == elapsed
    nobody = np.zeros(n, bool)
    for _ in range(3):
        actions = generator.integers(0, SPEC.action_space.n, n * SPEC.agents).astype(np.uint8)
        await host.ring(Mode(0), nobody, actions)
        await host.finish()
        assert (await host.results())[0] == model.step(Mode(0), nobody, actions)


# A netlist has ports, and nothing inside by its name.
@cocotb.test(skip="fault" in ARGUMENTS)
async def status_waits_for_the_last_word(dut: Any) -> None:
    await start(dut)
    host = Host(dut)
    inside = dut.u_backbone
    banks = (inside.u_observations, inside.u_rewards, inside.u_ters)
    n = LAYOUT.n_envs
    await host.ring(Mode.RESET_ALL, np.zeros(n, bool), np.ones(n * SPEC.agents, np.uint8))
    done = inside.u_sequencer.busy_o.value == 0
    for _ in range(cycle_bound() + 60):  # the keys are made first
        await FallingEdge(dut.clk_i)
        done |= inside.u_sequencer.done_o.value == 1
        assert not (done and any(bank.we.value == 1 for bank in banks)), "a word was written after the status"
    assert (await host.status())[Status.SEQUENCE] == host.sequence


# Nothing here depends on how many groups there are, and many take many polls.
@cocotb.test(skip=LAYOUT.groups > 10)
async def a_status_is_of_one_step(dut: Any) -> None:
    """Whenever polling starts, and however narrow its beats, cycles come with their sequence number."""
    await start(dut)
    host = Host(dut)
    n = LAYOUT.n_envs
    nobody, actions = np.zeros(n, bool), np.zeros(n * SPEC.agents, np.uint8)
    for beat in {2, WORD.bit_length() - 1}:
        # Longer than a poll takes, so that the step ends between any two of its words.
        for delay in range(20):
            # After a reset the cycles of the last step are 0, and not those of a step.
            await reset(dut)
            await host.ring(Mode.RESET_ALL, nobody, actions)
            await ClockCycles(dut.clk_i, delay + 1)
            status = await host.finish(size=beat)
            assert status == await host.status()
            assert status[Status.CYCLES] >= LAYOUT.groups


@cocotb.test
async def what_is_not_allowed_is_refused(dut: Any) -> None:
    await start(dut)
    host = Host(dut)
    end = LAYOUT.end("status")
    await host.read(end, WORD, AxiResp.DECERR)
    await host.write(end, bytes(WORD), AxiResp.DECERR)
    await host.write(end, bytes(1), AxiResp.DECERR)
    for name in ("observations", "rewards", "ters", "status"):
        before = await host.read_region(name)
        await host.write(LAYOUT[name].offset, b"\xff" * WORD, AxiResp.SLVERR)
        await host.write(LAYOUT[name].offset, b"\xff", AxiResp.SLVERR)
        assert await host.read_region(name) == before
    # The worst answer of a burst is the burst's; what is allowed in it is done.
    await host.read(LAYOUT["status"].offset, LAYOUT.size("status") + WORD, AxiResp.DECERR)
    # A doorbell whose sequence is the last one's does not ring.
    await host.write(LAYOUT["doorbell"].offset, struct.pack("<2I", Mode.RESET_ALL, 0))
    await ClockCycles(dut.clk_i, cycle_bound() + 5)
    assert dut.irq_o.value == 0
    assert (await host.status())[Status.SEQUENCE] == 0


@cocotb.test(skip=LAYOUT.groups < 50)
async def a_running_step_is_left_alone(dut: Any) -> None:
    await start(dut)
    host = Host(dut)
    model = Model(SPEC, LAYOUT)
    n = LAYOUT.n_envs
    nobody, actions = np.zeros(n, bool), np.ones(n * SPEC.agents, np.uint8)

    async def ring() -> dict[str, bytes]:
        await host.ring(Mode.RESET_ALL, nobody, actions)
        return model.step(Mode.RESET_ALL, nobody, actions)

    expected = await ring()
    await host.finish()
    results, status = await host.results()
    assert (results, status[Status.ERROR]) == (expected, StatusError.RESET)
    await host.control(SEED_0=0)  # from here on it holds a batch

    expected = await ring()
    await host.write(LAYOUT["actions"].offset, bytes(WORD), AxiResp.SLVERR)
    await host.finish()
    results, status = await host.results()
    assert (results, status[Status.ERROR]) == (expected, StatusError.BUSY_WRITE)

    expected = await ring()
    late = struct.pack("<2I", Mode.RESET_ALL, host.sequence + 1)
    await host.write(LAYOUT["doorbell"].offset, late, AxiResp.SLVERR)
    await host.finish()
    results, status = await host.results()
    assert (results, status[Status.ERROR]) == (expected, StatusError.BUSY_DOORBELL)

    for name in ("initial_states", "current_states", "elapsed", "reset_mask", "actions"):
        await ring()
        await host.read(LAYOUT[name].offset, WORD, AxiResp.SLVERR)
        await host.finish()

    expected = await ring()
    await host.read(LAYOUT["ters"].offset, WORD)
    assert (await host.finish())[Status.ERROR] == StatusError.TORN_READ
    results, status = await host.results()
    assert (results, status[Status.ERROR]) == (expected, 0)


@cocotb.test
async def a_step_between_two_reads_is_noticed(dut: Any) -> None:
    """Whoever reads a part of the results before a whole step and the others after it has mixed ones."""
    await start(dut)
    host = Host(dut)
    await host.control(SEED_0=0)
    n = LAYOUT.n_envs
    nobody, actions = np.zeros(n, bool), np.zeros(n * SPEC.agents, np.uint8)
    base, length = LAYOUT.step_read
    for begun in range(WORD, LAYOUT["status"].offset - base, WORD):
        await host.ring(Mode.RESET_ALL, nobody, actions)
        await host.finish()
        await host.read(base, begun)
        await host.ring(Mode.RESET_ALL, nobody, actions)
        await host.finish()
        rest = await host.read(base + begun, length - begun)
        status = struct.unpack_from("<3I", rest, LAYOUT["status"].offset - base - begun)
        assert (status[Status.SEQUENCE], status[Status.ERROR]) == (host.sequence, StatusError.TORN_READ)
        assert (await host.results())[1][Status.ERROR] == 0
        if begun >= 8 * WORD:
            break


# Where a word is fetched before the end of a step, and written after it, depends on no size.
@cocotb.test(skip=LAYOUT.groups > 10)
async def a_partial_write_does_not_span_the_end_of_a_step(dut: Any) -> None:
    """Of a word that the hardware changes then: else the tick would go back, and draws would repeat."""
    await start(dut)
    host = Host(dut)
    n = LAYOUT.n_envs
    nobody, actions = np.zeros(n, bool), np.zeros(n * SPEC.agents, np.uint8)
    await host.control(TICK_LOW=0)
    answers = set()
    for tick in range(1, cycle_bound() + 40):
        # Even the shortest step is met by a write that waits for the doorbell's to pass.
        ringing = cocotb.start_soon(host.ring(Mode.RESET_ALL, nobody, actions))
        await ClockCycles(dut.clk_i, tick)
        # The highest byte of the tick's low half is zero, and so it stays.
        answer = await host.axi.write(4 * Control.TICK_LOW + 3, bytes(1))
        await ringing
        error = (await host.finish())[Status.ERROR]
        answers.add(answer.resp)
        assert bool(error & StatusError.BUSY_WRITE) == (answer.resp == AxiResp.SLVERR)
        (found,) = struct.unpack("<I", await host.read(4 * Control.TICK_LOW, 4))
        assert found == tick
    assert answers == {AxiResp.OKAY, AxiResp.SLVERR}


@cocotb.test(skip=LAYOUT.groups > 10)
async def a_reset_ends_a_step_at_any_time(dut: Any) -> None:
    """Over the bus, which goes on; what the hardware holds afterwards is no batch, and it says so."""
    await start(dut)
    host = Host(dut)
    model = Model(SPEC, LAYOUT)
    n = LAYOUT.n_envs
    nobody, actions = np.zeros(n, bool), np.ones(n * SPEC.agents, np.uint8)
    for delay in range(40):
        await host.control(MAX_CYCLES=1, TICK_LOW=7, RESET=0)
        ringing = cocotb.start_soon(host.ring(Mode.RESET_ALL, nobody, actions))
        await ClockCycles(dut.clk_i, delay + 1)
        await host.control(RESET=1 << delay % 32)
        await ringing
        for _ in range(100):
            status = await host.status()
            if status[Status.ERROR]:
                break
            assert status == [0, 0, 0]
        assert status == [0, 0, StatusError.RESET]
        assert dut.irq_o.value == 0
        words = struct.unpack("<8I", await host.read(4 * Control.SEED_0, 32))
        assert words == (0,) * 8
        assert await host.read(LAYOUT["doorbell"].offset, 8) == bytes(8)
        host.sequence = 0
        await host.ring(Mode.RESET_ALL, nobody, actions)
        await host.finish()
        model.tick = 0
        expected = model.step(Mode.RESET_ALL, nobody, actions)
        assert await host.results() == (expected, [1, *(await host.status())[1:]])
        assert (await host.status())[Status.ERROR] == StatusError.RESET


@cocotb.test
async def memory_is_memory_to_any_burst(dut: Any) -> None:
    await start(dut)
    host = Host(dut, 0.3)
    for name in ("actions", "reset_mask", "initial_states"):
        region = LAYOUT[name]
        # What pads a group's row reads as zero, so only rows without padding are tried.
        padded = region.row_words * LAYOUT.data_wl != region.row_slots * region.slot_bits
        if name == "initial_states" and padded:
            continue
        size = LAYOUT.size(name)
        truth = bytearray(size)
        await host.write(region.offset, bytes(truth))
        for _ in range(12):
            begin = host.random.randrange(size)
            length = host.random.randint(1, min(size - begin, 4 * WORD))
            beat = host.random.randint(0, WORD.bit_length() - 1)
            data = host.random.randbytes(length)
            await host.write(region.offset + begin, data, size=beat)
            truth[begin : begin + length] = data
            begin = host.random.randrange(size)
            length = host.random.randint(1, min(size - begin, 4 * WORD))
            found = await host.read(region.offset + begin, length, size=beat)
            assert found == truth[begin : begin + length]
        assert await host.read_region(name) == truth
