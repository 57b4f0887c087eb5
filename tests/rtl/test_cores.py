"""Cores do what golden functions do: graphs of generated ones, as traced and as lowered, and their text."""

from __future__ import annotations

import json
import random
from collections.abc import Callable, Iterable
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
import scipy.optimize
from bench import spec_of
from cases import all_cases, edge_draws, golden, split
from gymnasium.spaces import Discrete, MultiBinary
from harness import Design, Variant, core, run_variants
from hypothesis import assume, given, note, settings
from hypothesis import strategies as st
from linters import lint
from random_steps import random_spec

from pearl_marl.compiler.core_graph import Output, action_ports, core_graph
from pearl_marl.compiler.cores import generated_core
from pearl_marl.compiler.lowering import lowered
from pearl_marl.compiler.scheduling import scheduled
from pearl_marl.compiler.targets import FAMILIES, Target
from pearl_marl.compiler.widths import width
from pearl_marl.envs import get_spec
from pearl_marl.errors import ArgumentError
from pearl_marl.golden.tracing.nodes import values
from pearl_marl.hardware import elaboration
from pearl_marl.layout import Array, Range
from pearl_marl.spec import EnvSpec, Golden
from tests import sampling

TARGETS = [Target(name, mhz) for name in FAMILIES for mhz in (40, 150, 300)]

LAKE = {"desc": ["SFHSFGSF", "GHSFFFFH", "FSHFHSFF"]}

OPTIONS: dict[str, list[dict[str, Any]]] = {
    "CliffWalking": [{"is_slippery": False}, {"is_slippery": True}],
    "FrozenLake": [
        {},
        {"map_name": "8x8", "success_rate": 0.8},
        {**LAKE, "is_slippery": False},
        {**LAKE, "success_rate": 0},
    ],
    "CartPole": [{}, {"sutton_barto_reward": True}],
    "Pendulum": [{}, {"g": -3.7}],
    "MountainCar": [{}, {"goal_velocity": 0.01}],
    "Asterix": [{}, {"sticky_action_prob": 0.0, "use_minimal_action_set": False}],
    "Breakout": [{}, {"sticky_action_prob": 0.0, "use_minimal_action_set": False}],
    "Freeway": [{}],
    "Seaquest": [{}, {"sticky_action_prob": 0.9, "difficulty_ramping": False}],
    "SpaceInvaders": [{}, {"difficulty_ramping": False, "use_minimal_action_set": False}],
    "Taxi": [
        {},
        {"fickle_passenger": True, "fickle_probability": 0.5},
        {"fickle_passenger": True, "is_rainy": True},
    ],
    "Blackjack": [{}, {"sab": False, "natural": True}],
    "Catch": [{"rows": 6, "columns": 12}],
    "DeepSea": [{"size": 34}],
    "MemoryChain": [{"num_bits": 40}],
    "MountainCarContinuous": [{"goal_velocity": 0.01}],
}

WORLDS = [("Meadow", {}, elaboration.TARGET), ("Nim", {}, Target("ecp5", 150))]
FIELDS = [
    ("Rover", {}, elaboration.TARGET),
    ("Glider", {}, Target("ecp5", 150)),
    ("Relay", {}, Target("gowin", 40)),
]
"""Actions of several agents, and of several fields."""

LARGE = [
    ("Acrobot", {"book_or_nips": "nips"}, elaboration.TARGET),
    ("Game2048", {"board_size": 3}, Target("ecp5", 150)),
]
"""Cores that take seconds to generate."""

CASES = [(env, options) for env, all_options in OPTIONS.items() for options in all_options]


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
        inputs = {"first_i": int(first[i]), "hold_i": int(hold[i])}
        inputs |= dict(zip(action_ports(spec), actions[i].tolist(), strict=True))
        inputs |= {f"state_i.{f.name}": c[i] for f, c in zip(spec.state, columns, strict=True)}
        inputs |= {f"rng_i[{k}]": int(draw) for k, draw in enumerate(draws[i])}
        found = values([output.node for output in outputs], inputs)
        for node, value in found.items():
            assert node.low <= value <= node.high, node
            assert node.low < 0 or value & ~node.ones == 0, node
        words = dict.fromkeys(due, 0)
        for output in reversed(outputs):
            word = found[output.node] & ((1 << output.bits) - 1)
            words[output.port] = words[output.port] << output.bits | word
        for port in ("state_o", "obs_o") if hold[i] else due:
            assert words[port] == due[port][i], f"{port} of {inputs}"


@pytest.mark.parametrize(
    ("env", "options"),
    [
        *CASES,
        *((name, {}) for name, *_ in WORLDS + FIELDS),
        *(pytest.param(*case, marks=pytest.mark.exhaustive) for *case, _ in LARGE),
    ],
)
def test_graphs_mean_the_golden_functions(env: str, options: dict[str, Any]) -> None:
    spec = spec_of(env, options)
    spec.check_golden(spec.functions)
    graph, outputs = core_graph(spec)
    assert_means(spec, outputs, 60)
    for target in (Target("ecp5", 150), Target("xc7", 250)):
        assert_means(spec, lowered(graph, outputs, target), 30)


@settings(max_examples=30 if sampling.exhaustive else 10)
@given(st.randoms(use_true_random=False), st.sampled_from([{}, {"divided": True}, {"reals": True}]))
def test_random_golden_functions(chance: random.Random, kind: dict[str, bool]) -> None:
    try:
        spec = random_spec(chance, **kind)
    except ArgumentError as error:  # a real may depend on so many words only
        assume("values together" not in str(error))
        raise
    note(f"{spec.state}\n{spec.summary}")
    graph, outputs = core_graph(spec)
    assert_means(spec, outputs, 40)
    for target in chance.sample(TARGETS, 2):
        assert_means(spec, lowered(graph, outputs, target), 20)


