"""What is better made of one product: two digits of a draw, or a rounded product and what is added to it.

Each is a pass before lowering, in the same graph, and returns what each node has become: an equal one.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

from pearl_marl.golden.tracing.graph import Graph
from pearl_marl.golden.tracing.nodes import Node, in_order

MOST_DIGITS = 64
"""Values up to which a quotient is a table."""


def digits_joined(graph: Graph, roots: Sequence[Node]) -> dict[Node, Node]:
    """Take two digits of a draw, ``x * a >> n`` and ``(x * a % 2**n) * b >> n``, from ``x * a * b >> n``."""
    order = in_order(roots)
    pairs: dict[Node, tuple[Node, Node, int]] = {}  # either product: both of them, and n
    for second in filter(_is_scaled, order):
        rest = second.args[0]
        if rest.op != "wrap" or rest.imm[1] or not _is_scaled(rest.args[0]):
            continue
        first, (bits, _) = rest.args[0], rest.imm
        most = first.high * second.args[1].imm >> bits
        if first not in pairs and first.low >= 0 and 0 <= most < MOST_DIGITS:
            pairs[first] = pairs[second] = first, second, bits
    made: dict[Node, Node] = {}
    for node in order:
        made[node] = graph.within(graph.again(node, [made[a] for a in node.args]), node.low, node.high)
        product = node.args[0] if node.op in ("right", "wrap") else None
        if product is None or product not in pairs:
            continue
        first, second, bits = pairs[product]
        a, b = first.args[1].imm, second.args[1]
        whole = graph.mul(made[first.args[0]], graph.constant(a * b.imm))
        if node.op == "wrap" and product is second and node.imm[0] <= bits:
            made[node] = graph.wrap(whole, *node.imm)
        elif node.op == "right" and node.imm == bits:
            digit = graph.floor_divide if product is first else graph.modulo
            made[node] = digit(graph.right(whole, bits), b)
            made[node].name, made[node].line = node.name, node.line
    return made


def _is_scaled(node: Node) -> bool:
    return node.op == "mul" and node.args[1].is_constant()


def rounding_joined(graph: Graph, roots: Sequence[Node]) -> dict[Node, Node]:
    """Let what is added to a rounded product join the product's own sum, for one carry chain less."""
    uses = Counter(arg for node in in_order(roots) for arg in node.args)
    products: set[Node] = set()  # what is a product, or a sum of some
    made: dict[Node, Node] = {}
    for node in in_order(roots):
        args = [made[a] for a in node.args]
        made[node] = graph.within(graph.again(node, args), node.low, node.high)
        if node.op == "mul" or (node.op in ("add", "sub", "right") and not products.isdisjoint(args)):
            products.add(made[node])
        for i, (x, y) in enumerate((args, args[::-1]) if node.op == "add" else ()):
            if x.op != "right" or uses[node.args[i]] > 1 or x not in products or y in products:
                continue
            made[node] = graph.right(graph.add(x.args[0], graph.left(y, x.imm)), x.imm)
            if made[node].name is None and not made[node].is_constant():
                made[node].name, made[node].line = node.name, node.line
            products.add(made[node])
            break
    return made
