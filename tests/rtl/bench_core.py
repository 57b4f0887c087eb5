"""A core against its golden functions.

Every state that fits its fields, reachable or not, with every action, started or not and held or not, if
these are few enough; as many of them by chance if not.
"""

from __future__ import annotations

from typing import Any

from bench import each_variant, spec_of, start
from cases import PORTS, random_cases
from cocotb.triggers import FallingEdge


@each_variant()
async def every_case_equals_the_golden_step(dut: Any, given: Any) -> None:
    await start(dut, valid_i=0, first_i=0, hold_i=0, state_i=0, action_i=0, rng_i=0)
    spec = spec_of(given.env, given.options)
    cases, due = random_cases(spec, given.limit)
    hold, count = cases["hold_i"], len(cases["hold_i"])
    inputs = list(zip(*(cases[port] for port in PORTS), strict=True))
    await FallingEdge(dut.clk_i)
    for cycle in range(given.ii * count + given.latency):
        number, phase = divmod(cycle - given.latency, given.ii)
        if cycle >= given.latency:
            arrived = phase == 0 and number < count
            assert dut.valid_o.value == int(arrived)
            if arrived:
                # The backbone masks reward and end of a slot that is held.
                for port in ("state_o", "obs_o") if hold[number] else due:
                    found, expected = int(getattr(dut, port).value), due[port][number]
                    assert found == expected, f"{port} of {inputs[number]}: {found}, not {expected}"
        number, phase = divmod(cycle, given.ii)
        send = phase == 0 and number < count
        dut.valid_i.value = int(send)
        if send:
            for port, word in zip(PORTS, inputs[number], strict=True):
                getattr(dut, port).value = word
        await FallingEdge(dut.clk_i)
