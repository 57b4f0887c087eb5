"""From the operations of a graph to those of an FPGA: multipliers of its width, and sums that fit a stage.

The result is a graph of the same integers, modulo the bits that are used. ``add``, ``sub``, ``mul``
and ``divide`` have become ``sum``, of shifted and signed words and a constant, ``join``, of words side by
side, and ``mul`` of words that one multiplier takes; ``narrow`` is a ``wrap`` at most, so that every node is
within its range again, and a division by a word a subtraction for each bit of the quotient.
"""

from __future__ import annotations

import itertools
import math
from collections import Counter
from collections.abc import Sequence
from typing import NamedTuple

from pearl_marl.compiler.core_graph import Output
from pearl_marl.compiler.joining import MOST_DIGITS, digits_joined, rounding_joined
from pearl_marl.compiler.targets import Target
from pearl_marl.compiler.widths import used_bits, width
from pearl_marl.golden.tracing.graph import Graph
from pearl_marl.golden.tracing.nodes import Node, in_order
from pearl_marl.golden.tracing.operations import VALUES, bits_of

CHEAP = 24
"""Bits to be added up to which a product takes no multiplier."""

MOST_BITS = 6
"""Bits of two words together up to which a division is a table."""


class Term(NamedTuple):
    """What is added: ``sign * (node << shift)``."""

    sign: int
    shift: int
    node: Node

    @property
    def low(self) -> int:
        """The least value."""
        return (self.node.low if self.sign > 0 else -self.node.high) << self.shift

    @property
    def high(self) -> int:
        """The greatest value."""
        return (self.node.high if self.sign > 0 else -self.node.low) << self.shift


def lowered(graph: Graph, outputs: Sequence[Output], target: Target) -> list[Output]:
    """Return the outputs of a core in a new graph, of operations that its target has."""
    nodes = [o.node for o in outputs]
    for joined in (digits_joined, rounding_joined):
        made = joined(graph, nodes)
        nodes = [made[node] for node in nodes]
    lowering = Lowering(nodes, [o.bits for o in outputs], target)
    return [o._replace(node=lowering.made[node]) for o, node in zip(outputs, nodes, strict=True)]


