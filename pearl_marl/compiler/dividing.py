"""A division of a word by a word, as a subtraction for each bit of the quotient.

That is how one divides by hand: from the highest bit on, the divisor is taken off what is left if it fits in.
The scheduler puts as many of these steps into a stage as its clock allows. Nothing is asked of the divisor:
if it is 0 the quotient is some other number, which is not used.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from pearl_marl.golden.tracing.graph import Graph
from pearl_marl.golden.tracing.nodes import Node

MOST_BITS = 6
"""Bits of two words together up to which a division is a table."""

Total = Callable[[Sequence[tuple[int, Node]], int, int], Node]
"""Makes the sum of signed words and a constant, of which so many bits are used."""


def divided(graph: Graph, a: Node, by: Node, total: Total) -> tuple[Node, Node]:
    """Return ``a // by`` and ``a % by``, rounded down, where ``by`` is 1 or more."""
    if a.bits + by.bits <= MOST_BITS:
        return _tables(graph, a, by)
    if a.low >= 0:
        return _steps(graph, a, by, total)
    # What is below 0 is divided as its complement, -1 - a, which is at least 0 and has one bit less.
    sign = graph.wrap(graph.right(a, a.bits - 1), 1, False)
    turned = graph.mask(sign)
    whole = graph.wrap(graph.xor(a, turned), a.bits - 1, False)
    quotient, rest = _steps(graph, whole, by, total)
    beyond = total([(1, by), (-1, rest)], -1, by.bits)
    return graph.xor(quotient, turned), graph.choose(sign, graph.wrap(beyond, by.bits, False), rest)


def _steps(graph: Graph, a: Node, by: Node, total: Total) -> tuple[Node, Node]:
    """Return quotient and remainder of a word that is not negative."""
    rest, quotient = graph.constant(0), graph.constant(0)
    for k in reversed(range(a.bits)):
        bit = graph.wrap(graph.right(a, k), 1, False)
        whole = _joined(graph, rest, bit)
        if whole.high < by.low:  # it fits in nowhere
            rest, fits = whole, graph.constant(0)
        else:
            bits = by.bits + 1  # it is from -by to by - 1, since what was left is less than the divisor
            less = total([(1, whole), (-1, by)], 0, bits)
            below = graph.wrap(graph.right(less, bits - 1), 1, False)
            bits = min(whole.bits, by.bits)
            rest = graph.choose(below, *(graph.wrap(x, bits, False) for x in (whole, less)))
            fits = graph.logical_not(below)
        quotient = _joined(graph, quotient, fits)
    return quotient, rest


def _joined(graph: Graph, upper: Node, bit: Node) -> Node:
    return bit if upper.is_constant(0) else graph.make("join", upper, bit, imm=1)


def _tables(graph: Graph, a: Node, by: Node) -> tuple[Node, Node]:
    values = range(1 << a.bits), range(1 << by.bits)
    dividends = [x - (1 << a.bits) if a.low < 0 and x >> (a.bits - 1) else x for x in values[0]]
    pairs = [divmod(x, max(1, y)) for x in dividends for y in values[1]]
    index = graph.make("join", graph.wrap(a, a.bits, False), by, imm=by.bits)
    quotient, rest = (graph.table(entries, index) for entries in zip(*pairs, strict=True))
    return quotient, rest
