"""``hold`` by gating: a slot that is held keeps its state because what would change it is switched off.

To choose between the old state and the new one at the end would cost a multiplexer a bit, and the old state
would have to be carried along. So a word that has to be 0 under hold is made so where that takes the fewest
bits, such as in the flag that decides on a move; and ``row + down - up`` keeps ``row`` if ``down`` and ``up``
are 0. Words that are not used under hold may then be anything.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Literal

from pearl_marl.golden.tracing.graph import Graph
from pearl_marl.golden.tracing.nodes import Node, in_order

Demand = Node | Literal["zero", "ones", "one"] | None
"""What a node has to be under hold: this word, 0, -1, 1 (as a flag), anything."""
Plan = tuple[Demand, ...]
"""What a node's arguments have to be so that it is what it has to be."""


def held(
    graph: Graph, hold: Node, start: Sequence[Node], moved: Sequence[Node], unseen: Sequence[Node]
) -> tuple[list[Node], list[Node]]:
    """Return ``moved`` such that it is ``start`` under hold, and ``unseen``, which may be anything there."""
    gates = _Gates(graph, hold, start, in_order([*moved, *unseen]))
    for word, node in zip(start, moved, strict=True):
        gates.plan(node, word)
    return [gates.gated(n, word) for word, n in zip(start, moved, strict=True)], [
        gates.free(n) for n in unseen
    ]


class _Gates:
    def __init__(self, graph: Graph, hold: Node, start: Sequence[Node], order: Sequence[Node]) -> None:
        self.graph, self.hold, self.order = graph, hold, order
        self.go = graph.logical_not(hold)
        self.go.name = "go"
        self.leaves = {*start, *(n for n in order if not n.args)}
        self.plans: dict[tuple[Node, Demand], Plan | None] = {}
        """How each demand is met; ``None`` stands for a gate at the node itself."""
        self.first: dict[Node, Demand] = {}
        """A demand that is met by arguments, of nodes that have one."""
        self.made: dict[tuple[Node, Demand], Node] = {}

    def plan(self, node: Node, word: Node) -> None:
        """Decide how a node comes to be ``word`` under hold."""
        reaching = self._reaching(word)
        cost: dict[tuple[Node, Demand], float] = {}
        best: dict[tuple[Node, Demand], Plan | None] = {}
        for n in self.order:
            demands: list[Demand] = ["zero", "one" if n.is_flag else "ones"]
            demands += [word] if n in reaching else []
            for demand in demands:
                key: tuple[Node, Demand] = n, demand
                if n is word and demand is word:
                    cost[key], best[key] = 0, ()
                    continue
                if key in self.plans:
                    cost[key], best[key] = 0, self.plans[key]
                    continue
                cost[key], best[key] = self._cost_here(n, demand), None
                if n in self.leaves:
                    continue
                for plan in _plans(self.graph, n, demand):
                    try:
                        total = sum(cost[a, d] for a, d in zip(n.args, plan, strict=True) if d is not None)
                    except KeyError:  # an argument that does not reach the word
                        continue
                    if total <= cost[key]:
                        cost[key], best[key] = total, plan
        waiting: list[tuple[Node, Demand]] = [(node, word)]
        while waiting:
            n, demand = waiting.pop()
            if (n, demand) in self.plans or demand is None or n is demand:
                continue
            chosen = self.plans[n, demand] = best.get((n, demand))
            if chosen is not None:
                self.first.setdefault(n, demand)
                waiting += zip(n.args, chosen, strict=True)

    def _reaching(self, word: Node) -> set[Node]:
        found = {word}
        for n in self.order:
            if n not in self.leaves and any(a in found for a in n.args):
                found.add(n)
        return found

    def _cost_here(self, n: Node, demand: Demand) -> float:
        if isinstance(demand, Node):
            return 2 * n.bits
        return 0 if n.is_constant({"zero": 0, "one": 1, "ones": -1}[str(demand)]) else n.bits

    def free(self, node: Node) -> Node:
        """Return a node made anew of gated ones; under hold it may be anything."""
        return self.gated(node, self.first.get(node))

    def gated(self, node: Node, demand: Demand) -> Node:
        if node is demand or (demand is None and node in self.leaves):
            return node
        for n in in_order([node]):  # bottom up, since a graph is deeper than Python's stack
            if n not in self.leaves:
                self._make(n, self.first.get(n))
        return self._make(node, demand)

    def _make(self, n: Node, demand: Demand) -> Node:
        if n is demand or (demand is None and n in self.leaves):
            return n
        key = n, demand
        if key not in self.made:
            graph, plan = self.graph, self.plans.get(key)
            if demand is None:
                made = graph.again(n, [self._make(a, self.first.get(a)) for a in n.args])
            elif plan is not None:
                args = zip(n.args, plan, strict=True)
                made = graph.again(n, [self._make(a, d or self.first.get(a)) for a, d in args])
            else:
                whole = n if n in self.leaves else self._make(n, None)
                if isinstance(demand, Node):
                    made = graph.choose(self.hold, demand, whole)
                elif demand == "zero":
                    made = graph.choose(self.go, whole, graph.constant(0))
                else:
                    made = graph.or_(self.hold if demand == "one" else graph.mask(self.hold), whole)
                if made.name is None:
                    made.name, made.line = n.name, n.line
            self.made[key] = made
        return self.made[key]


def _plans(graph: Graph, n: Node, demand: Demand) -> Iterator[Plan]:
    """Yield what the arguments of a node can be so that it is what it has to be."""
    match demand, n.op:
        case "zero", "and" | "mul":
            yield from (("zero", None), (None, "zero"))
        case "zero", "or" | "xor" | "add" | "sub":
            yield "zero", "zero"
        case "zero", "mask" | "left" | "right" | "wrap" | "divide" | "modulo":
            yield ("zero",)
        case "zero", "left_by" | "right_by":
            yield "zero", None
        case "zero", "narrow" if n.low <= 0 <= n.high:
            yield ("zero",)
        case "zero", "not":
            yield ("one",)
        case "zero", "invert":
            yield ("ones",)
        case "zero", "choose":
            yield from (("zero", None, "zero"), ("one", "zero", None), (None, "zero", "zero"))
        case "zero", "table" if n.imm[0] == 0:
            yield ("zero",)
        case "one" | "ones", "or":
            yield from ((demand, None), (None, demand))
        case "one" | "ones", "and":
            yield demand, demand
        case ("one" | "ones", "not") | ("ones", "invert"):
            yield ("zero",)
        case "one" | "ones", "mask":
            yield ("one",)
        case Node(), "or" | "xor" | "add":
            yield from ((demand, "zero"), ("zero", demand))
        case Node(), "sub" | "left_by" | "right_by":
            yield demand, "zero"
        case Node(), "and":
            yield from ((demand, "ones"), ("ones", demand))
            if demand.is_flag:
                yield from ((demand, "one"), ("one", demand))
        case Node(), "choose":
            yield from (("zero", None, demand), ("one", demand, None), (None, demand, demand))
        case Node(), "wrap" if graph.wrap(demand, *n.imm) is demand:
            yield (demand,)
