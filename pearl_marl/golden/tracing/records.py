"""What golden functions do, as a text that stays the same until they do something else.

It is the hash of the graph that a function leaves: no names, lines or comments count. The graph is what the
compiler's rules make of it, so texts begin with the number of the rules, and two are compared only under one.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable
from typing import Any

from pearl_marl.golden.tracing.graph import Graph
from pearl_marl.golden.tracing.nodes import in_order
from pearl_marl.golden.tracing.trace import trace

RULES = 2
"""Another one for every change of the compiler after which some graph is another one."""


def record(function: Callable[..., Any], inputs: Iterable[tuple[int, bool, int, int]], *agent: int) -> str:
    """Return the hash of a golden function's graph.

    ``inputs`` are bits, sign and range of each word; ``agent`` is an agent's number, where one is taken.
    """
    graph = Graph()
    words = [graph.input(str(k), *word) for k, word in enumerate(inputs)]
    results = trace(graph, function, words, *agent)
    order = in_order(results)
    number = {node: k for k, node in enumerate(order)}
    lines = [f"{node.op} {node.imm} {[number[a] for a in node.args]}" for node in order]
    lines.append(f"{[number[node] for node in results]}")
    return hashlib.sha256("\n".join(lines).encode()).hexdigest()[:32]


def comparable(one: str, other: str) -> bool:
    """Return whether two texts are of the same rules, so that they differ only if functions do."""
    return one.partition(":")[0] == other.partition(":")[0]
