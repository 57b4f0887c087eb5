"""Generated cores: their graphs, as traced and as lowered, and their text do what golden functions do."""

from __future__ import annotations

import json
import random
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bench import spec_of
from cases import all_cases, edge_draws, golden, split
from harness import Design, Variant, run_variants
from hypothesis import given, note, settings
from hypothesis import strategies as st
from random_steps import random_spec
from test_modules import CORES, OPTIONS

from pearl_marl.compiler.core_graph import Output, core_graph
from pearl_marl.compiler.cores import generated_core
from pearl_marl.compiler.lowering import lowered
from pearl_marl.compiler.nodes import values
from pearl_marl.compiler.scheduling import scheduled
from pearl_marl.compiler.targets import FAMILIES, Target
from pearl_marl.compiler.widths import width
from pearl_marl.hardware import toolchain
from pearl_marl.registry import get_spec
from pearl_marl.spec import EnvSpec

TARGETS = [Target(name, mhz) for name in FAMILIES for mhz in (40, 150, 300)]


def assert_means(spec: EnvSpec, outputs: Iterable[Output], count: int) -> None:
    """Compare the outputs of a graph with the golden functions, in cases of all kinds."""
    outputs, generator = list(outputs), np.random.default_rng(3)
    states, actions, first, hold = all_cases(spec, count, generator)
    shape = len(states), max(1, spec.reset_draws + spec.step_draws)
    draws = generator.integers(1 << 32, size=shape, dtype=np.uint32)
    edged = generator.random(shape) < 0.3
    draws[edged] = generator.choice(np.array(edge_draws(spec), np.uint32), np.count_nonzero(edged))
    due = golden(spec, states, actions, first, hold, draws)
    columns = [column.tolist() for column in split(states, spec.state)]
    for i in generator.permutation(len(states))[:count]:
        inputs = {"first_i": int(first[i]), "hold_i": int(hold[i]), "action_i": int(actions[i])}
        inputs |= {f"state_i.{f.name}": c[i] for f, c in zip(spec.state, columns, strict=True)}
        inputs |= {f"rng_i[{k}]": int(draw) for k, draw in enumerate(draws[i])}
        found = values([output.node for output in outputs], inputs)
        for node, value in found.items():
            assert node.low <= value <= node.high, node
            assert node.low < 0 or value & ~node.ones == 0, node
        words = dict.fromkeys(due, 0)
        for output in outputs:
            words[output.port] |= (found[output.node] & ((1 << output.bits) - 1)) << output.offset
        for port in ("state_o", "obs_o") if hold[i] else due:
            assert words[port] == due[port][i], f"{port} of {inputs}"


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
    assert_means(spec, outputs, 40)
    for target in chance.sample(TARGETS, 2):
        assert_means(spec, lowered(graph, outputs, target), 20)


SIMULATED: list[tuple[str, dict[str, Any], Target]] = [
    ("CliffWalking", {"is_slippery": True}, Target("ecp5", 300)),
    ("FrozenLake", {"map_name": "8x8"}, Target("ecp5", 150)),
    ("Taxi", {"fickle_passenger": True, "is_rainy": True}, Target("xc7", 200)),
    ("Blackjack", {}, Target("gowin", 100)),
    ("MountainCar", {}, Target("xc7", 150)),
    ("Pendulum", {}, Target("ecp5", 150)),
    ("CartPole", {}, Target("xc7", 100)),
    ("Seaquest", {}, Target("ecp5", 125)),
    *(("Random", {"seed": seed}, TARGETS[seed % len(TARGETS)]) for seed in range(24)),
]


@pytest.mark.parametrize("number", range(len(SIMULATED)), ids=[f"{row[0]}-{row[2]}" for row in SIMULATED])
def test_generated_cores_do_the_golden_step(number: int, once: Any) -> None:
    """All of them side by side in one simulation, on the bench of the cores written by hand."""

    def simulate(folder: Path) -> None:
        variants = []
        for i, (env, options, target) in enumerate(SIMULATED):
            core = generated_core(spec_of(env, options), target, f"core_{i}")
            path = folder / f"core_{i}_pe.sv"
            path.write_text(core.text)
            case = {"env": env, "options": options, "latency": core.latency, "ii": 1, "limit": 3_000}
            variants.append(Variant(env, Design(path.stem, (path,)), case))
        (folder / "logs.json").write_text(json.dumps(run_variants(variants, "bench_core", folder)))

    log = json.loads((once("rtl-generated", simulate) / "logs.json").read_text())[number]
    assert not log, log


def test_generated_text_is_clean(tmp_path: Path) -> None:
    for env, options, target in SIMULATED:
        path = tmp_path / "core_pe.sv"
        path.write_text(generated_core(spec_of(env, options), target, "core").text)
        # Of the package, the backbone uses what the core itself does not.
        arguments = ["--lint-only", "-Wall", "-Wno-UNUSEDPARAM", "--top-module", "core_pe"]
        toolchain.run(["verilator", *arguments, str(path)])


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
