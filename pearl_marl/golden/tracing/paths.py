"""The condition under which an author's statement runs, and what it tells of words.

Under ``x == 3`` it is 3, and under ``x > 0`` not 0.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Mapping
from typing import Any, NamedTuple

from pearl_marl.golden.tracing.graph import Graph
from pearl_marl.golden.tracing.nodes import Node

Exits = frozenset[Any]


class Literal(NamedTuple):
    """A flag that is set on a path."""

    flag: Node
    exits: Exits
    """What ended the paths on which it is not set; empty where it is a side of an ``if``."""


@dataclasses.dataclass(frozen=True, eq=False)
class Path:
    """The condition under which a statement runs, and what it tells of words."""

    graph: Graph
    literals: tuple[Literal, ...] = ()
    facts: Mapping[Node, bool] = dataclasses.field(default_factory=dict)
    """Flags that are known here."""
    known: Mapping[Node, Node] = dataclasses.field(default_factory=dict)
    """Nodes of which more is known here, as nodes of narrower ranges."""
    line: int | None = None
    """The line of the author's that first decides whether the path is taken."""

    @functools.cached_property
    def condition(self) -> Node:
        """The condition as a flag."""
        return functools.reduce(self.graph.and_, (lit.flag for lit in self.literals), self.graph.constant(1))

    def where(self, flag: Node, exits: Exits = frozenset()) -> Path:
        """Return the path on which a flag is set, too."""
        if flag.is_constant(1):
            return self
        facts, known = dict(self.facts), dict(self.known)
        for node, value in _facts(flag, True):
            facts[node] = value
            for word, low, high in _bounds(node, value):
                _narrow(self.graph, known, word, low, high)
        line = self.line or self.graph.line()
        return Path(self.graph, (*self.literals, Literal(flag, exits)), facts, known, line)

    def decided(self, flag: Node) -> bool | None:
        """Return what a flag is here, if that is known."""
        graph = self.graph
        if flag.is_constant():
            return bool(flag.imm)
        if flag in self.facts:
            return self.facts[flag]
        if flag.op == "not" and flag.args[0] in self.facts:
            return not self.facts[flag.args[0]]
        if not _depend(self.condition, flag):
            return None
        if graph.and_(self.condition, flag).is_constant(0):
            return False
        if graph.and_(self.condition, graph.logical_not(flag)).is_constant(0):
            return True
        return None

    def since(self, start: Path, but: Exits = frozenset()) -> Node:
        """Return the condition that leads here from another path, without what ``but`` alone has ended."""
        result = self.graph.constant(1)
        for literal in self.literals[len(start.literals) :]:
            if not literal.exits or not literal.exits <= but:
                result = self.graph.and_(result, literal.flag)
        return result


def _depend(a: Node, b: Node) -> bool:
    """Return whether two nodes are known to depend on the same words."""
    return not (a.function is None or b.function is None or set(a.function.axes).isdisjoint(b.function.axes))


def _facts(flag: Node, value: bool) -> list[tuple[Node, bool]]:
    """Return the flags that follow from one."""
    found = [(flag, value)]
    if flag.op == "not":
        found += _facts(flag.args[0], not value)
    if (flag.op == "and" and value) or (flag.op == "or" and not value):
        for arg in flag.args:
            if arg.is_flag:
                found += _facts(arg, value)
    return found


def _bounds(flag: Node, value: bool) -> list[tuple[Node, int, int]]:
    """Return between what words are where a comparison has come out so."""
    if flag.op == "equal":
        a, b = flag.args
        if value:
            return [(a, b.low, b.high), (b, a.low, a.high)]
        if b.is_constant():
            return [(a, a.low + (a.low == b.imm), a.high - (a.high == b.imm))]
    if flag.op == "less":
        a, b = flag.args
        if value:
            return [(a, a.low, b.high - 1), (b, a.low + 1, b.high)]
        return [(a, b.low, a.high), (b, b.low, a.high)]
    return []


def _narrow(graph: Graph, known: dict[Node, Node], word: Node, low: int, high: int) -> None:
    """Note that a word is within a range."""
    if word.is_constant():
        return
    # A word of few values needs no other node: what is made of it is joined exactly.
    if low != high and word.function is not None:
        return
    low, high = max(low, word.low), min(high, word.high)
    if (low, high) == (word.low, word.high) or low > high:
        return
    new = graph.narrow(word, low, high)
    for old in [node for node, now in known.items() if now is word]:
        known[old] = new
    known[word] = new
