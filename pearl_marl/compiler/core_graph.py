"""The graph of an environment's core: what a slot does in a step, from the core's inputs to its outputs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

from pearl_marl.compiler.gating import held
from pearl_marl.golden.tracing.graph import Graph
from pearl_marl.golden.tracing.nodes import Node
from pearl_marl.golden.tracing.trace import trace
from pearl_marl.spec import TERMINATED, EnvSpec, Field, word_bits


class Output(NamedTuple):
    """A field of one of a core's outputs."""

    port: str
    field: str
    offset: int
    bits: int
    node: Node


class CoreGraph(NamedTuple):
    """A graph, and the outputs of a core in it."""

    graph: Graph
    outputs: list[Output]


def core_graph(spec: EnvSpec) -> CoreGraph:
    """Return the graph of an environment's core.

    Inputs are named as the core's ports have them: ``first_i``, ``state_i.row``, ``rng_i[0]``.

    Raises
    ------
    ArgumentError
        The golden functions do what no hardware can; the message names the file and the line.
    """
    graph = Graph()
    first, hold = graph.input("first_i", 1), graph.input("hold_i", 1)
    fields = [graph.input(f"state_i.{f.name}", f.bits, f.signed, *f.range) for f in spec.state]
    words = zip(action_ports(spec), spec.agents * spec.action_fields, strict=True)
    actions = [graph.input(name, f.bits, f.signed, *f.range) for name, f in words]
    draws = [graph.input(f"rng_i[{k}]", 32) for k in range(spec.reset_draws + spec.step_draws)]
    fresh = _narrowed(graph, trace(graph, spec.positional.initial, draws[: spec.reset_draws]), spec.state)
    start = [graph.choose(first, new, old) for new, old in zip(fresh, fields, strict=True)]
    for node, field in zip(start, spec.state, strict=True):
        if node.op not in ("input", "constant"):
            node.name = field.name
        graph.free(node)  # what the step does is seen by values of fields, not of inputs
    results = trace(graph, spec.positional.step, [*start, *actions, *draws[spec.reset_draws :]])
    rewards, ends = spec.each_agent(spec.reward), spec.each_agent(TERMINATED)
    results = _narrowed(graph, results, [*spec.state, *rewards, *ends])
    moved, unseen = results[: len(fields)], results[len(fields) :]
    after, unseen = held(graph, hold, start, moved, unseen)
    after = _narrowed(graph, after, spec.state)
    for node, field in zip(after, spec.state, strict=True):
        graph.within(node, *field.range)  # which gates of bits no longer show
        if node.name is None and node.op != "constant":
            node.name = f"next_{field.name}"
    outputs = _packed("state_o", spec.state, after)
    offset = 0
    for agent in spec.views:
        observed = [node for view in spec.functions[2:] for node in trace(graph, view, after, *agent)]
        outputs += _packed("obs_o", spec.agent_fields, _narrowed(graph, observed, spec.agent_fields), offset)
        offset += word_bits(spec.agent_fields)
    outputs += _packed(
        "reward_o", spec.each_agent(replace(spec.reward, name="reward")), unseen[: spec.agents]
    )
    outputs += _packed("terminated_o", ends, unseen[spec.agents :])
    return CoreGraph(graph, outputs)


def action_ports(spec: EnvSpec) -> list[str]:
    """Return where a core finds the words of the actions of a slot's agents, agent by agent."""
    ports = ["action_i"] if spec.agents == 1 else [f"action_i[{k}]" for k in range(spec.agents)]
    if len(spec.action_fields) == 1:
        return ports
    return [f"{port}.{field.name}" for port in ports for field in spec.action_fields]


def _narrowed(graph: Graph, nodes: Sequence[Node], fields: Sequence[Field]) -> list[Node]:
    return [graph.wrap(node, f.bits, f.signed) for node, f in zip(nodes, fields, strict=True)]


def _packed(port: str, fields: Sequence[Field], nodes: Sequence[Node], offset: int = 0) -> list[Output]:
    outputs = []
    for field, node in zip(fields, nodes, strict=True):
        outputs.append(Output(port, field.name, offset, field.bits, node))
        offset += field.bits
    return outputs
