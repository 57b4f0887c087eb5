"""Proofs that cores do what the graphs of golden functions say, for all words."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Set
from pathlib import Path

import pytest

from pearl_marl.compiler import core_graph as core_graphs
from pearl_marl.compiler import joining, lowering, scheduling, verilog
from pearl_marl.compiler.targets import Target
from pearl_marl.compiler.widths import width
from pearl_marl.envs import get_spec, names
from pearl_marl.golden.tracing.graph import Graph
from pearl_marl.golden.tracing.nodes import Node
from pearl_marl.spec import EnvSpec

from ..rtl.random_steps import random_spec
from ..rtl.wide_steps import FIXED, wide_spec
from ..sampling import sampled
from .proofs.passes import unequal, unequal_outputs
from .proofs.texts import unproved_signals

TARGETS = [Target("xc7", 150), Target("ecp5", 300), Target("gowin", 40)]
ENVIRONMENTS = sampled(names(), ("Blackjack", "CartPole", "CoinGame", "ConnectFour", "FrozenLake", "Taxi"))
"""Cores of all kinds: products and none, tables, draws, several agents."""
OPEN_LOWERING = {("Blackjack", "ecp5"), *(("RobotWarehouse", target.name) for target in TARGETS)}
"""Two products of a number of 60 bits, which is put together of two draws; a word of the requested racks."""
OPEN_GATING = {
    "Pendulum": {"obs_o.cosine", "obs_o.sine"},
    "RobotWarehouse": {
        *(f"obs_o.cell_{cell}_asked" for cell in range(9)),
        *("reward_o.reward_0", "reward_o.reward_1", "state_o.request_0", "state_o.request_1"),
    },
}
"""Products, of which nothing is known; and what follows from a new request, on which z3 gives up."""


def unproved_text(spec: EnvSpec, target: Target, folder: Path) -> Iterator[str]:
    graph, outputs = core_graphs.core_graph(spec)
    outputs = lowering.lowered(graph, outputs, target)
    schedule = scheduling.scheduled(outputs, target)
    path = folder / "core_pe.sv"
    path.write_text(verilog.system_verilog(spec, "core", outputs, schedule))
    return unproved_signals(path, "core_pe", spec, outputs, schedule)


def unproved_lowering(spec: EnvSpec, targets: Iterable[Target]) -> Iterator[Node]:
    graph, outputs = core_graphs.core_graph(spec)
    nodes = [output.node for output in outputs]
    for joined in (joining.digits_joined, joining.rounding_joined):
        made = joined(graph, nodes)
        yield from unequal(nodes, made)
        nodes = [made[node] for node in nodes]
    for target in targets:
        result = lowering.Lowering(nodes, [output.bits for output in outputs], target)
        widths = {node: width(node, result.used) for node in result.made}
        yield from unequal(nodes, result.made, widths)
        yield from (n for n, o in zip(nodes, outputs, strict=True) if widths[n] < min(n.bits, o.bits))


def unproved_gating(spec: EnvSpec, but: Set[str] = frozenset()) -> set[str]:
    gated = core_graphs.core_graph(spec).outputs
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(core_graphs, "held", chosen)
        plain = core_graphs.core_graph(spec).outputs
    return {name for hold in (False, True) for name in unequal_outputs(plain, gated, hold, but)}


def chosen(
    graph: Graph, hold: Node, start: list[Node], moved: list[Node], unseen: list[Node]
) -> tuple[list[Node], list[Node]]:
    """Hold by choosing at the end, which gating spares."""
    return [graph.choose(hold, old, new) for old, new in zip(start, moved, strict=True)], unseen


@pytest.mark.parametrize("env", ENVIRONMENTS)
def test_gating_holds_and_changes_nothing_else(env: str) -> None:
    assert not unproved_gating(get_spec(env), OPEN_GATING.get(env, set()))


@pytest.mark.parametrize("env", ENVIRONMENTS)
def test_lowering_changes_nothing(env: str) -> None:
    targets = [target for target in TARGETS if (env, target.name) not in OPEN_LOWERING]
    assert not list(unproved_lowering(get_spec(env), targets))


@pytest.mark.exhaustive  # Yosys is WebAssembly, which takes a minute to compile before it first runs
@pytest.mark.parametrize("target", TARGETS, ids=str)
@pytest.mark.parametrize("env", ENVIRONMENTS)
def test_texts_of_environments(env: str, target: Target, tmp_path: Path) -> None:
    assert not list(unproved_text(get_spec(env), target, tmp_path))


@pytest.mark.parametrize("seed", sampled([0, 2, 5, 7, 9, 10, 14, 16], (0, 5, 9, 14)))
def test_random_golden_functions(seed: int) -> None:
    """Of seeds whose words z3 finds out about: it gives up on remainders of 29 bits, for example."""
    spec = random_spec(seed)
    assert not unproved_gating(spec)
    assert not list(unproved_lowering(spec, TARGETS))


@pytest.mark.exhaustive  # see above
@pytest.mark.parametrize("seed", [0, 2, 5, 7, 9, 10, 14, 16])
def test_texts_of_random_golden_functions(seed: int, tmp_path: Path) -> None:
    assert not list(unproved_text(random_spec(seed), TARGETS[seed % len(TARGETS)], tmp_path))


@pytest.mark.exhaustive  # see above
@pytest.mark.parametrize("number", range(len(FIXED)))
def test_texts_of_wide_words(number: int, tmp_path: Path) -> None:
    """That tables are read within them, whatever the sign of a word, among others."""
    for target in (Target("xc7", 187.5), Target("ecp5", 150)):
        assert not list(unproved_text(wide_spec(number), target, tmp_path))
