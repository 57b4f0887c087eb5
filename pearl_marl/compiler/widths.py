"""Which bits of a node are used."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

from pearl_marl.golden.tracing.nodes import Node

WIRES = frozenset({"wrap", "left", "right", "join", "mask", "not", "invert"})
"""Operations that take no logic: which wire goes where, and inversions that tables take in."""


def used_bits(
    order: Sequence[Node], outputs: Iterable[tuple[Node, int]], words: bool = False
) -> dict[Node, int]:
    """Return the bits of each node that its users look at, given the outputs and their widths.

    Hardware makes a word of no more bits than it has, so what lies beyond them is nothing. A kernel's
    ``words`` have 8 to 64, and unless one is right as a whole, what lies beyond the bits that are asked for
    is anything. So who asks for a bit that is 0 by a node's range, or that is its sign, asks for all of it.
    """
    used = dict.fromkeys(order, 0)

    def ask(node: Node, bits: int) -> None:
        own = (1 << node.bits) - 1
        possible = own if node.low < 0 else node.ones
        if not words:
            bits &= possible
        elif bits >> (node.bits - 1) or bits & own & ~possible:
            bits = own
        used[node] |= bits

    def ask_signed(node: Node, bits: int) -> None:
        """Ask for bits of which those beyond the sign are the sign."""
        if node.low < 0 and bits >> node.bits:
            bits |= 1 << (node.bits - 1)
        ask(node, bits)

    for node, bits in outputs:
        ask_signed(node, (1 << bits) - 1)
    for node in reversed(order):
        bits = used[node]
        full = (1 << bits.bit_length()) - 1
        if words and bits >> (node.bits - 1):
            bits = full = -1
        match node.op:
            case "add" | "sub" | "mul":
                for arg in node.args:
                    ask_signed(arg, full)
            case "sum":
                for (_, shift), arg in zip(node.imm[1], node.args, strict=True):
                    ask_signed(arg, full >> shift)
            case "and":
                a, b = node.args
                for x, y in ((a, b), (b, a)):
                    known = y.imm if y.is_constant() else -1 if words or y.low < 0 else y.ones
                    ask_signed(x, bits & known)
            case "or" | "xor":
                for arg in node.args:
                    ask_signed(arg, bits)
            case "invert" | "word":
                ask_signed(node.args[0], bits)
            case "choose":
                ask(node.args[0], 1)
                for arg in node.args[1:]:
                    ask_signed(arg, bits)
            case "wrap":
                wide = node.imm[0]
                kept = bits & ((1 << wide) - 1)
                ask_signed(node.args[0], kept | (1 << (wide - 1) if bits >> wide else 0))
            case "left":
                ask_signed(node.args[0], bits >> node.imm)
            case "right":
                ask_signed(node.args[0], bits << node.imm)
            case "join":
                ask_signed(node.args[0], bits >> node.imm)
                ask(node.args[1], bits & ((1 << node.imm) - 1))
            case "narrow":  # cut to its own bits, of which the highest is its sign if it has one
                ask_signed(node.args[0], bits)
            case "mask" | "not":
                ask(node.args[0], 1)
            case "left_by":
                ask_signed(node.args[0], full)
                ask(node.args[1], -1)
            case _:
                for arg in node.args:
                    ask(arg, -1)
    return used


def width(node: Node, used: Mapping[Node, int]) -> int:
    """Return how many bits of a node are made: those up to the highest that is used."""
    return max(1, used[node].bit_length())