class Lowering:
    """Makes nodes of a target's operations.

    ``made`` has what each node has become, equal to it modulo the bits that are used of it; ``used`` says
    which these are.
    """

    def __init__(self, roots: Sequence[Node], bits: Sequence[int], target: Target) -> None:
        self.target, self.graph = target, Graph(exact=False)
        order = in_order(roots)
        self.used = used_bits(order, list(zip(roots, bits, strict=True)))
        self.uses = Counter([*(arg for node in order for arg in node.args), *roots])
        self.made: dict[Node, Node] = {}
        self.divided: dict[tuple[Node, ...], tuple[Node, Node]] = {}
        """Quotients and remainders of words by words."""
        for node in order:
            made = self._lower(node)
            if made.name is None and not made.is_constant():
                made.name, made.line = node.name, node.line
            self.made[node] = self._fitted(made, node)

    def _lower(self, node: Node) -> Node:
        graph, args = self.graph, [self.made[a] for a in node.args]
        match node.op:
            case "constant":
                return graph.constant(node.imm)
            case "input":
                return graph.input(node.imm, node.bits, node.low < 0)
            case "right" | "left" | "wrap":
                return graph.again(node, args)
            case "add" | "sub" | "mul":
                terms: list[Term] = []
                bits = width(node, self.used)
                constant = self._flatten(node, 1, 0, terms, bits, whole=True)
                return self._total(terms, constant, bits)
            case "narrow":
                return args[0]  # its own bits are cut out of it like those of any other
            case "table" if node.args[0].loose:
                return graph.table(node.imm, args[0])  # as long as its index is wide
            case "divide_by" | "modulo_by":
                return self._divided(*args)[node.op == "modulo_by"]
            case "divide" | "modulo" if args[0].low >= 0 and args[0].high < MOST_DIGITS:
                entries = [VALUES[node.op](node.imm, i) for i in range(args[0].high + 1)]
                return graph.table(entries, args[0])
            case "modulo":
                quotient = self._quotient(args[0], node.imm)
                products = self._products(quotient, graph.constant(node.imm), args[0].bits + 1)
                terms = [Term(1, 0, args[0]), *(t._replace(sign=-t.sign) for t in products)]
                return self._total(terms, 0, node.bits)
            case "divide":
                return self._quotient(args[0], node.imm)
            case "right_by" if args[0].op == "table" and self._is_short(args[0], args[1], node):
                row, shifts = args[0].args[0], range(1 << args[1].bits)
                entries = [entry >> k for entry in args[0].imm for k in shifts]
                return graph.table(entries, graph.make("join", row, args[1], imm=args[1].bits))
            case "less" if args[1].is_constant():
                return graph.make("less", *args, imm=self._entering(args[0], args[1].imm))
            case "less" if args[0].is_constant():
                return graph.make("less", *args, imm=self._entering(args[1], args[0].imm + 1))
        return graph.make(node.op, *args, imm=node.imm)

    def _entering(self, a: Node, limit: int) -> int | None:
        """Return how many lowest bits of ``a < limit`` are better a carry that enters the chain, if any are.

        A place of the chain takes two tables, if it is less and if it is equal, and these bits take one.
        """
        most = self.target.family.compared
        bits = a.bits % most or most if 0 < 2 * most <= a.bits else 0
        return bits if limit & ((1 << bits) - 1) else None

    def _is_short(self, table: Node, by: Node, shifted: Node) -> bool:
        """Return whether a bit of a table's entries, a row each, is a table of few entries itself."""
        return width(shifted, self.used) == 1 and len(table.imm) << by.bits <= MOST_DIGITS

    def _divided(self, a: Node, by: Node) -> tuple[Node, Node]:
        """Return ``a // by`` and ``a % by``, of one divider for both."""
        if (a, by) not in self.divided:
            self.divided[a, by] = self._by_hand(a, by)
        return self.divided[a, by]

    def _by_hand(self, a: Node, by: Node) -> tuple[Node, Node]:
        """Return quotient and remainder, rounded down; if ``by`` is 0 they are others, which are not used."""
        graph = self.graph
        if a.bits + by.bits <= MOST_BITS:
            return self._tables(a, by)
        if a.low >= 0:
            return self._steps(a, by)
        # What is below 0 is divided as its complement, -1 - a, which is at least 0 and has one bit less.
        sign = graph.wrap(graph.right(a, a.bits - 1), 1, False)
        turned = graph.mask(sign)
        whole = graph.wrap(graph.xor(a, turned), a.bits - 1, False)
        quotient, rest = self._steps(whole, by)
        beyond = self._total([Term(1, 0, by), Term(-1, 0, rest)], -1, by.bits)
        return graph.xor(quotient, turned), graph.choose(sign, graph.wrap(beyond, by.bits, False), rest)

    def _steps(self, a: Node, by: Node) -> tuple[Node, Node]:
        """Divide a word that is not negative.

        From the highest bit on, the divisor is taken off what is left if it fits in. The scheduler puts as
        many of these steps into a stage as its clock allows.
        """
        graph = self.graph
        rest, quotient = graph.constant(0), graph.constant(0)
        for k in reversed(range(a.bits)):
            bit = graph.wrap(graph.right(a, k), 1, False)
            whole = bit if rest.is_constant(0) else graph.make("join", rest, bit, imm=1)
            if whole.high < by.low:  # it fits in nowhere
                rest, fits = whole, graph.constant(0)
            else:
                bits = by.bits + 1  # it is from -by to by - 1, since what was left is less than the divisor
                less = self._total([Term(1, 0, whole), Term(-1, 0, by)], 0, bits)
                below = graph.wrap(graph.right(less, bits - 1), 1, False)
                bits = min(whole.bits, by.bits)
                rest = graph.choose(below, *(graph.wrap(x, bits, False) for x in (whole, less)))
                fits = graph.logical_not(below)
            quotient = fits if quotient.is_constant(0) else graph.make("join", quotient, fits, imm=1)
        return quotient, rest

    def _tables(self, a: Node, by: Node) -> tuple[Node, Node]:
        dividends = (x - (1 << a.bits) if a.low < 0 and x >> (a.bits - 1) else x for x in range(1 << a.bits))
        pairs = [divmod(x, max(1, y)) for x in dividends for y in range(1 << by.bits)]
        index = self.graph.make("join", self.graph.wrap(a, a.bits, False), by, imm=by.bits)
        quotient, rest = (self.graph.table(entries, index) for entries in zip(*pairs, strict=True))
        return quotient, rest

    def _quotient(self, a: Node, by: int) -> Node:
        """Return ``a // by`` as an exact multiplication."""
        below = -(a.low // by) if a.low < 0 else 0  # so many times the divisor more, and it is not negative
        a = self._total([Term(1, 0, a)], below * by, a.bits + by.bit_length())
        # With so many fraction bits the reciprocal, rounded up, is near enough for every dividend.
        fraction = a.bits + by.bit_length()
        reciprocal = self.graph.constant(-(-(1 << fraction) // by))
        bits = a.bits + reciprocal.bits
        product = self._total(self._products(a, reciprocal, bits), 0, bits)
        quotient = self.graph.right(product, fraction)
        return self._total([Term(1, 0, quotient)], -below, a.bits + 1)

    def _fitted(self, made: Node, node: Node) -> Node:
        """Return what was made for a node modulo the bits that are used, or of its range if all are."""
        used = width(node, self.used)
        if used < node.bits:
            return self.graph.wrap(made, used, False)
        if node.low <= made.low and made.high <= node.high:
            return made
        return self.graph.wrap(made, used, node.low < 0)

    def _flatten(
        self, node: Node, sign: int, shift: int, terms: list[Term], bits: int, whole: bool = False
    ) -> int:
        """Add the terms of a sum, right modulo so many bits; return the constant among them."""
        if node.is_constant():
            return sign * (int(node.imm) << shift)
        if node.op == "left":
            return self._flatten(node.args[0], sign, shift + node.imm, terms, bits)
        if whole or (self.uses[node] == 1 and self._can_open(node, bits - shift)):
            if node.op in ("add", "sub"):
                a, b = node.args
                constant = self._flatten(a, sign, shift, terms, bits)
                return constant + self._flatten(b, -sign if node.op == "sub" else sign, shift, terms, bits)
            if node.op == "mul":
                a, b = (self._factor(self.made[arg], bits - shift) for arg in node.args)
                products = self._products(a, b, bits - shift)
                terms += (Term(sign * t.sign, shift + t.shift, t.node) for t in products)
                return 0
        terms.append(Term(sign, shift, self.made[node]))
        return 0

    def _can_open(self, node: Node, bits: int) -> bool:
        """Return whether a node's arguments are right in all the bits that a sum around it needs."""
        exact = all(width(a, self.used) >= a.bits for a in node.args)
        return bits > 0 and (exact or bits <= width(node, self.used))

    # ---- products

    def _products(self, a: Node, b: Node, bits: int) -> list[Term]:
        """Return the terms of a product, of which so many bits are used."""
        if b.is_constant():
            digits = signed_digits(b.imm)
            if a.bits <= 2 or (len(digits) > 2 and a.bits <= 4):
                values = range(1 << a.bits)
                index = self.graph.wrap(a, a.bits, False)
                signed = [v - (1 << a.bits) if a.low < 0 and v >> (a.bits - 1) else v for v in values]
                return [Term(1, 0, self.graph.table([v * b.imm for v in signed], index))]
            # A multiplier without registers of its own is slow, and not worth it for three digits.
            few = len(digits) <= 3 and (self._multipliers(a, b) > 2 or not self.target.family.accumulator)
            if few or (len(digits) - 1) * a.bits <= CHEAP:
                return [Term(sign, shift, a) for sign, shift in digits]
            # Without its first digits a long constant may take half the multipliers.
            low, wide = digits[0][1], self.target.family.multiplier[0]
            for n in (1, 2) if self.target.family.accumulator and self._multipliers(a, b) > 2 else ():
                rest = b.imm - sum(sign << shift for sign, shift in digits[-n:]) >> low
                if rest.bit_length() <= wide < b.bits - low:
                    products = self._products(a, self.graph.constant(rest), bits - low)
                    products = [t._replace(shift=t.shift + low) for t in products]
                    return [*products, *(Term(sign, shift, a) for sign, shift in digits[-n:])]
        xs, ys = self._cut(a, b)
        square = self._pieces(a, self.target.family.multiplier[1]) if a is b else []
        if square and len(square) * (len(square) + 1) // 2 <= len(xs) * len(ys):
            xs = ys = square
        terms = []
        for i, (x, low_x) in enumerate(xs):
            for j, (y, low_y) in enumerate(ys):
                doubled = xs is ys and i != j
                if (xs is ys and j < i) or low_x + low_y + doubled >= bits:
                    continue
                product = self.graph.mul(x, y)
                if not product.is_constant(0):
                    terms.append(Term(1, low_x + low_y + doubled, product))
        return terms

    def _multipliers(self, a: Node, b: Node) -> int:
        return math.prod(map(len, self._cut(a, b)))

    def _cut(self, a: Node, b: Node) -> list[list[tuple[Node, int]]]:
        """Cut two words into pieces that take the fewest multipliers."""
        cuts = itertools.permutations(self.target.family.multiplier)
        pairs = ([self._pieces(a, u), self._pieces(b, v)] for u, v in cuts)
        return min(pairs, key=lambda pair: math.prod(map(len, pair)))

    def _factor(self, node: Node, bits: int) -> Node:
        """Return what a product needs of a word; joined parts are one word, as in a multiplier's register."""
        node = node if node.bits <= bits else self.graph.wrap(node, bits, False)
        inner = node
        while inner.op in ("wrap", "left", "right"):
            inner = inner.args[0]
        return self.graph.make("word", node) if inner.op == "join" else node

    def _pieces(self, node: Node, bits: int) -> list[tuple[Node, int]]:
        """Cut a word into pieces of so many bits; the last one has the sign."""
        pieces, shift = [], 0
        while node.bits > bits + (node.low < 0):
            pieces.append((self.graph.wrap(node, bits, False), shift))
            node, shift = self.graph.right(node, bits), shift + bits
        return [*pieces, (node, shift)]

    # ---- sums

    def _total(self, terms: list[Term], constant: int, bits: int) -> Node:
        """Return a sum, of which so many bits are used, in parts that fit a stage."""
        graph = self.graph
        terms, constant = self._accumulated([t for t in terms if t.shift < bits], constant, bits)
        terms = _side_by_side(graph, terms)
        if not terms:
            return graph.constant(constant)
        if len(terms) == 1 and constant == 0 and terms[0].sign > 0:
            return graph.left(terms[0].node, terms[0].shift)
        made = min(bits, bits_of(sum(t.low for t in terms) + constant, sum(t.high for t in terms) + constant))
        low = min(t.shift for t in terms)
        words = sum(t.node.bits > 1 for t in terms)
        if self.target.addition(words + (constant != 0 and words > 1), made - low) <= self.target.budget:
            return self._sum(terms, constant)
        if low and constant % (1 << low) == 0:
            shifted = [t._replace(shift=t.shift - low) for t in terms]
            return graph.left(self._total(shifted, constant >> low, bits - low), low)
        if words > 2:
            return self._paired(terms, constant, bits)
        return self._halved(terms, constant, bits, made)

    def _accumulated(self, terms: list[Term], constant: int, bits: int) -> tuple[list[Term], int]:
        """Add products, from the lowest on, each by the adder behind its multiplier; return what is left."""
        graph, most = self.graph, self.target.family.accumulator
        products = sorted((t for t in terms if t.node.op == "mul" and t.sign > 0), key=lambda t: t.shift)
        if not most or not products:
            return terms, constant
        rest = [t for t in terms if t not in products]
        shift, total = products[0].shift, products[0].node
        constant %= 1 << bits
        if constant and constant % (1 << shift) == 0 and (total.low >= 0 or bits - shift <= most):
            # Of a longer constant the bits above one that is 0, which takes the carry, need not be added.
            cut = total.bits if total.low >= 0 else bits - shift
            while constant >> (shift + cut) & 1:
                cut += 1
            if cut < most:
                own = (constant >> shift) & ((1 << cut) - 1)
                total = self._sum([Term(1, 0, total)], own) if own else total
                upper = constant >> (shift + cut)
                if upper:
                    total = self._joined(graph.constant(upper >> 1), total, cut + 1)
                constant = 0
        lower: list[Term] = []
        for k, product in enumerate(products[1:], 1):
            step = product.shift - shift
            above = graph.right(total, step)
            if min(bits - product.shift, max(above.bits, product.node.bits) + 1) > most:
                rest += products[k:]
                break
            if step:
                lower.append(Term(1, shift, graph.wrap(total, step, False)))
            total, shift = self._sum([Term(1, 0, product.node), Term(1, 0, above)], 0), product.shift
        return [*rest, *lower, Term(1, shift, total)], constant

    def _sum(self, terms: Sequence[Term], constant: int) -> Node:
        weights = tuple((t.sign, t.shift) for t in terms)
        return self.graph.make("sum", *(t.node for t in terms), imm=(constant, weights))

    def _paired(self, terms: list[Term], constant: int, bits: int) -> Node:
        """Add the two neighbours first whose sum is the shortest."""
        terms = sorted(terms, key=lambda t: t.shift)
        tops = itertools.pairwise(t.shift + t.node.bits for t in terms)
        lengths = [(max(top) - t.shift, -t.shift) for top, t in zip(tops, terms[:-1], strict=True)]
        i = lengths.index(min(lengths))
        own = constant if constant % (1 << terms[i].shift) == 0 else 0
        pair = self._total(terms[i : i + 2], own, bits)
        shift = 0
        while pair.op == "left":
            pair, shift = pair.args[0], shift + pair.imm
        return self._total([*terms[:i], *terms[i + 2 :], Term(1, shift, pair)], constant - own, bits)

    def _halved(self, terms: list[Term], constant: int, bits: int, made: int) -> Node:
        """Add lower halves first, and upper halves with their carry in a later stage."""
        graph = self.graph
        first, *others = sorted(terms, key=lambda t: t.shift)
        if len(others) == 1 and first.shift == 0 and first.sign > 0:
            cut = others[0].shift
            if cut and constant % (1 << cut) == 0 and first.node.bits > cut:
                # The lowest bits are there already.
                upper = [Term(1, 0, graph.right(first.node, cut)), others[0]._replace(shift=0)]
                return self._joined(self._total(upper, constant >> cut, bits - cut), first.node, cut)
        cut = (made + 1) // 2
        if cut < 8:
            return self._sum(terms, constant)
        lower = [t._replace(node=graph.wrap(t.node, cut - t.shift, False)) for t in terms if t.shift < cut]
        upper = [
            Term(t.sign, 0, graph.right(t.node, cut - t.shift))
            if t.shift < cut
            else t._replace(shift=t.shift - cut)
            for t in terms
        ]
        below = self._total(lower, constant & ((1 << cut) - 1), cut + 2)
        upper = [t for t in (*upper, Term(1, 0, graph.right(below, cut))) if not t.node.is_constant(0)]
        return self._joined(self._total(upper, constant >> cut, bits - cut), below, cut)

    def _joined(self, upper: Node, lower: Node, bits: int) -> Node:
        return self.graph.make("join", upper, self.graph.wrap(lower, bits, False), imm=bits)


def _side_by_side(graph: Graph, terms: list[Term]) -> list[Term]:
    """Join words that do not overlap: where one ends before the other begins nothing has to be added."""
    for upper in terms:
        for lower in terms:
            fits = upper.shift - lower.shift >= lower.node.bits and lower.node.low >= 0
            if fits and upper.sign > 0 and lower.sign > 0:
                joined = graph.make("join", upper.node, lower.node, imm=upper.shift - lower.shift)
                rest = [t for t in terms if t is not upper and t is not lower]
                return _side_by_side(graph, [*rest, Term(1, lower.shift, joined)])
    return terms


def signed_digits(value: int) -> list[tuple[int, int]]:
    """Return a constant as few powers of two: their signs and exponents."""
    digits, shift = [], 0
    while value:
        if value & 1:
            digit = 2 - (value & 3)
            digits.append((digit, shift))
            value -= digit
        value >>= 1
        shift += 1
    return digits
