"""pearl_choice against IntegerNetwork.choose: the greatest, and draws, with masks."""

from __future__ import annotations

from typing import Any

import numpy as np
from bench import each_variant, start
from bench_network import packed
from cocotb.triggers import FallingEdge, ReadOnly
from random_policies import as_greatest, random_table

from pearl_marl.envs import get_spec

DRAW_LATENCY = 11
ENVIRONMENTS = {2: "Blackjack", 4: "CliffWalking", 6: "Taxi"}
"""Some with so many actions."""


@each_variant(drawn=[False, True])
async def actions_equal_the_policy(dut: Any, given: Any, drawn: bool) -> None:
    names = ("drawn_i", "shift_i", "table_we_i", "table_addr_i", "table_wdata_i")
    await start(dut, **dict.fromkeys((*names, "valid_i", "logits_i", "allowed_i", "draws_i"), 0))
    if drawn and not given.drawn:
        return
    random = np.random.default_rng(23)
    spec = get_spec(ENVIRONMENTS[given.actions])
    bits = (given.actions - 1).bit_length()
    n = 300
    for spread in (given.bits, min(given.bits, 10), 2):
        edge = 1 << spread - 1
        logits = random.integers(-edge, edge, (n, given.rows, given.actions))
        allowed = random.random((n, given.rows, given.actions)) < 0.7
        draws = random.integers(0, 1 << 32, (n, given.rows), dtype=np.uint32)
        draws[:3] = np.array([0, 1, (1 << 32) - 1], np.uint32)[:, None]
        policy = random_table(random, spec, spread, drawn=True)
        if not drawn:
            policy = as_greatest(policy)
        wanted = _choices(policy, logits, allowed, draws)
        await FallingEdge(dut.clk_i)
        dut.drawn_i.value, dut.shift_i.value = int(drawn), policy.head.shift
        dut.table_we_i.value = 1
        for index, weight in enumerate(policy.head.weights):
            dut.table_addr_i.value, dut.table_wdata_i.value = index, int(weight)
            await FallingEdge(dut.clk_i)
        dut.table_we_i.value = 0
        sent, came, cycle = 0, 0, 0
        late: list[int | None] = [None] * DRAW_LATENCY
        while came < n:
            assert cycle < 10 * n
            valid = sent < n and random.random() < 0.8
            dut.valid_i.value = int(valid)
            late.append(packed(draws[sent], 32) if valid else None)
            dut.draws_i.value = late.pop(0) or 0
            if valid:
                dut.logits_i.value = packed(logits[sent], given.bits)
                dut.allowed_i.value = packed(allowed[sent], 1)
                sent += 1
            await ReadOnly()
            if dut.valid_o.value == 1:
                assert int(dut.actions_o.value) == packed(wanted[came], bits), f"group {came}, {spread} bits"
                came += 1
            cycle += 1
            await FallingEdge(dut.clk_i)


def _choices(policy: Any, logits: Any, allowed: Any, draws: Any) -> Any:
    n, rows, actions = logits.shape
    object.__setattr__(
        policy, "inputs", policy.inputs._replace(table=logits.reshape(-1, actions).astype(np.int32))
    )
    # The last element of what is observed is the number of its row.
    numbers = np.arange(n * rows)
    observed = np.zeros((n * rows, len(policy.spec.observation)), np.int64)
    observed[:, -1] = numbers
    masks = allowed.reshape(-1, actions).astype(np.int8)
    return policy.choose(observed, 0 * numbers, masks, draws.reshape(-1, 1)).words.reshape(n, rows)
