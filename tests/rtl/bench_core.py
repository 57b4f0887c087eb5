"""A core against its golden functions.

Every state word, reachable or not, with every action, started or not and held or not, if these are few
enough; as many of them by chance if not.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from bench import each_variant, spec_of, start
from cases import all_cases, edge_draws, golden, join
from cocotb.triggers import FallingEdge


@each_variant()
async def every_case_equals_the_golden_step(dut: Any, given: Any) -> None:
    await start(dut, valid_i=0, first_i=0, hold_i=0, state_i=0, action_i=0, rng_i=0)
    spec = spec_of(given.env, given.options)
    generator = np.random.default_rng(13)
    states, actions, first, hold = all_cases(spec, given.limit, generator)
    count = len(states)
    draws = generator.integers(
        1 << 32, size=(count, max(1, spec.reset_draws + spec.step_draws)), dtype=np.uint32
    )
    # In about half of the cases the last draw is an edge, in some the first.
    edges = np.array(edge_draws(spec), np.uint32)
    for column, share in ((-1, 0.5), (0, 0.2)):
        chosen = generator.random(count) < share
        draws[chosen, column] = generator.choice(edges, np.count_nonzero(chosen))
    due = golden(spec, states, actions, first, hold, draws)
    random_words = [sum(d << (32 * i) for i, d in enumerate(row)) for row in draws.tolist()]
    action_words = join(actions.T, (spec.action,) * spec.agents, count)
    inputs = list(zip(states, action_words, first.tolist(), hold.tolist(), random_words, strict=True))
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
            state, action, first_i, hold_i, rng_i = inputs[number]
            dut.state_i.value, dut.action_i.value = state, action
            dut.first_i.value, dut.hold_i.value = int(first_i), int(hold_i)
            dut.rng_i.value = rng_i
        await FallingEdge(dut.clk_i)
