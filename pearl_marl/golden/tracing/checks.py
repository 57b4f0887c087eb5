"""What can be wrong with golden functions, found by tracing them when a spec is built.

Of every result the graph knows a range, over all states that fit their fields, all actions and all draws.
"""

from __future__ import annotations

import functools
import itertools
import math
import random
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

from pearl_marl.errors import ArgumentError
from pearl_marl.golden.tracing.graph import Graph
from pearl_marl.golden.tracing.nodes import Node, in_order, values
from pearl_marl.golden.tracing.trace import location, trace

TRIALS = 200_000
"""Operations that the search for an example may take."""


class Argument(NamedTuple):
    """A word that a golden function is called with."""

    name: str
    bits: int
    signed: bool
    low: int
    high: int


class Result(NamedTuple):
    """A word that it has to return, with its limits."""

    name: str
    low: int
    high: int
    limit: str
    """What sets the limits, such as ``"4 bits hold"``."""
    fix: str
    """What its author may do about a word beyond them."""


@functools.lru_cache
def check(
    function: Callable[..., Any], given: Sequence[Argument], due: Sequence[Result], *agent: int
) -> None:
    """Refuse a golden function that cannot be called with some words, or returns others than it has to.

    ``agent`` is the number of an agent, for a function that takes one after its words.

    Raises
    ------
    ArgumentError
        Says what is wrong and in which line of the author's file, with an example where trying finds one.
    """
    graph = Graph()
    inputs = {w.name: graph.input(w.name, w.bits, w.signed, w.low, w.high) for w in given}
    results = trace(graph, function, list(inputs.values()), *agent)
    if len(results) != len(due):
        raise ArgumentError(
            f"{location(function)}: {function.__name__}() returns {len(results)} word"
            f"{'' if len(results) == 1 else 's'}, and the spec takes {len(due)}: "
            f"{_listed([word.name for word in due])}"
        )
    for node, word in zip(results, due, strict=True):
        if node.low < word.low or node.high > word.high:
            found = f"{node.low}" if node.low == node.high else f"{node.low} to {node.high}"
            raise ArgumentError(
                f"{location(function, node.line)}: {function.__name__}() returns {found} for {word.name}"
                f"{''.join(f' of agent {k}' for k in agent)}, and "
                f"{word.limit} {word.low} to {word.high}; {_example(node, word, inputs)}; {word.fix}"
            )


def _example(node: Node, word: Result, inputs: Mapping[str, Node]) -> str:
    """Say for which arguments a result is beyond its limits, as far as trying shows it."""
    order = in_order([node])
    used = {name: argument for name, argument in inputs.items() if argument in order}
    for case in _cases(used, [n.imm for n in order if n.op == "constant"], TRIALS // len(order)):
        value = values([node], {inputs[name].imm: number for name, number in case.items()})[node]
        if not word.low <= value <= word.high:
            where = _listed([f"{name} is {number}" for name, number in case.items()])
            return f"for example {value}, where {where}" if where else "always"
    return "trying found no example, so perhaps only its author knows better"


def _cases(inputs: Mapping[str, Node], constants: Sequence[int], count: int) -> Iterator[dict[str, int]]:
    """Yield all values of inputs, or where they are many those where something may happen, and others."""
    if math.prod(word.high - word.low + 1 for word in inputs.values()) <= count:
        for case in itertools.product(*(range(word.low, word.high + 1) for word in inputs.values())):
            yield dict(zip(inputs, case, strict=True))
        return
    chance, near = random.Random(0), [c + d for c in (0, *constants) for d in (0, 1, -1)]
    edges = {
        name: list(dict.fromkeys(c for c in (*near, word.low, word.high) if word.low <= c <= word.high))
        for name, word in inputs.items()
    }
    # Sums and conjunctions of many words are at their ends where all words are.
    for value in sorted(set(itertools.chain.from_iterable(edges.values()))):
        yield {name: min(max(value, word.low), word.high) for name, word in inputs.items()}
    for case in itertools.islice(itertools.product(*edges.values()), count // 2):
        yield dict(zip(inputs, case, strict=True))
    for _ in range(count // 2):
        yield {
            name: chance.choice(edges[name]) if chance.random() < 0.7 else chance.randint(word.low, word.high)
            for name, word in inputs.items()
        }


def _listed(words: Sequence[str]) -> str:
    return " and ".join([", ".join(words[:-1]), words[-1]] if len(words) > 1 else words)
