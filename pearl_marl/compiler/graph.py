"""The graph of a golden step: integers, what each is made of, and all that is known of their values.

A node's range is exact where it depends on few bits: such a node has its *function*, an array of its values over the
words it depends on, and two nodes of one function are one node. Elsewhere its range is an interval, and the bits
that can be set are known. Operations are simplified as they are made, by what is known of their arguments.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from pearl_marl.compiler.operations import RANGES, VALUES, bits_of, word_range, wrapped

MOST_CASES = 1 << 13
"""Values up to which a node's function is written out."""
MOST_VALUES = 64
"""Values up to which a node can be an axis of functions."""
SAFE = 1 << 61
"""Functions are made of 64-bit integers."""


class Function(NamedTuple):
    """All values of a node: an array with an axis for each free word, whose numbers are ``axes``."""

    axes: tuple[int, ...]
    values: npt.NDArray[np.int64]


@dataclass(eq=False, slots=True, repr=False)
class Node:
    """One integer of a graph."""

    op: str
    args: tuple[Node, ...]
    imm: Any
    low: int
    high: int
    ones: int
    """The bits that can be set, if it is never negative."""
    number: int
    function: Function | None = None
    axis: int | None = None
    name: str | None = None
    line: int | None = None
    """Where in the author's file it was made."""

    def __repr__(self) -> str:
        return f"{self.name or (self.imm if self.op == 'input' else self.op)}_{self.number}[{self.low}..{self.high}]"

    @property
    def bits(self) -> int:
        """The width that holds all its values."""
        return bits_of(self.low, self.high)

    @property
    def is_flag(self) -> bool:
        """Whether it is always 0 or 1."""
        return self.low >= 0 and self.high <= 1

    def is_constant(self, value: int | None = None) -> bool:
        """Return whether it is a constant, and this one if a value is given."""
        return self.op == "constant" and (value is None or self.imm == value)


