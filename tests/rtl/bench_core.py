"""A core against its golden functions.

Every state word, reachable or not, with every action, started or not and held or not, if these are few
enough; as many of them by chance if not.
"""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
from bench import each_variant, spec_of, start
from cocotb.triggers import FallingEdge
from gymnasium.spaces import Box

from pearl_marl.golden import call_reference
from pearl_marl.spec import EnvSpec, Field, word_bits


def split(words: list[int], fields: tuple[Field, ...]) -> list[np.ndarray]:
    """Return an array a field of many words."""
    columns, offset = [], 0
    for field in fields:
        pieces = np.array([(word >> offset) & ((1 << field.bits) - 1) for word in words], np.uint64)
        if field.signed:  # the sign goes up to the top and comes back down
            spare = np.uint64(64 - field.bits)
            pieces = (pieces << spare).view(np.int64) >> spare.astype(np.int64)
        columns.append(pieces.astype(field.dtype))
        offset += field.bits
    return columns


def join(columns: Any, fields: tuple[Field, ...], count: int) -> list[int]:
    """Return many words, made of an array (or a constant) a field."""
    words, offset = [0] * count, 0
    for column, field in zip(columns, fields, strict=True):
        pieces = np.broadcast_to(np.asarray(column), count).tolist()
        words = [
            word | (piece & ((1 << field.bits) - 1)) << offset
            for word, piece in zip(words, pieces, strict=True)
        ]
        offset += field.bits
    return words


def golden(
    spec: EnvSpec,
    states: list[int],
    actions: np.ndarray,
    first: np.ndarray,
    hold: np.ndarray,
    draws: np.ndarray,
) -> dict[str, list[int]]:
    """Return what every case has to give, by port."""
    n = len(states)
    words = [np.ascontiguousarray(draws[:, d]) for d in range(spec.reset_draws + spec.step_draws)]
    drawn = call_reference(spec.golden.initial, words[: spec.reset_draws])
    origin = [
        np.where(first, new, old).astype(field.dtype)
        for new, old, field in zip(drawn, split(states, spec.state), spec.state, strict=True)
    ]
    act = actions.astype(spec.action.dtype)
    *moved, reward, terminated = call_reference(spec.golden.step, [*origin, act, *words[spec.reset_draws :]])
    after = [
        np.where(hold, old, new).astype(field.dtype)
        for old, new, field in zip(origin, moved, spec.state, strict=True)
    ]
    observed = call_reference(spec.golden.observe, after)
    return {
        "state_o": join(after, spec.state, n),
        "obs_o": join(observed, spec.observation, n),
        "reward_o": join([reward], (spec.reward,), n),
        "terminated_o": join([terminated], (Field("terminated", 1),), n),
    }


def all_cases(
    spec: EnvSpec, limit: int, generator: np.random.Generator
) -> tuple[list[int], np.ndarray, np.ndarray, np.ndarray]:
    """Return states, actions, ``first`` and ``hold`` of every case, or of as many as the limit allows."""
    bits, space = word_bits(spec.state), spec.action_space
    if isinstance(space, Box):
        scale = 2**spec.action.fraction
        least, most = (round(float(bound[0]) * scale) for bound in (space.low, space.high))
    else:
        least, most = 0, int(space.n) - 1
    if (most - least + 1) * 4 << bits <= limit:
        flags = (False, True)
        cases = itertools.product(range(1 << bits), range(least, most + 1), flags, flags)
        states, *rest = zip(*cases, strict=True)
        return (list(states), *map(np.array, rest))
    states = [int.from_bytes(generator.bytes(-(-bits // 8))) >> -bits % 8 for _ in range(limit)]
    first, hold = generator.random((2, limit)) < 0.25
    return states, generator.integers(least, most, size=limit, endpoint=True), first, hold


def edge_draws(spec: EnvSpec) -> list[int]:
    """Return draws at which something may change: thirds, ends, and the core's own thresholds."""
    values = {0, 0x55555555, 0x55555556, 0xAAAAAAAA, 0xAAAAAAAB, 0xFFFFFFFF, 0x12345678}
    for threshold in (spec.core_parameters or {}).values():
        values |= {value for value in range(threshold - 1, threshold + 2) if 0 <= value < 1 << 32}
    return sorted(values)


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
    action_words = join([actions], (spec.action,), count)
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
