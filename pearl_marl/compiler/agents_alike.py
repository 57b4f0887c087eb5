"""Agents that see by one function: that of the first, given a state in which another is in its place.

A golden function is traced once for each agent, so the graphs of a crowded world grow with the square of its
agents. Most such functions treat all agents alike: what agent 2 sees of the state ``a, b, c, d`` is what
agent 0 sees of ``c, a, b, d``. If a trace over the words in that order comes to the very nodes of agent 0's,
this is proved, whatever the functions are. Such a trace makes no new nodes, so it is fast.
"""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Iterator, Sequence
from typing import NamedTuple, TypeAlias

from pearl_marl.golden import GoldenFunction
from pearl_marl.golden.tracing.graph import Graph
from pearl_marl.golden.tracing.nodes import Node
from pearl_marl.golden.tracing.trace import trace
from pearl_marl.layout import Field
from pearl_marl.spec import EnvSpec

CROWDED = 512
"""Words that a world's agents observe, above which each agent is observed by a call: LLVM's work on a
function grows faster than its length."""

Order: TypeAlias = tuple[int, ...]
"""For each word of a state, the place of the word that is given instead."""


class Traced(NamedTuple):
    """A golden function over the words of a graph, for the first agent of a world."""

    function: GoldenFunction
    graph: Graph
    words: list[Node]
    results: list[Node]
    fields: Sequence[Field]


def is_crowded(spec: EnvSpec) -> bool:
    """Return whether each agent is observed by a call."""
    return spec.agents > 1 and spec.agents * len(spec.agent_fields) > CROWDED


def alike(spec: EnvSpec, functions: Sequence[Traced]) -> list[Order | None]:
    """Return for each agent the order in which the first one's functions are its own, or None."""
    guesses = _guesses(spec) if is_crowded(spec) else []
    first: Order = tuple(range(len(spec.state)))
    for guess in guesses:
        if _are_the_same(functions, 1, guess[1]):
            proved = (k < 2 or _are_the_same(functions, k, guess[k]) for k in range(1, spec.agents))
            return [first, *(guess[k] if same else None for k, same in enumerate(proved, 1))]
    return [first, *[None] * (spec.agents - 1)]


def _are_the_same(functions: Sequence[Traced], agent: int, order: Order) -> bool:
    """Return whether an agent's functions come to the nodes of the first one's."""
    for function, graph, words, results, fields in functions:
        given = list(words)
        for place, other in enumerate(order):
            given[other] = words[place]
        found = trace(graph, function, given, agent)
        wrapped = [graph.wrap(node, f.bits, f.signed) for node, f in zip(found, fields, strict=True)]
        if any(x is not y for x, y in zip(wrapped, results, strict=True)):
            return False
    return True


def _guesses(spec: EnvSpec) -> Iterator[list[Order]]:
    """Yield what may be the orders of all agents: of one array with an entry an agent, or of all such."""
    arrays: dict[str, dict[int, list[int]]] = defaultdict(lambda: defaultdict(list))
    for place, field in enumerate(spec.state):
        parts = re.match(r"(.*?)_(\d+)(?:_|$)", field.name)
        if parts:
            arrays[parts[1]][int(parts[2])].append(place)
    possible = [
        [array[k] for k in range(spec.agents)]
        for array in arrays.values()
        if sorted(array) == list(range(spec.agents))
        and all(_formats(spec, places) == _formats(spec, array[0]) for places in array.values())
    ]
    for chosen in [*([array] for array in possible), *([possible] if len(possible) > 1 else [])]:
        yield [_in_front(len(spec.state), chosen, agent) for agent in range(spec.agents)]


def _formats(spec: EnvSpec, places: Sequence[int]) -> list[object]:
    return [(f.bits, f.signed, f.fraction, f.range) for f in (spec.state[place] for place in places)]


def _in_front(count: int, arrays: Sequence[list[list[int]]], agent: int) -> Order:
    """Return the order in which an agent's entries of arrays come first, and then those of the others."""
    order = list(range(count))
    for array in arrays:
        moved = [array[agent], *array[:agent], *array[agent + 1 :]]
        for places, others in zip(array, moved, strict=True):
            for place, other in zip(places, others, strict=True):
                order[place] = other
    return tuple(order)
