"""Proofs that cores do what the graphs of golden functions say, for all words."""

from __future__ import annotations

from pathlib import Path

import pytest

from pearl_marl.compiler import core_graph as core_graphs
from pearl_marl.compiler.core_graph import core_graph
from pearl_marl.compiler.lowering import Lowering, digits_joined, lowered, rounding_joined
from pearl_marl.compiler.scheduling import scheduled
from pearl_marl.compiler.targets import Target
from pearl_marl.compiler.verilog import system_verilog
from pearl_marl.compiler.widths import width
from pearl_marl.registry import get_spec, names
from pearl_marl.spec import EnvSpec
from pearl_marl.tracing.graph import Graph
from pearl_marl.tracing.nodes import Node

from ..rtl.random_steps import random_spec
from .proofs.passes import unequal, unequal_outputs
from .proofs.texts import unproved_signals

TARGETS = [Target("xc7", 150), Target("ecp5", 300), Target("gowin", 40)]
OPEN_LOWERING = {("Blackjack", "ecp5")}
"""Two products of a number of 60 bits, which is put together of two draws."""
OPEN_GATING = {"Pendulum": {"obs_o.cosine", "obs_o.sine"}}
"""They are products, of which nothing is taken to be known."""


def unproved_text(spec: EnvSpec, target: Target, folder: Path) -> list[str]:
    graph, outputs = core_graph(spec)
    outputs = lowered(graph, outputs, target)
    schedule = scheduled(outputs, target)
    path = folder / "core_pe.sv"
    path.write_text(system_verilog(spec, "core", outputs, schedule))
    return unproved_signals(path, "core_pe", spec, outputs, schedule)


def chosen(
    graph: Graph, hold: Node, start: list[Node], moved: list[Node], unseen: list[Node]
) -> tuple[list[Node], list[Node]]:
    """Hold by choosing at the end, which gating spares."""
    return [graph.choose(hold, old, new) for old, new in zip(start, moved, strict=True)], unseen


@pytest.mark.parametrize("env", names())
def test_gating_holds_and_changes_nothing_else(env: str, monkeypatch: pytest.MonkeyPatch) -> None:
    spec = get_spec(env)
    gated = core_graph(spec).outputs
    monkeypatch.setattr(core_graphs, "held", chosen)
    plain = core_graph(spec).outputs
    for hold in (False, True):
        assert set(unequal_outputs(plain, gated, hold)) <= OPEN_GATING.get(env, set())


@pytest.mark.parametrize("env", names())
def test_lowering_changes_nothing(env: str) -> None:
    graph, outputs = core_graph(get_spec(env))
    nodes = [output.node for output in outputs]
    for joined in (digits_joined, rounding_joined):
        made = joined(graph, nodes)
        assert not unequal(nodes, made)
        nodes = [made[node] for node in nodes]
    for target in TARGETS:
        if (env, target.name) not in OPEN_LOWERING:
            lowering = Lowering(nodes, [output.bits for output in outputs], target)
            widths = {node: width(node, lowering.used) for node in lowering.made}
            assert not unequal(nodes, lowering.made, widths), target


CASES = [(env, TARGETS[k]) for i, env in enumerate(names()) for k in (0, 1 + i % 2)]
"""As simulated devices have them, and for another family."""


@pytest.mark.parametrize(("env", "target"), CASES, ids=str)
def test_texts_of_environments(env: str, target: Target, tmp_path: Path) -> None:
    assert not unproved_text(get_spec(env), target, tmp_path)


@pytest.mark.parametrize("seed", range(6))
def test_texts_of_random_golden_functions(seed: int, tmp_path: Path) -> None:
    assert not unproved_text(random_spec(seed), TARGETS[seed % len(TARGETS)], tmp_path)
