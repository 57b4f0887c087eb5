"""Which bits of a node a kernel has to make right.

Hardware makes a word of no more bits than it has, so what lies beyond them is nothing. A kernel's word has
8 to 64, and unless it is right as a whole, what lies beyond the bits that are asked for is anything. So who
asks for a bit that is 0 by a node's range, or that is its sign, asks for all of the node.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from pearl_marl.golden.tracing.nodes import Node

EVERY = -1
"""All bits of a word."""


def kernel_bits(order: Sequence[Node], outputs: Iterable[tuple[Node, int]]) -> dict[Node, int]:
    """Return the bits of each node that have to be right, given the outputs and their widths."""
    asked = dict.fromkeys(order, 0)

    def ask(nodes: Iterable[Node], bits: int) -> None:
        for node in nodes:
            asked[node] |= bits

    for node, bits in outputs:
        ask([node], (1 << bits) - 1)
    for node in reversed(order):
        own, bits = (1 << node.bits) - 1, asked[node]
        zeros = ~node.ones if node.low >= 0 else 0
        if bits >> (node.bits - 1) or bits & zeros & own:
            bits = EVERY
        asked[node] = bits & own
        below = EVERY if bits == EVERY else (1 << bits.bit_length()) - 1
        match node.op:
            case "add" | "sub" | "mul":
                ask(node.args, below)
            case "and":
                a, b = node.args
                for x, y in ((a, b), (b, a)):
                    ask([x], bits & (y.imm if y.is_constant() else EVERY))
            case "or" | "xor" | "invert" | "narrow":
                ask(node.args, bits)
            case "choose":
                ask(node.args[:1], 1)
                ask(node.args[1:], bits)
            case "wrap":
                ask(node.args, bits & (1 << node.imm[0]) - 1)
            case "left":
                ask(node.args, bits >> node.imm)
            case "right":
                ask(node.args, bits << node.imm)
            case "mask" | "not":
                ask(node.args, 1)
            case "left_by":
                ask(node.args[:1], below)
                ask(node.args[1:], EVERY)
            case _:
                ask(node.args, EVERY)
    return asked
