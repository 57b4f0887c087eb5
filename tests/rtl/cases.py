"""What cores and graphs of them are given, and what the golden functions make of it."""

from __future__ import annotations

import itertools
import math
from typing import Any

import numpy as np

from pearl_marl.compiler.core_graph import core_graph
from pearl_marl.golden import call_reference
from pearl_marl.golden.tracing.nodes import Node
from pearl_marl.spec import TERMINATED, EnvSpec, Field
from pearl_marl.spec.elements import bounds


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
    drawn = call_reference(spec.positional.initial, words[: spec.reset_draws])
    origin = [
        # Of one type, since NumPy makes floats of uint64 beside int64.
        np.where(first, np.asarray(new).astype(field.dtype), old)
        for new, old, field in zip(drawn, split(states, spec.state), spec.state, strict=True)
    ]
    act = actions.astype(spec.action_dtype).T
    results = call_reference(spec.positional.step, [*origin, *act, *words[spec.reset_draws :]])
    moved, outcome = results[: len(spec.state)], results[len(spec.state) :]
    rewards, ends = outcome[: spec.agents], outcome[spec.agents :]
    after = [
        np.where(hold, old, np.asarray(new).astype(field.dtype))
        for old, new, field in zip(origin, moved, spec.state, strict=True)
    ]
    views = [(view, agent) for agent in spec.views for view in spec.functions[2:]]
    observed = [word for view, agent in views for word in call_reference(view, after, *agent)]
    return {
        "state_o": join(after, spec.state, n),
        "obs_o": join(observed, spec.agent_fields * spec.agents, n),
        "reward_o": join(rewards, (spec.reward,) * spec.agents, n),
        "terminated_o": join(ends, (TERMINATED,) * spec.agents, n),
    }


def all_cases(
    spec: EnvSpec, limit: int, generator: np.random.Generator
) -> tuple[list[int], np.ndarray, np.ndarray, np.ndarray]:
    """Return states, actions, ``first`` and ``hold`` of every case, or of as many as the limit allows.

    Actions have a column for each field of each agent of a slot.
    """
    scales = [2**f.fraction for f in spec.action_fields]
    least, most = (
        spec.agents * np.round(np.atleast_1d(end) * scales).astype(np.int64).tolist()
        for end in bounds(spec.action_space)
    )
    ranges = [range(low, high + 1) for low, high in zip(least, most, strict=True)]
    words = [range(low, high + 1) for low, high in (f.range for f in spec.state)]
    if math.prod(each.stop - each.start for each in words + ranges) * 4 <= limit:
        flags = (False, True)
        cases = itertools.product(itertools.product(*words), itertools.product(*ranges), flags, flags)
        states, *rest = zip(*cases, strict=True)
        columns = zip(*states, strict=True)
        return (join(columns, spec.state, len(states)), *map(np.array, rest))
    columns = [generator.integers(*f.range, limit, f.dtype, endpoint=True) for f in spec.state]
    states = join(columns, spec.state, limit)
    first, hold = generator.random((2, limit)) < 0.25
    return states, generator.integers(least, most, (limit, len(least)), endpoint=True), first, hold


def edge_draws(spec: EnvSpec) -> list[int]:
    """Return draws at which something may change: thirds, ends, and what the graph of the core shows.

    There a draw, or the rest or quotient of its product with a small number, is compared with constants.
    """
    values = {0, 0x55555555, 0x55555556, 0xAAAAAAAA, 0xAAAAAAAB, 0xFFFFFFFF, 0x12345678}
    factors, thresholds = {1}, {0}
    waiting, seen = [output.node for output in core_graph(spec).outputs], set[Node]()
    while waiting:
        node = waiting.pop()
        if node in seen:
            continue
        seen.add(node)
        waiting += node.args
        constants = {arg.imm for arg in node.args if arg.op == "constant"}
        if node.op == "less":
            thresholds |= {value + above for value in constants for above in (0, 1)}
        elif node.op == "mul" and any(str(arg.imm).startswith("rng_i") for arg in node.args):
            factors |= {factor for factor in constants if 0 < factor <= 16}
    for factor, threshold in itertools.product(factors, thresholds):
        firsts = (-(-(whole + threshold) // factor) for whole in range(0, factor << 32, 1 << 32))
        values |= {draw for first in firsts for draw in (first - 1, first) if 0 <= draw < 1 << 32}
    return sorted(values)


PORTS = "state_i", "action_i", "first_i", "hold_i", "rng_i"


def random_cases(spec: EnvSpec, limit: int) -> tuple[dict[str, list[int]], dict[str, list[int]]]:
    """Return the inputs of a core, by port, and its outputs: as many cases as the limit allows."""
    generator = np.random.default_rng(13)
    states, actions, first, hold = all_cases(spec, limit, generator)
    count = len(states)
    draws = generator.integers(
        1 << 32, size=(count, max(1, spec.reset_draws + spec.step_draws)), dtype=np.uint32
    )
    # In about half of the cases the last draw is an edge, in some the first.
    edges = np.array(edge_draws(spec), np.uint32)
    for column, share in ((-1, 0.5), (0, 0.2)):
        chosen = generator.random(count) < share
        draws[chosen, column] = generator.choice(edges, np.count_nonzero(chosen))
    drawn = [sum(d << (32 * i) for i, d in enumerate(row)) for row in draws.tolist()]
    acted = join(actions.T, spec.agents * spec.action_fields, count)
    flags = [[int(flag) for flag in row] for row in (first, hold)]
    return (
        dict(zip(PORTS, (states, acted, *flags, drawn), strict=True)),
        golden(spec, states, actions, first, hold, draws),
    )
