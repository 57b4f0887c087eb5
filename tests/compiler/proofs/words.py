"""What operations mean, as z3 has it: a node is a signed bit vector that holds all its values."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import z3

from pearl_marl.golden.tracing.nodes import Node

EFFORT = 3_000_000
"""What z3 may spend on one question, by its own count, which is the same on every machine."""


WIDEST = 192
"""Bits that hold every word of an environment."""


def size(node: Node) -> int:
    """Return the bits of a node as a signed word."""
    return node.bits + (node.low >= 0)


def fitted(word: Any, bits: int) -> Any:
    """Return a signed word of so many bits."""
    have = word.size()
    if have < bits:
        return z3.SignExt(bits - have, word)
    return z3.Extract(bits - 1, 0, word) if have > bits else word


def in_range(node: Node, word: Any) -> list[Any]:
    """Return what is known of a node's values."""
    facts = [word >= node.low, word <= node.high]
    return [*facts, word & ~node.ones == 0] if node.low >= 0 else facts


def always(goal: Any, facts: Iterable[Any]) -> bool:
    """Return whether ``goal`` follows from the facts; not when z3 does not find out."""
    goal = z3.simplify(goal)
    if z3.is_true(goal):
        return True
    solver = z3.SolverFor("QF_UFBV")
    solver.set("rlimit", EFFORT)
    solver.add(*facts, z3.Not(goal))
    return bool(solver.check() == z3.unsat)


def unknown_product(a: Any, b: Any) -> Any:
    """Return a product of which nothing is known but that the same factors have the same one."""
    assert a.size() + b.size() <= WIDEST
    wide = z3.BitVecSort(WIDEST)
    return z3.Function("times", wide, wide, wide)(fitted(a, WIDEST), fitted(b, WIDEST))


def operation(node: Node, args: Sequence[Any]) -> Any:
    """Return what an operation makes of its arguments."""
    bits, imm = size(node), node.imm
    wide = max([bits, *(a.size() for a in args)])
    words = [fitted(a, wide) for a in args]
    match node.op:
        case "constant":
            result = z3.BitVecVal(imm, bits)
        case "add":
            result = words[0] + words[1]
        case "sub":
            result = words[0] - words[1]
        case "mul":
            result = words[0] * words[1]
        case "sum":
            constant, weights = imm
            result = z3.BitVecVal(constant, wide)
            for (sign, shift), word in zip(weights, words, strict=True):
                result += sign * (word << shift)
        case "divide" | "modulo":
            divisor = z3.BitVecVal(imm, imm.bit_length() + 1)
            result = _divided(args[0], divisor)[node.op == "modulo"]
        case "divide_by" | "modulo_by":
            divisor = z3.If(args[1] < 1, z3.BitVecVal(1, args[1].size()), args[1])
            result = _divided(args[0], divisor)[node.op == "modulo_by"]
        case "and":
            result = words[0] & words[1]
        case "or":
            result = words[0] | words[1]
        case "xor":
            result = words[0] ^ words[1]
        case "invert":
            result = ~words[0]
        case "not":
            result = 1 - words[0]
        case "mask":
            result = -words[0]
        case "left":
            result = words[0] << imm
        case "right":
            result = fitted(args[0], max(wide, imm + 1)) >> imm
        case "left_by":
            result = words[0] << words[1]
        case "right_by":
            result = words[0] >> words[1]
        case "equal":
            result = _number(words[0] == words[1])
        case "less":
            result = _number(words[0] < words[1])
        case "choose":
            result = z3.If(args[0] == 1, words[1], words[2])
        case "table":
            result = z3.BitVecVal(imm[-1], bits)
            for i, entry in reversed(list(enumerate(imm[:-1]))):
                result = z3.If(args[0] == i, z3.BitVecVal(entry, bits), result)
        case "wrap":
            kept, signed = imm
            result = fitted(args[0], kept)
            result = result if signed else z3.ZeroExt(1, result)
        case "narrow":
            low, high = (z3.BitVecVal(end, wide) for end in imm)
            result = z3.If(words[0] < low, low, z3.If(words[0] > high, high, words[0]))
        case "join":
            result = z3.Concat(args[0], fitted(args[1], imm))
        case "word":
            result = args[0]
        case op:
            raise AssertionError(op)
    return fitted(result, bits)


def _number(condition: Any) -> Any:
    return z3.If(condition, z3.BitVecVal(1, 2), z3.BitVecVal(0, 2))


def _divided(a: Any, by: Any) -> tuple[Any, Any]:
    """Return quotient and rest, rounded down as Python does."""
    wide = max(a.size(), by.size()) + 1
    a, divisor = fitted(a, wide), fitted(by, wide)
    rest = z3.SRem(a, divisor)
    rest = z3.If(rest < 0, rest + divisor, rest)
    return (a - rest) / divisor, rest
