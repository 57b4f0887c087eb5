"""Generated cores: their graphs, as traced and as lowered, mean what the golden functions do."""

from __future__ import annotations

import random
from collections.abc import Iterable

import numpy as np
import pytest
from cases import all_cases, edge_draws, golden, golden_one, split
from hypothesis import given, note, settings
from hypothesis import strategies as st
from random_steps import plain, random_spec
from test_modules import CORES, OPTIONS

from pearl_marl.compiler.core_graph import Output, core_graph
from pearl_marl.compiler.lowering import lowered
from pearl_marl.compiler.nodes import values
from pearl_marl.compiler.scheduling import scheduled
from pearl_marl.compiler.targets import FAMILIES, Target
from pearl_marl.compiler.widths import width
from pearl_marl.registry import get_spec
from pearl_marl.spec import EnvSpec, Golden

TARGETS = [Target(name, mhz) for name in FAMILIES for mhz in (40, 150, 300)]


def assert_means(
    spec: EnvSpec, outputs: Iterable[Output], count: int, functions: Golden | None = None
) -> None:
    """Compare the outputs of a graph with the golden functions, in cases of all kinds."""
    outputs, generator = list(outputs), np.random.default_rng(3)
    states, actions, first, hold = all_cases(spec, count, generator)
    shape = len(states), max(1, spec.reset_draws + spec.step_draws)
    draws = generator.integers(1 << 32, size=shape, dtype=np.uint32)
    edged = generator.random(shape) < 0.3
    draws[edged] = generator.choice(np.array(edge_draws(spec), np.uint32), np.count_nonzero(edged))
    due = {} if functions else golden(spec, states, actions, first, hold, draws)
    columns = [column.tolist() for column in split(states, spec.state)]
    for i in generator.permutation(len(states))[:count]:
        inputs = {"first_i": int(first[i]), "hold_i": int(hold[i]), "action_i": int(actions[i])}
        inputs |= {f"state_i.{f.name}": c[i] for f, c in zip(spec.state, columns, strict=True)}
        inputs |= {f"rng_i[{k}]": int(draw) for k, draw in enumerate(draws[i])}
        found = values([output.node for output in outputs], inputs)
        for node, value in found.items():
            assert node.low <= value <= node.high, node
            assert node.low < 0 or value & ~node.ones == 0, node
        if functions:
            case = [c[i] for c in columns], int(actions[i]), bool(first[i]), bool(hold[i]), draws[i].tolist()
            wanted = golden_one(spec, functions, *case)
        else:
            wanted = {port: words[i] for port, words in due.items()}
        words = dict.fromkeys(wanted, 0)
        for output in outputs:
            words[output.port] |= (found[output.node] & ((1 << output.bits) - 1)) << output.offset
        for port in ("state_o", "obs_o") if hold[i] else wanted:
            assert words[port] == wanted[port], f"{port} of {inputs}"


@pytest.mark.parametrize(("env", "number"), [core for core in CORES if core[0] != "ShiftAdd"])
def test_graphs_mean_the_golden_functions(env: str, number: int) -> None:
    spec = get_spec(env).with_options(**OPTIONS[env][number])
    graph, outputs = core_graph(spec)
    assert_means(spec, outputs, 60)
    for target in (Target("ecp5", 150), Target("xc7", 250)):
        assert_means(spec, lowered(graph, outputs, target), 30)


@settings(max_examples=60, deadline=None)
@given(st.randoms(use_true_random=False))
def test_random_golden_functions(chance: random.Random) -> None:
    spec = random_spec(chance)
    note(f"{spec.state}\n{spec.summary}")
    graph, outputs = core_graph(spec)
    assert_means(spec, outputs, 40, plain(spec))
    for target in chance.sample(TARGETS, 2):
        assert_means(spec, lowered(graph, outputs, target), 20, plain(spec))


@pytest.mark.parametrize("target", TARGETS, ids=str)
@pytest.mark.parametrize("env", ["Taxi", "MountainCar"])
def test_stages_are_in_order_and_short_enough(env: str, target: Target) -> None:
    graph, outputs = core_graph(get_spec(env))
    schedule = scheduled(lowered(graph, outputs, target), target)
    alone = max(target.delay(n, width(n, schedule.used)) for n in schedule.order)
    assert schedule.longest <= max(target.budget, alone) + 1e-9
    for node in schedule.order:
        assert 0 <= schedule.stage[node] <= schedule.last[node] <= schedule.latency
        for arg in node.args:
            if arg in schedule.stage:
                assert schedule.stage[arg] <= schedule.stage[node] <= schedule.last[arg]