class Body(NamedTuple):
    cells: Array[Range[0, 5], 8]
    tail: Range[0, 7]
    length: Range[2, 8]
    food: Range[0, 5]


def grown(state: Body, action: Any, draws: Any) -> tuple[Body, Any, Any]:
    tail = state.tail
    last = state.cells[(tail + state.length - 1) % 8]
    head = min(max(last + (0, 1, 0, -1)[action], 0), 5)
    eats = head == state.food
    if eats and state.length < 8:
        tail = (tail + 1) % 8
    for k in range(8):
        state.cells[(tail + k) % 8] = head
    if eats:
        return state._replace(tail=tail), 0, True
    return state._replace(tail=tail), 0, False


def spread(state: Body) -> Any:
    seen = [0] * 6
    for cell in state.cells:
        seen[cell] = 1
    return seen


def test_what_is_observed_is_in_the_ranges_of_its_fields() -> None:
    """Gates of `hold` make a cell of bits, of which it is not known that they are never 6 or 7."""
    spec = EnvSpec(
        name="Body",
        version=0,
        summary="Cells that index a list",
        rewards=(0.0,),
        observation_space=MultiBinary(6),
        action_space=Discrete(4),
        golden=Golden(Body, lambda draws: Body([0] * 8, 0, 2, 3), grown, spread),
    )
    assert_means(spec, core_graph(spec).outputs, 60)


FIRST = [(env, all_options[0], elaboration.TARGET) for env, all_options in OPTIONS.items()]
OTHERS = [(env, options) for env, options in CASES if options is not OPTIONS[env][0]]
if not sampling.exhaustive:  # a third of them, for all families and clocks
    OTHERS = OTHERS[::3]
ENVIRONMENTS = (
    FIRST + WORLDS + FIELDS + [(*case, TARGETS[i * 4 % len(TARGETS)]) for i, case in enumerate(OTHERS)]
)
"""As simulated devices have them; and with other options, for every family and clock."""

RANDOM: list[tuple[str, dict[str, Any], Target]] = [
    ("Random", {"seed": seed, "divided": 14 <= seed < 20, "reals": seed >= 20}, TARGETS[seed % len(TARGETS)])
    for seed in ((*range(5), *range(17, 22)) if sampling.exhaustive else (0, 17, 21))
]


def check(group: str, make: Callable[[Path], list[Variant]], number: int, once: Any) -> None:
    """Simulate the cores of a group side by side, and look at one."""

    def simulate(folder: Path) -> None:
        (folder / "logs.json").write_text(json.dumps(run_variants(make(folder), "bench_core", folder)))

    log = json.loads((once(f"rtl-cores-{group}", simulate) / "logs.json").read_text())[number]
    assert not log, log


def generated(rows: list[tuple[str, dict[str, Any], Target]], limit: int, folder: Path) -> list[Variant]:
    variants = []
    for i, (env, options, target) in enumerate(rows):
        found = generated_core(spec_of(env, options), target, f"core_{i}")
        path = folder / f"core_{i}_pe.sv"
        path.write_text(found.text)
        case = {"env": env, "options": options, "latency": found.latency, "ii": 1, "limit": limit}
        variants.append(Variant(env, Design(path.stem, (path,)), case))
    return variants


@pytest.mark.parametrize("number", range(len(ENVIRONMENTS)), ids=[f"{e}-{t}" for e, _, t in ENVIRONMENTS])
def test_cores_of_environments(number: int, once: Any) -> None:
    check("environments", partial(generated, ENVIRONMENTS, 700 if sampling.exhaustive else 250), number, once)


@pytest.mark.exhaustive
@pytest.mark.parametrize("number", range(len(LARGE)), ids=[f"{e}-{t}" for e, _, t in LARGE])
def test_large_cores(number: int, once: Any) -> None:
    check("large", partial(generated, LARGE, 700), number, once)


@pytest.mark.parametrize("number", range(len(RANDOM)))
def test_cores_of_random_golden_functions(number: int, once: Any) -> None:
    check("random", partial(generated, RANDOM, 400 if sampling.exhaustive else 150), number, once)


OWN = [{}, {"noise": 0xA6}]


@pytest.mark.parametrize("number", range(len(OWN)))
def test_a_core_of_ones_own(number: int, once: Any) -> None:
    def variants(folder: Path) -> list[Variant]:
        specs = [spec_of("ShiftAdd", options) for options in OWN]
        timing = elaboration.core_timing(specs[0])
        assert timing == (4, 4)
        case = {"env": "ShiftAdd", "latency": timing.latency, "ii": timing.interval, "limit": 3_000}
        rows = zip(specs, OWN, strict=True)
        return [Variant("ShiftAdd", core(spec), {**case, "options": options}) for spec, options in rows]

    check("own", variants, number, once)


def test_generated_text_is_clean(tmp_path: Path) -> None:
    for env, options, target in ENVIRONMENTS[::2] + RANDOM[::3]:
        path = tmp_path / "core_pe.sv"
        path.write_text(generated_core(spec_of(env, options), target, "core").text)
        # Of the package, the backbone uses what the core itself does not.
        lint("core_pe", [path], off=["UNUSEDPARAM"])


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


def test_stages_are_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    """To find those of a core can take seconds."""
    spec, target = get_spec("Blackjack"), Target("xc7", 150)
    first = generated_core(spec, target).text
    monkeypatch.setattr(scipy.optimize, "milp", lambda *_, **__: pytest.fail("they were found again"))
    assert generated_core(spec, target).text == first
    with pytest.raises(pytest.fail.Exception, match="found again"):
        generated_core(spec.with_options(natural=True), Target("gowin", 151))
