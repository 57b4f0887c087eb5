"""The proof that a pass of the compiler changes nothing: what became of each node is equal to it.

Each is proved by those before it, in the order in which they are made: as polynomials, or by z3. Loose words
may become others where nobody looks at them: then what is made of them is proved without them.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence, Set
from typing import Any

import z3

from pearl_marl.compiler.core_graph import Output
from pearl_marl.compiler.widths import WIRES
from pearl_marl.golden.tracing.nodes import Node, in_order
from pearl_marl.golden.tracing.operations import word_range

from . import polynomials
from .polynomials import Polynomial, polynomial
from .words import always, fitted, in_range, operation, size, unknown_product

DEPTH = 8
"""So often more operations are looked at together where those before do not tell."""
TERMS = frozenset({"add", "sub", "mul", "left", "or"})
ORDERS = [(TERMS, WIRES), (WIRES, TERMS)]
"""In which order they are: the terms of a sum first, or wires, which are in the way only; then all others."""


def unequal(
    roots: Iterable[Node], made: Mapping[Node, Node], widths: Mapping[Node, int] | None = None
) -> Iterator[Node]:
    """Yield the nodes that are not proved equal to what became of them, modulo bits of these widths."""
    roots = list(roots)
    yield from _Pass(in_order(roots), made, widths).unequal(set(roots))


class _Pass:
    def __init__(
        self, order: Sequence[Node], made: Mapping[Node, Node], widths: Mapping[Node, int] | None
    ) -> None:
        self.order, self.made, self.widths = order, made, widths
        self.origins: dict[Node, dict[Node, int | None]] = defaultdict(dict)
        """The nodes that a new one is known to be equal to, and modulo how many bits."""
        self.apart: set[Node] = set()
        """Loose nodes that are not known to be equal to what became of them."""

    def unequal(self, roots: Set[Node]) -> Iterator[Node]:
        for node in self.order:
            if (
                node.op not in ("constant", "input")
                and self.made[node] is not node
                and not self._is_equal(node)
            ):
                if node.loose and node not in roots:
                    self.apart.add(node)
                    continue
                yield node
            new, width = self.made[node], self._width(node)
            self.origins[new][node] = width
            if new.op == "wrap":
                self.origins[new.args[0]].setdefault(node, min(new.imm[0], width or new.imm[0]))

    def _width(self, node: Node) -> int | None:
        """Return how many bits are equal; ``None`` is for the whole integer."""
        whole = self.widths is None or node.op == "input" or self.widths[node] >= node.bits
        return None if whole else self.widths[node]

    def _is_equal(self, node: Node) -> bool:
        ways = [
            (self._by_polynomials, ORDERS[0]),
            (self._by_polynomials, ORDERS[1]),
            (self._by_bits, ORDERS[0]),
        ]
        return any(self._proved(node, by, order) for by, order in ways)

    def _proved(self, node: Node, by: Callable[..., bool], order: Iterable[Set[str]]) -> bool:
        opened = {node, *self.apart}
        for _ in range(DEPTH):
            used: set[Node] = set()
            try:
                if by(node, opened, used):
                    return True
            except polynomials.TooLongError:
                return False
            waiting = used - opened
            opened |= next(
                (found for ops in order if (found := {n for n in waiting if n.op in ops})), waiting
            )
        return False

    def _origin(
        self, new: Node, opened: set[Node], seen: Mapping[Node, Any]
    ) -> tuple[Node, int | None] | None:
        """Return what a new node is known to be: best something that has been seen, and all of it."""
        if new.op == "constant":
            return None
        found = [
            (old, width)
            for old, width in self.origins[new].items()
            if old not in opened and (old in seen or width is None)
        ]
        return max(found, key=lambda o: (o[0] in seen, o[1] is None, o[1] or 0), default=None)

    def _modulus(self, node: Node) -> int | None:
        """Return the modulus in which a node and what became of it have to be equal to be the same."""
        width, (low, high) = self._width(node), word_range(node.bits, node.low < 0)
        if width is not None:
            return width
        # Both in one range of so many values.
        return node.bits if low <= self.made[node].low and self.made[node].high <= high else None

    def _by_polynomials(self, node: Node, opened: set[Node], used: set[Node]) -> bool:
        looked_at: dict[Node, Polynomial] = {}

        def before(n: Node) -> Polynomial | None:
            return None if n in opened or n.op == "constant" else polynomials.atom(n.number)

        def after(n: Node) -> Polynomial | None:
            origin = self._origin(n, opened, looked_at)
            if origin is None:
                return polynomials.atom(n.number) if n.op == "input" else None
            old, width = origin
            known = before(old)
            if known is None or width is None:
                return known
            return polynomials.plus(known, polynomials.atom(("beyond", n.number)), 1 << width)

        due, found = polynomial(node, before, looked_at), polynomial(self.made[node], after, {})
        used |= {n for n in looked_at if n.args}
        rest, bits = polynomials.plus(due, found, -1), self._modulus(node)
        return not rest if bits is None else all(value % (1 << bits) == 0 for value in rest.values())

    def _by_bits(self, node: Node, opened: set[Node], used: set[Node]) -> bool:
        facts: list[Any] = []
        words: dict[Node, Any] = {}

        def before(n: Node) -> Any:
            if n not in words:
                if n in opened or n.op == "constant":
                    words[n] = operation(n, [before(a) for a in n.args])
                else:
                    words[n] = z3.BitVec(f"{n.op} {n.number}", size(n))
                facts.extend(in_range(n, words[n]))
            return words[n]

        new: dict[Node, Any] = {}

        def after(n: Node) -> Any:
            if n not in new:
                origin = self._origin(n, opened, words)
                if origin is None and n.op == "input":
                    new[n] = before(n)
                elif origin is None:
                    new[n] = operation(n, [after(a) for a in n.args])
                    for old, width in self.origins[n].items():
                        if old in words:  # looked into, and proved before
                            bits = width or max(new[n].size(), words[old].size())
                            facts.append(fitted(new[n], bits) == fitted(words[old], bits))
                elif origin[1] is None:
                    new[n] = fitted(before(origin[0]), size(n))
                    facts.extend(in_range(n, new[n]))
                else:
                    old, bits = origin
                    new[n] = z3.BitVec(f"new {n.op} {n.number}", size(n))
                    facts.extend([*in_range(n, new[n]), fitted(new[n], bits) == fitted(before(old), bits)])
            return new[n]

        due = before(node)
        used |= {n for n in words if n.args}
        found = after(self.made[node])
        bits = self._modulus(node) or max(due.size(), found.size())
        return always(fitted(due, bits) == fitted(found, bits), facts)


def unequal_outputs(
    before: Sequence[Output], after: Sequence[Output], hold: bool, but: Set[str]
) -> list[str]:
    """Return the fields that two graphs are not proved to give the same of, while slots are held or not.

    Those of ``but`` are not looked at. Of products nothing is taken to be known. While slots are held, reward
    and end are not compared.
    """
    inputs: dict[str, Any] = {"hold_i": z3.BitVecVal(int(hold), 2)}
    facts: list[Any] = []

    def word(root: Node, made: dict[Node, Any]) -> Any:
        for node in in_order([root]):
            args = [made.get(a) for a in node.args]
            if node in made:
                continue
            if node.op == "input":
                if node.imm not in inputs:
                    inputs[node.imm] = z3.BitVec(node.imm, size(node))
                    facts.extend(in_range(node, inputs[node.imm]))
                made[node] = inputs[node.imm]
            elif node.op == "mul":
                # Equal factors then are one, and so are products of them.
                a, b = sorted(map(z3.simplify, args), key=z3.ExprRef.get_id)
                product = unknown_product(a, b)
                facts.extend([*in_range(node, product), product == unknown_product(b, a)])
                made[node] = fitted(product, size(node))
            else:
                made[node] = operation(node, args)
        return made[root]

    whole: dict[Node, Any] = {}
    parts: dict[Node, Any] = {}
    """Of the state after the step, which is proved first, what is seen may be the same whatever it is."""

    def same(old: Output, new: Output) -> bool:
        pairs = (
            [fitted(word(output.node, made), old.bits) for output in (old, new)] for made in (whole, parts)
        )
        return any(always(due == found, facts) for due, found in pairs)

    wrong = []
    for old, new in zip(before, after, strict=True):
        name = f"{old.port}.{old.field}"
        if name not in but and (old.port in ("state_o", "obs_o") or not hold):
            if not same(old, new):
                wrong.append(name)
            elif old.port == "state_o" and old.node.args and new.node.args:
                wide = max(size(old.node), size(new.node))
                state = z3.BitVec(f"the next {old.field}", wide)
                for node in (old.node, new.node):
                    facts.extend(in_range(node, state))
                    parts[node] = fitted(state, size(node))
    return wrong
