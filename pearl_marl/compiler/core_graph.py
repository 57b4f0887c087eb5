"""The graphs of cores, from inputs to outputs: of what a slot does in a step, and of a policy."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

from pearl_marl.compiler.gating import held
from pearl_marl.golden import GoldenFunction
from pearl_marl.golden.tracing.graph import Graph
from pearl_marl.golden.tracing.nodes import Node
from pearl_marl.golden.tracing.trace import trace
from pearl_marl.layout.positional import row_of
from pearl_marl.spec import TERMINATED, EnvSpec, Field


class Output(NamedTuple):
    """A field of one of a core's outputs."""

    port: str
    field: str
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
    for agent in spec.views:
        observed = [node for view in spec.functions[2:] for node in trace(graph, view, after, *agent)]
        outputs += _packed("obs_o", spec.agent_fields, _narrowed(graph, observed, spec.agent_fields))
    outputs += _packed(
        "reward_o", spec.each_agent(replace(spec.reward, name="reward")), unseen[: spec.agents]
    )
    outputs += _packed("terminated_o", ends, unseen[spec.agents :])
    return CoreGraph(graph, outputs)


def act_graph(spec: EnvSpec, act: GoldenFunction, draws: int) -> CoreGraph:
    """Return the graph of a policy's core: from what an agent is shown, and draws, to its action.

    ``act`` is a function of words (:meth:`EnvSpec.act_of_words`). Inputs are named as the core's ports have
    them: ``obs_i.angle``, ``rng_i[0]``. In the place of an action that masks forbid is the first that they
    allow, or 0 where they allow none.

    Raises
    ------
    ArgumentError
        The function does what no hardware can; the message names the file and the line.
    """
    graph = Graph()
    shown = [graph.input(f"obs_i.{f.name}", f.bits, f.signed, *f.range) for f in spec.agent_fields]
    observed, masks = shown[: len(spec.observation)], shown[len(spec.observation) :]
    words = trace(graph, act, [*observed, *(graph.input(f"rng_i[{k}]", 32) for k in range(draws))])
    words = _narrowed(graph, words, spec.action_fields)
    if masks:
        flags = graph.constant(0)
        for k, mask in enumerate(masks):
            flags = graph.or_(flags, graph.left(mask, k))
        allowed = graph.wrap(graph.right_by(flags, words[0]), 1, signed=False)
        words = _narrowed(
            graph, [graph.choose(allowed, words[0], _first(graph, masks)[1])], spec.action_fields
        )
    return CoreGraph(graph, _packed("action_o", spec.action_fields, words))


def show_graph(spec: EnvSpec) -> CoreGraph:
    """Return the graph of a picture: from the words that an agent is shown to its elements, a bit each.

    Raises
    ------
    ArgumentError
        ``unpack()`` does what no hardware can; the message names the file and the line.
    """
    graph = Graph()
    shown = [graph.input(f"obs_i.{f.name}", f.bits, f.signed, *f.range) for f in spec.agent_fields]
    elements = [Field(f"element_{k}", 1) for k in range(math.prod(spec.observation_shape))]
    nodes = shown
    if spec.positional.unpack is not None:
        nodes = trace(graph, row_of(spec.positional.unpack, len(elements)), shown[: len(spec.observation)])
    nodes = _narrowed(graph, nodes[: len(elements)], elements)
    return CoreGraph(graph, _packed("picture_o", elements, nodes))


def _first(graph: Graph, flags: Sequence[Node]) -> tuple[Node, Node]:
    """Return whether a flag is set, and the number of the first that is, or 0."""
    if len(flags) == 1:
        return flags[0], graph.constant(0)
    middle = 1 << (len(flags) - 1).bit_length() - 1
    (low, number), (high, above) = _first(graph, flags[:middle]), _first(graph, flags[middle:])
    above = graph.choose(high, graph.add(above, graph.constant(middle)), graph.constant(0))
    return graph.or_(low, high), graph.choose(low, number, above)


def action_ports(spec: EnvSpec) -> list[str]:
    """Return where a core finds the words of the actions of a slot's agents, agent by agent."""
    ports = ["action_i"] if spec.agents == 1 else [f"action_i[{k}]" for k in range(spec.agents)]
    if len(spec.action_fields) == 1:
        return ports
    return [f"{port}.{field.name}" for port in ports for field in spec.action_fields]


def _narrowed(graph: Graph, nodes: Sequence[Node], fields: Sequence[Field]) -> list[Node]:
    return [graph.wrap(node, f.bits, f.signed) for node, f in zip(nodes, fields, strict=True)]


def _packed(port: str, fields: Sequence[Field], nodes: Sequence[Node]) -> list[Output]:
    return [Output(port, field.name, field.bits, node) for field, node in zip(fields, nodes, strict=True)]