class Graph:
    """Makes nodes, each once; ``exact`` ones know their functions."""

    def __init__(self, exact: bool = True) -> None:
        self.exact = exact
        self.line: Callable[[], int | None] = lambda: None
        """Says where the author is."""
        self._nodes: dict[tuple[Any, ...], Node] = {}
        self._same: dict[tuple[Any, ...], Node] = {}
        self._domains: list[npt.NDArray[np.int64]] = []
        self._numbers = itertools.count()

    def constant(self, value: int) -> Node:
        value = int(value)
        key = ("constant", (), value)
        if key not in self._nodes:
            function = Function((), np.array(value)) if abs(value) < SAFE else None
            self._nodes[key] = self._new("constant", (), value, (value, value), max(value, 0), function)
        return self._nodes[key]

    def input(self, name: str, bits: int, signed: bool = False) -> Node:
        """Return a free word."""
        key = ("input", (), name)
        if key not in self._nodes:
            low, high = word_range(bits, signed)
            node = self._nodes[key] = self._new("input", (), name, (low, high), high)
            self.free(node)
        return self._nodes[key]

    def free(self, node: Node) -> None:
        """Forget how a node of few values came about: what is made of it has it as a free word."""
        self._make_axis(node)
        if node.axis is not None:
            node.function = Function((node.axis,), self._domains[node.axis])

    def make(self, op: str, *args: Node, imm: Any = None, like: Node | None = None) -> Node:
        """Return the node of an operation as it stands; the methods below simplify it first.

        Where ``like`` is given, its values are known to be among those of that node.
        """
        key = (op, args, imm)
        if key in self._nodes:
            return self._nodes[key]
        low, high = RANGES[op](imm, *args)
        if like is not None:
            low, high = max(low, like.low), min(high, like.high)
        ones = _ones(op, imm, args, high) & (-1 if like is None or like.low < 0 else like.ones)
        function = self._function(op, imm, args, low, high)
        if function is not None:
            low, high = max(low, int(function.values.min())), min(high, int(function.values.max()))
            ones &= int(np.bitwise_or.reduce(function.values, None)) if low >= 0 else -1
            same = function.axes, function.values.tobytes()
        if low >= 0:
            high = min(high, ones)
        if low == high:
            node = self.constant(low)
        elif function is not None and same in self._same:
            node = self._same[same]
        else:
            node = self._new(op, args, imm, (low, high), ones & ((1 << max(high, 0).bit_length()) - 1), function)
            if function is not None:
                self._same[same] = node
            else:
                self._make_axis(node)
        self._nodes[key] = node
        return node

    def _new(
        self, op: str, args: tuple[Node, ...], imm: Any, range_: tuple[int, int], ones: int, function: Any = None
    ) -> Node:
        return Node(op, args, imm, *range_, ones, next(self._numbers), function, line=self.line())

    def _make_axis(self, node: Node) -> None:
        if self.exact and node.axis is None and node.high - node.low < MOST_VALUES and node.op != "constant":
            found = node.function
            values = np.arange(node.low, node.high + 1) if found is None else np.unique(found.values)
            node.axis = len(self._domains)
            self._domains.append(values)
            if found is None:
                node.function = Function((node.axis,), values)

    def _function(self, op: str, imm: Any, args: Sequence[Node], low: int, high: int) -> Function | None:
        """Return the function of an operation on nodes that have one, if it has few enough values."""
        functions = [a.function for a in args]
        if not self.exact or None in functions or max(-low, high, *(max(-a.low, a.high) for a in args)) >= SAFE:
            return None
        # Of too many words together, those that hold intermediate results are taken as free ones.
        while self._cases(functions) > MOST_CASES:
            made = [a for a, f in zip(args, functions, strict=True) if a.op != "constant" and f.axes != (a.axis,)]  # type: ignore[union-attr]
            made = [a for a in made if a.high - a.low < MOST_VALUES]
            if not made:
                return None
            largest = max(made, key=lambda a: a.function.values.size)  # type: ignore[union-attr]
            self._make_axis(largest)
            assert largest.axis is not None
            whole = Function((largest.axis,), self._domains[largest.axis])
            functions = [whole if a is largest else f for a, f in zip(args, functions, strict=True)]
        axes = self._axes(functions)
        sizes = [len(self._domains[axis]) for axis in axes]
        arrays = [
            f.values.reshape([size if axis in f.axes else 1 for axis, size in zip(axes, sizes, strict=True)])
            for f in functions
            if f is not None
        ]
        values = np.broadcast_to(VALUES[op](imm, *arrays), sizes).astype(np.int64)
        kept = [i for i in range(len(axes)) if not (values == values.take([0], i)).all()]
        values = values[tuple(slice(None) if i in kept else 0 for i in range(len(axes)))]
        return Function(tuple(axes[i] for i in kept), np.ascontiguousarray(values))

    def _axes(self, functions: Iterable[Function | None]) -> list[int]:
        return sorted({axis for f in functions if f is not None for axis in f.axes})

    def _cases(self, functions: Iterable[Function | None]) -> int:
        cases = 1
        for axis in self._axes(functions):
            cases *= len(self._domains[axis])
        return cases

    # ---- operations, simplified

    def flag_of_mask(self, a: Node) -> Node | None:
        """Return the flag that ``a`` is 0 or -1 by, if it is."""
        if a.op == "mask":
            return a.args[0]
        return self.wrap(a, 1, False) if a.low >= -1 and a.high <= 0 else None

    def mask(self, flag: Node) -> Node:
        """Return -1 where a flag is set, and 0."""
        return self.constant(-flag.imm) if flag.is_constant() else self.make("mask", flag)

    def wrap(self, a: Node, bits: int, signed: bool) -> Node:
        low, high = word_range(bits, signed)
        if low <= a.low and a.high <= high:
            return a
        if a.is_constant():
            return self.constant(wrapped(a.imm, bits, signed))
        if a.op == "wrap" and a.imm[0] >= bits:
            return self.wrap(a.args[0], bits, signed)
        if a.op == "mask" and bits == 1 and not signed:
            return a.args[0]
        if a.op == "left" and a.imm >= bits:
            return self.constant(0)
        if a.op in ("add", "sub", "mul", "and", "or", "xor", "invert"):
            args = [x.args[0] if x.op == "wrap" and x.imm[0] >= bits else x for x in a.args]
            if any(x is not y for x, y in zip(args, a.args, strict=True)):
                return self.wrap(self.again(a, args), bits, signed)
        if not signed and a.low >= 0 and not a.ones & ((1 << bits) - 1):
            return self.constant(0)
        return self.make("wrap", a, imm=(bits, signed))

    def add(self, a: Node, b: Node) -> Node:
        if a.is_constant():
            a, b = b, a
        if b.is_constant(0):
            return a
        if b.is_constant(-1) and a.is_flag:
            return self.mask(self.logical_not(a))
        if b.op == "mask":
            return self.sub(a, b.args[0])
        if a.op == "mask":
            return self.sub(b, a.args[0])
        if b.is_constant() and a.op == "add" and a.args[1].is_constant():
            return self.add(a.args[0], self.constant(a.args[1].imm + b.imm))
        if b.is_constant() and a.op == "sub" and a.args[0].is_constant():
            return self.sub(self.constant(a.args[0].imm + b.imm), a.args[1])
        if a.low >= 0 and b.low >= 0 and not a.ones & b.ones:
            return self.or_(a, b)
        return self._ordered("add", a, b)

    def sub(self, a: Node, b: Node) -> Node:
        if b.is_constant():
            return self.add(a, self.constant(-b.imm))
        if a is b:
            return self.constant(0)
        if a.is_constant(0) and b.is_flag:
            return self.mask(b)
        if a.is_constant(1) and b.is_flag:
            return self.logical_not(b)
        if b.op == "mask":
            return self.add(a, b.args[0])
        return self.make("sub", a, b)

    def mul(self, a: Node, b: Node) -> Node:
        if a.is_constant():
            a, b = b, a
        if b.is_constant():
            value = b.imm
            if a.is_constant():
                return self.constant(a.imm * value)
            if value == 0:
                return b
            if value > 0 and value & (value - 1) == 0:
                return self.left(a, value.bit_length() - 1)
        for flag, other in ((a, b), (b, a)):
            if flag.is_flag:
                return self.choose(flag, other, self.constant(0))
        return self._ordered("mul", a, b)

    def floor_divide(self, a: Node, b: Node) -> Node:
        """Return ``a // b``; ``b`` is a constant from 1."""
        value = b.imm
        if a.is_constant():
            return self.constant(a.imm // value)
        if value & (value - 1) == 0:
            return self.right(a, value.bit_length() - 1)
        return self.make("divide", a, imm=value)

    def modulo(self, a: Node, b: Node) -> Node:
        """Return ``a % b``; ``b`` is a constant from 1."""
        value = b.imm
        if value & (value - 1) == 0:
            return self.wrap(a, value.bit_length() - 1, False) if value > 1 else self.constant(0)
        if 0 <= a.low and a.high < value:
            return a
        return self.sub(a, self.mul(self.floor_divide(a, b), b))

    def left(self, a: Node, by: int) -> Node:
        if by == 0:
            return a
        if a.is_constant():
            return self.constant(a.imm << by)
        if a.op == "left":
            return self.left(a.args[0], a.imm + by)
        return self.make("left", a, imm=by)

    def right(self, a: Node, by: int) -> Node:
        if by == 0:
            return a
        if a.is_constant():
            return self.constant(a.imm >> by)
        if a.op == "right":
            return self.right(a.args[0], a.imm + by)
        if a.op == "left":
            inner = a.args[0]
            return self.right(inner, by - a.imm) if by >= a.imm else self.left(inner, a.imm - by)
        if a.op == "mask":
            return a
        if a.low >= 0 and not a.ones >> by:
            return self.constant(0)
        if a.op == "or":
            x, y = (self.right(arg, by) for arg in a.args)
            if x.is_constant() or y.is_constant():
                return self.or_(x, y)
        return self.make("right", a, imm=by)

    def left_by(self, a: Node, by: Node) -> Node:
        return self.left(a, by.imm) if by.is_constant() else self.make("left_by", a, by)

    def right_by(self, a: Node, by: Node) -> Node:
        return self.right(a, by.imm) if by.is_constant() else self.make("right_by", a, by)

    def and_(self, a: Node, b: Node) -> Node:
        if a.is_constant():
            a, b = b, a
        if a is b:
            return a
        if b.is_constant():
            if a.is_constant():
                return self.constant(a.imm & b.imm)
            if b.imm == 0:
                return b
            if b.imm == -1 or (a.low >= 0 and a.ones & ~b.imm == 0):
                return a
            if b.imm > 0 and b.imm & (b.imm + 1) == 0:
                return self.wrap(a, b.imm.bit_length(), False)
        for x, y in ((a, b), (b, a)):
            if x.op == "wrap" and y.low >= 0 and y.high <= word_range(*x.imm)[1]:
                return self.and_(x.args[0], y)
            if x.op == "mask":
                other = self.flag_of_mask(y)
                if other is not None:
                    return self.mask(self.and_(x.args[0], other))
                return self.choose(x.args[0], y, self.constant(0))
            if x.op == "not" and x.args[0] is y:
                return self.constant(0)
        if a.low >= 0 and b.low >= 0 and not a.ones & b.ones:
            return self.constant(0)
        return self._ordered("and", a, b)

    def or_(self, a: Node, b: Node) -> Node:
        if a.is_constant():
            a, b = b, a
        if a is b:
            return a
        if b.is_constant():
            if a.is_constant():
                return self.constant(a.imm | b.imm)
            if b.imm == 0:
                return a
            if b.imm == -1:
                return b
        x, y = self.flag_of_mask(a), self.flag_of_mask(b)
        if x is not None and y is not None:
            return self.mask(self.or_(x, y))
        # A choice by masks, of which one is the other's complement.
        if a.op == b.op == "choose" and a.args[2].is_constant(0) and b.args[2].is_constant(0):
            p, q = a.args[0], b.args[0]
            if self.logical_not(p) is q:
                return self.choose(p, a.args[1], b.args[1])
        return self._ordered("or", a, b)

    def xor(self, a: Node, b: Node) -> Node:
        if a.is_constant():
            a, b = b, a
        if a is b:
            return self.constant(0)
        if b.is_constant():
            if a.is_constant():
                return self.constant(a.imm ^ b.imm)
            if b.imm == 0:
                return a
            if b.imm == -1:
                return self.invert(a)
            if b.imm == 1 and a.is_flag:
                return self.logical_not(a)
        x, y = self.flag_of_mask(a), self.flag_of_mask(b)
        if x is not None and y is not None:
            return self.mask(self.xor(x, y))
        for x, y in ((a, b), (b, a)):
            # x ^ ((x ^ other) & mask) is a choice.
            if y.op == "choose" and y.args[2].is_constant(0) and y.args[1].op == "xor" and x in y.args[1].args:
                p, q = y.args[1].args
                return self.choose(y.args[0], q if p is x else p, x)
        return self._ordered("xor", a, b)

    def invert(self, a: Node) -> Node:
        if a.is_constant():
            return self.constant(~a.imm)
        if a.op == "invert":
            return a.args[0]
        flag = self.flag_of_mask(a)
        return self.make("invert", a) if flag is None else self.mask(self.logical_not(flag))

    def logical_not(self, a: Node) -> Node:
        if a.is_constant():
            return self.constant(1 - a.imm)
        return a.args[0] if a.op == "not" else self.make("not", a)

    def equal(self, a: Node, b: Node) -> Node:
        if a is b:
            return self.constant(1)
        if a.is_constant():
            a, b = b, a
        if a.high < b.low or b.high < a.low:
            return self.constant(0)
        if b.is_constant():
            if a.is_flag:
                return a if b.imm else self.logical_not(a)
            if a.op == "mask":
                return a.args[0] if b.imm else self.logical_not(a.args[0])
        return self._ordered("equal", a, b)

    def less(self, a: Node, b: Node) -> Node:
        if a is b or a.low >= b.high:
            return self.constant(0)
        if a.high < b.low:
            return self.constant(1)
        # Against a constant that all but one value are on one side of.
        if b.is_constant():
            if b.imm == a.low + 1:
                return self.equal(a, self.constant(a.low))
            if b.imm == a.high:
                return self.logical_not(self.equal(a, b))
        if a.is_constant():
            if a.imm == b.high - 1:
                return self.equal(b, self.constant(b.high))
            if a.imm == b.low:
                return self.logical_not(self.equal(b, a))
        return self.make("less", a, b)

    def choose(self, flag: Node, a: Node, b: Node) -> Node:
        """Return ``a`` where the flag is set, else ``b``."""
        if flag.is_constant():
            return a if flag.imm else b
        if a is b:
            return a
        if flag.op == "not":
            return self.choose(flag.args[0], b, a)
        if a.is_flag and b.is_flag:
            if b.is_constant(0):
                return self.and_(flag, a)
            if a.is_constant(0):
                return self.and_(self.logical_not(flag), b)
            if a.is_constant(1):
                return self.or_(flag, b)
            if b.is_constant(1):
                return self.or_(self.logical_not(flag), a)
        if a.op == "choose" and a.args[0] is flag:
            return self.choose(flag, a.args[1], b)
        if b.op == "choose" and b.args[0] is flag:
            return self.choose(flag, a, b.args[2])
        return self.make("choose", flag, a, b)

    def minimum(self, a: Node, b: Node) -> Node:
        return a if a.high <= b.low else b if b.high <= a.low else self.choose(self.less(a, b), a, b)

    def maximum(self, a: Node, b: Node) -> Node:
        return b if a.high <= b.low else a if b.high <= a.low else self.choose(self.less(a, b), b, a)

    def table(self, entries: Sequence[int], index: Node) -> Node:
        """Return the entry of a constant table; the index is never beyond it."""
        entries = tuple(entries)[: index.high + 1]
        return self.constant(entries[index.imm]) if index.is_constant() else self.make("table", index, imm=entries)

    def _ordered(self, op: str, a: Node, b: Node) -> Node:
        """Return the node of an operation whose arguments may change places, a constant last."""
        return self.make(op, *((a, b) if b.is_constant() or a.number < b.number else (b, a)))

    def again(self, node: Node, args: Sequence[Node]) -> Node:
        """Return a node's operation on other arguments, simplified."""
        if all(x is y for x, y in zip(args, node.args, strict=True)):
            return node
        match node.op:
            case "left" | "right":
                result: Node = getattr(self, node.op)(*args, node.imm)
            case "wrap":
                result = self.wrap(*args, *node.imm)
            case "divide":
                result = self.floor_divide(*args, self.constant(node.imm))
            case "table":
                result = self.table(node.imm, *args)
            case op:
                result = getattr(self, _METHODS.get(op, op))(*args)
        if result.name is None and result.op != "constant":
            result.name, result.line = node.name, node.line
        return result


_METHODS = {"and": "and_", "or": "or_", "not": "logical_not"}


def _ones(op: str, imm: Any, args: Sequence[Node], high: int) -> int:
    """Return the bits that a result can have set, if it is never negative."""
    every = (1 << max(high, 0).bit_length()) - 1
    known = [a.ones for a in args if a.low >= 0]
    if op == "and" and known:
        return every & (known[0] & known[1] if len(known) == 2 else known[0])
    if len(known) < len(args):
        return every
    match op:
        case "or" | "xor":
            return every & (known[0] | known[1])
        case "choose":
            return every & (known[1] | known[2])
        case "left":
            return every & known[0] << int(imm)
        case "right":
            return every & known[0] >> int(imm)
        case "wrap":
            return every & known[0]
    return every


def in_order(roots: Iterable[Node]) -> list[Node]:
    """Return all nodes that the roots are made of, each after its arguments."""
    order: list[Node] = []
    seen: set[Node] = set()
    stack = [(root, False) for root in reversed(list(roots))]
    while stack:
        node, done = stack.pop()
        if done:
            order.append(node)
        elif node not in seen:
            seen.add(node)
            stack.append((node, True))
            stack += ((arg, False) for arg in reversed(node.args) if arg not in seen)
    return order
