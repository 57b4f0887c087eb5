"""A core against its golden functions."""

from __future__ import annotations

import itertools
from typing import Any

import cocotb
import harness
import numpy as np
from bench import spec_of, start
from cocotb.triggers import FallingEdge

from pearl_marl.golden import call_reference
from pearl_marl.spec import Field

ARGUMENTS = harness.arguments()
SPEC = spec_of(ARGUMENTS["env"], ARGUMENTS["options"])
LATENCY, II = ARGUMENTS["latency"], ARGUMENTS["ii"]
DRAWS = SPEC.reset_draws + SPEC.step_draws
# Where a draw's third changes, and where its other uses do.
EDGE_DRAWS = (0, 0x55555555, 0x55555556, 0xAAAAAAAA, 0xAAAAAAAB, 0xFFFFFFFF, 0x12345678)


def split(word: int, fields: tuple[Field, ...]) -> list[Any]:
    values = []
    for field in fields:
        values.append(field.dtype.type(word & ((1 << field.bits) - 1)))
        word >>= field.bits
    return values


def join(values: Any, fields: tuple[Field, ...]) -> int:
    word, offset = 0, 0
    for value, field in zip(values, fields, strict=True):
        word |= (int(value) & ((1 << field.bits) - 1)) << offset
        offset += field.bits
    return word


def golden(state: int, action: int, first: bool, hold: bool, draws: tuple[int, ...]) -> dict[str, int]:
    words = [np.uint32(draw) for draw in draws]
    origin = split(state, SPEC.state)
    if first:
        drawn = call_reference(SPEC.golden.initial, words[: SPEC.reset_draws])
        origin = [f.dtype.type(w) for w, f in zip(drawn, SPEC.state, strict=True)]
    act = SPEC.action.dtype.type(action)
    *moved, reward, terminated = call_reference(SPEC.golden.step, [*origin, act, *words[SPEC.reset_draws :]])
    after = origin if hold else moved
    observed = call_reference(SPEC.golden.observe, after)
    results = {"state_o": join(after, SPEC.state), "obs_o": join(observed, SPEC.observation)}
    # The backbone masks reward and end of a slot that is held.
    return results if hold else {**results, "reward_o": int(reward), "terminated_o": int(terminated)}


@cocotb.test
async def every_case_equals_the_golden_step(dut: Any) -> None:
    await start(dut, valid_i=0, first_i=0, hold_i=0, state_i=0, action_i=0, rng_i=0)
    bits = sum(f.bits for f in SPEC.state)
    draws = np.random.default_rng(13).integers(0, 1 << 32, (4096, max(1, DRAWS)))
    cases = [
        (state, action, first, hold)
        for state in range(0, 1 << bits, ARGUMENTS["stride"])
        for action in range(SPEC.action_space.n)
        for first, hold in itertools.product((False, True), repeat=2)
    ]
    due: list[dict[str, int]] = []
    await FallingEdge(dut.clk_i)
    for cycle in range(II * len(cases) + LATENCY):
        if cycle >= LATENCY:
            arrived = (cycle - LATENCY) % II == 0 and (cycle - LATENCY) // II < len(cases)
            assert dut.valid_o.value == int(arrived)
            if arrived:
                for port, value in due[(cycle - LATENCY) // II].items():
                    found = int(getattr(dut, port).value)
                    assert found == value, f"{port} of {cases[(cycle - LATENCY) // II]}: {found}, not {value}"
        send = cycle % II == 0 and cycle // II < len(cases)
        dut.valid_i.value = int(send)
        if send:
            number = cycle // II
            state, action, first, hold = cases[number]
            drawn = [int(d) for d in draws[number % len(draws)]]
            # Each case once in a while meets an edge of the draws' range, too.
            if number % 2:
                drawn[-1] = EDGE_DRAWS[number // 2 % len(EDGE_DRAWS)]
            dut.state_i.value, dut.action_i.value = state, action
            dut.first_i.value, dut.hold_i.value = int(first), int(hold)
            dut.rng_i.value = sum(d << (32 * i) for i, d in enumerate(drawn))
            due.append(golden(state, action, first, hold, tuple(drawn[:DRAWS])))
        await FallingEdge(dut.clk_i)
