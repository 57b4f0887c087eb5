"""Nodes as polynomials of integers, which shows that products made of parts are products.

A word cut at bit k is ``2**k * right + (word - 2**k * right)``, so that its parts, put together again, cancel
out, whatever was multiplied in between; that is what z3 does not find among bits.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable
from itertools import pairwise
from typing import Any, NamedTuple

from pearl_marl.golden.tracing.nodes import Node

Polynomial = dict[tuple[Hashable, ...], int]
"""The factor of each product of atoms; an atom is whatever it is known by."""


LONGEST = 64
"""Terms of a polynomial; what takes more was looked into too deeply."""


class TooLongError(Exception):
    """A polynomial of too many terms."""


class Right(NamedTuple):
    """The atom ``value >> by``."""

    by: int
    value: tuple[tuple[tuple[Hashable, ...], int], ...]


def _terms(a: Polynomial) -> tuple[tuple[tuple[Hashable, ...], int], ...]:
    return tuple(sorted(a.items(), key=repr))


def constant(value: int) -> Polynomial:
    """Return a number."""
    return {(): value} if value else {}


def atom(name: Hashable) -> Polynomial:
    """Return an integer of which nothing is known."""
    return {(name,): 1}


def plus(a: Polynomial, b: Polynomial, factor: int = 1) -> Polynomial:
    """Return ``a + factor * b``."""
    result = dict(a)
    for term, value in b.items():
        result[term] = result.get(term, 0) + factor * value
    return {term: value for term, value in result.items() if value}


def times(a: Polynomial, b: Polynomial) -> Polynomial:
    """Return ``a * b``."""
    result: Polynomial = {}
    for x, m in a.items():
        for y, n in b.items():
            term = tuple(sorted((*x, *y), key=repr))
            result[term] = result.get(term, 0) + m * n
    if len(result) > LONGEST:
        raise TooLongError
    return {term: value for term, value in result.items() if value}


def right(a: Polynomial, by: int) -> Polynomial:
    """Return ``a >> by``: what is a multiple of ``2**by`` comes out, and the rest is an atom."""
    whole = {term: value >> by for term, value in a.items() if value >> by}
    rest = {term: value & (1 << by) - 1 for term, value in a.items() if value & (1 << by) - 1}
    terms = rest.keys() - {()}
    if not terms:
        return whole
    inner = min(
        (t for t in terms if rest[t] == 1 and len(t) == 1 and isinstance(t[0], Right)), key=repr, default=None
    )
    if inner is not None:  # shifted twice
        last = inner[0]
        del rest[inner]
        return plus(whole, right(plus(dict(last.value), rest, 1 << last.by), last.by + by))
    common = min((rest[term] & -rest[term]).bit_length() - 1 for term in terms)
    rest = {term: value >> common for term, value in rest.items() if value >> common}
    return plus(whole, atom(Right(by - common, _terms(rest))))


def polynomial(
    node: Node, known: Callable[[Node], Polynomial | None], made: dict[Node, Polynomial]
) -> Polynomial:
    """Return a node as a polynomial of known ones; what is none of anything is an atom by itself."""
    if node in made:
        return made[node]
    found = known(node)
    if found is None:
        nodes = [_index(node)] if node.op == "table" else node.args
        args: list[Any] = [polynomial(a, known, made) for a in nodes]
        found = _operation(node, args)
    made[node] = found
    return found


def _operation(node: Node, args: list[Polynomial]) -> Polynomial:
    imm = node.imm
    match node.op:
        case "constant":
            return constant(imm)
        case "add":
            return plus(args[0], args[1])
        case "or" if min(a.low for a in node.args) >= 0 and not node.args[0].ones & node.args[1].ones:
            return plus(args[0], args[1])
        case "sub":
            return plus(args[0], args[1], -1)
        case "mul":
            return times(args[0], args[1])
        case "sum":
            result = constant(imm[0])
            for (sign, shift), arg in zip(imm[1], args, strict=True):
                result = plus(result, arg, sign << shift)
            return result
        case "mask":
            return times(constant(-1), args[0])
        case "not":
            return plus(constant(1), args[0], -1)
        case "left":
            return times(constant(1 << imm), args[0])
        case "right":
            return right(args[0], imm)
        case "wrap":
            return _wrapped(node.args[0], args[0], *imm)
        case "join":
            return plus(_wrapped(node.args[1], args[1], imm, False), args[0], 1 << imm)
        case "word":
            return args[0]
        case "table":
            found = _line(node, args[0])
            if found is not None:
                return found
    bits = tuple(a.bits for a in node.args)
    return atom((node.op, repr(imm), bits, *(_terms(arg) for arg in args)))


def _index(table: Node) -> Node:
    """Return the word that a table is of, if it is of one that may be negative."""
    (index,) = table.args
    return index.args[0] if index.op == "wrap" and index.args[0].bits <= index.imm[0] else index


def _line(table: Node, index: Polynomial) -> Polynomial | None:
    """Return a table as a product, if it is one of few cases: ``first + step * index``."""
    word, bits = _index(table), table.args[0].bits
    at = [value & (1 << bits) - 1 for value in range(word.low, word.high + 1)]
    if max(at) >= len(table.imm):
        return None
    entries = [table.imm[k] for k in at]
    step = entries[1] - entries[0]
    if any(b - a != step for a, b in pairwise(entries)):
        return None
    return plus(constant(entries[0] - step * word.low), index, step)


def _wrapped(node: Node, value: Polynomial, bits: int, signed: bool) -> Polynomial:
    """Return a node of this value modulo ``2**bits``."""
    half = 1 << bits - 1 if signed else 0
    least, most = (node.low + half) >> bits, (node.high + half) >> bits
    beyond = constant(least) if least == most else right(plus(value, constant(half)), bits)
    return plus(value, beyond, -(1 << bits))
