"""The operations of golden functions, on nodes, simplified by what is known of their values."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from pearl_marl.golden.tracing.nodes import Node, Nodes
from pearl_marl.golden.tracing.operations import word_range, wrapped


class Graph(Nodes):
    """Nodes, and the operations that make others of them.

    ``early`` graphs compare what a choice is made of beside the choice, as hardware should, not after it,
    and choose once where a limit holds under a condition. A CPU is faster with the less or greater of two.
    """

    def __init__(self, exact: bool = True, early: bool = True) -> None:
        super().__init__(exact)
        self.early = early
        self._limited: set[Node] = set()
        """Choices of the less or the greater of two."""
        self.floats: Any = None
        """What words do that meet floats, by :func:`pearl_marl.golden.reals.admitted`; else ``None``."""

    def flag_of_mask(self, a: Node) -> Node | None:
        """Return the flag that ``a`` is 0 or -1 by, if it is."""
        if a.op == "mask":
            return a.args[0]
        return self.wrap(a, 1, False) if a.low >= -1 and a.high <= 0 else None

    def mask(self, flag: Node) -> Node:
        """Return -1 where a flag is set, and 0."""
        return self.constant(-flag.imm) if flag.is_constant() else self.make("mask", flag)

    def wrap(self, a: Node, bits: int, signed: bool) -> Node:
        """Return a node modulo ``2**bits``."""
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
        # Not of a product: beside the narrow one that has other users it would be a second one.
        if a.op in ("add", "sub", "and", "or", "xor", "invert"):
            args = [x.args[0] if x.op == "wrap" and x.imm[0] >= bits else x for x in a.args]
            if any(x is not y for x, y in zip(args, a.args, strict=True)):
                return self.wrap(self.again(a, args), bits, signed)
        if not signed and a.low >= 0 and not a.ones & ((1 << bits) - 1):
            return self.constant(0)
        return self.make("wrap", a, imm=(bits, signed))

    def add(self, a: Node, b: Node) -> Node:
        """Return ``a + b``."""
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
        # Of terms that exclude each other one is chosen: their sum is no larger than the largest.
        for x, y in ((a, b), (b, a)):
            if x.op == y.op == "choose" and y.args[2].is_constant(0) and self.exclude(x.args[0], y.args[0]):
                return self.choose(x.args[0], x.args[1], self.add(x.args[2], y))
        return self._ordered("add", a, b)

    def exclude(self, a: Node, b: Node) -> bool:
        """Return whether two flags are never set together, as far as that is known."""
        if a.op == b.op == "equal" and a.args[0] is b.args[0]:
            return a.args[1].is_constant() and b.args[1].is_constant() and a is not b
        return self.and_(a, b).is_constant(0)

    def sub(self, a: Node, b: Node) -> Node:
        """Return ``a - b``."""
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
        """Return ``a * b``."""
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
        """Return ``a // b``; ``b`` is 1 or more where the quotient is used."""
        if not b.is_constant():
            if a.is_constant(0) or (a.low >= 0 and a.high < b.low):
                return self.constant(0)
            return self.make("divide_by", a, b)
        value = max(1, b.imm)
        if a.is_constant():
            return self.constant(a.imm // value)
        if value & (value - 1) == 0:
            return self.right(a, value.bit_length() - 1)
        return self.make("divide", a, imm=value)

    def modulo(self, a: Node, b: Node) -> Node:
        """Return ``a % b``; ``b`` is 1 or more where the remainder is used."""
        if not b.is_constant():
            return a if a.low >= 0 and a.high < b.low else self.make("modulo_by", a, b)
        value = max(1, b.imm)
        if value & (value - 1) == 0:
            return self.wrap(a, value.bit_length() - 1, False) if value > 1 else self.constant(0)
        if a.low >= 0 and a.high < value:
            return a
        return self.constant(a.imm % value) if a.is_constant() else self.make("modulo", a, imm=value)

    def left(self, a: Node, by: int) -> Node:
        """Return ``a << by``, by a number."""
        if by == 0:
            return a
        if a.is_constant():
            return self.constant(a.imm << by)
        if a.op == "left":
            return self.left(a.args[0], a.imm + by)
        return self.make("left", a, imm=by)

    def right(self, a: Node, by: int) -> Node:
        """Return ``a >> by``, by a number."""
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
        """Return ``a << by``, by a node."""
        return self.left(a, by.imm) if by.is_constant() else self.make("left_by", a, by)

    def right_by(self, a: Node, by: Node) -> Node:
        """Return ``a >> by``, by a node."""
        return self.right(a, by.imm) if by.is_constant() else self.make("right_by", a, by)

    def and_(self, a: Node, b: Node) -> Node:
        """Return ``a & b``."""
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
        """Return ``a | b``."""
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
        if a.op == b.op == "choose" and a.args[0] is b.args[0]:
            for x, y in ((a, b), (b, a)):
                if x.args[2].is_constant(0) and y.args[1].is_constant(0):
                    return self.choose(a.args[0], x.args[1], y.args[2])
        return self._ordered("or", a, b)

    def xor(self, a: Node, b: Node) -> Node:
        """Return ``a ^ b``."""
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
            if (
                y.op == "choose"
                and y.args[2].is_constant(0)
                and y.args[1].op == "xor"
                and x in y.args[1].args
            ):
                p, q = y.args[1].args
                return self.choose(y.args[0], q if p is x else p, x)
        return self._ordered("xor", a, b)

    def invert(self, a: Node) -> Node:
        """Return ``~a``."""
        if a.is_constant():
            return self.constant(~a.imm)
        if a.op == "invert":
            return a.args[0]
        flag = self.flag_of_mask(a)
        return self.make("invert", a) if flag is None else self.mask(self.logical_not(flag))

    def logical_not(self, a: Node) -> Node:
        """Return the opposite of a flag."""
        if a.is_constant():
            return self.constant(1 - a.imm)
        return a.args[0] if a.op == "not" else self.make("not", a)

    def equal(self, a: Node, b: Node) -> Node:
        """Return whether ``a == b``."""
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
        """Return whether ``a < b``."""
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
        # A clipped word against a constant: no need to wait for the choice.
        for x, y in ((a, b), (b, a)) if self.early else ():
            if (
                x.op == "choose"
                and x.function is None
                and y.is_constant()
                and any(arg.is_constant() for arg in x.args[1:])
            ):
                flag, *words = x.args
                return self.choose(flag, *(self.less(w, y) if x is a else self.less(y, w) for w in words))
        return self.make("less", a, b)

    def choose(self, flag: Node, a: Node, b: Node) -> Node:
        """Return ``a`` where the flag is set, else ``b``."""
        if flag.is_constant():
            return a if flag.imm else b
        if a is b:
            return a
        if flag.op == "not":
            return self.choose(flag.args[0], b, a)
        x, y = self._arm(a, flag, True), self._arm(b, flag, False)
        if x is not a or y is not b:
            return self.choose(flag, x, y)
        if a.is_flag and b.is_flag:
            if b.is_constant(0):
                return self.and_(flag, a)
            if a.is_constant(0):
                return self.and_(self.logical_not(flag), b)
            if a.is_constant(1):
                return self.or_(flag, b)
            if b.is_constant(1):
                return self.or_(self.logical_not(flag), a)
        for inner, other in ((a, b), (b, a)) if self.early else ():
            if inner in self._limited and other in inner.args[1:]:  # one choice, by both flags
                there = flag if inner is a else self.logical_not(flag)
                also, x, y = inner.args
                if other is x:
                    also, x = self.logical_not(also), y
                node = self.choose(self.and_(there, also), x, other)
                return self.within(node, min(a.low, b.low), max(a.high, b.high))
        return self.make("choose", flag, a, b)

    def _arm(self, arm: Node, flag: Node, holds: bool) -> Node:
        """Return what a node is where a flag is known to hold, or not to."""
        if arm is flag:
            return self.constant(int(holds))
        if arm.op == "not" and arm.args[0] is flag:
            return self.constant(int(not holds))
        if arm.op == "choose":
            inner, a, b = arm.args
            if inner is flag:
                return a if holds else b
            if inner.op in ("and", "or") and flag in inner.args:
                if holds == (inner.op == "or"):
                    return a if holds else b
                other = inner.args[inner.args[0] is flag]
                if other.is_flag:  # it may be a word of which the flag takes one bit
                    return self.choose(other, a, b)
        return arm

    def minimum(self, a: Node, b: Node) -> Node:
        """Return the less of two."""
        return self._extreme(min, a, b, a, b)

    def maximum(self, a: Node, b: Node) -> Node:
        """Return the greater of two."""
        return self._extreme(max, a, b, b, a)

    def _extreme(
        self, of: Callable[[int, int], int], a: Node, b: Node, where_less: Node, where_not: Node
    ) -> Node:
        """Return one of two nodes where ``a`` is less than ``b``, else the other; ``of`` finds its range."""
        if a.high <= b.low or b.high <= a.low:
            return where_less if a.high <= b.low else where_not
        node = self.choose(self.less(a, b), where_less, where_not)
        if node.op == "choose":
            self._limited.add(node)
        return self.within(node, of(a.low, b.low), of(a.high, b.high))

    def narrow(self, a: Node, low: int, high: int) -> Node:
        """Return ``a`` with the range that it is known to have wherever the result is used."""
        ends = max(low, a.low), min(high, a.high)
        if ends == (a.low, a.high):
            return a
        if ends[0] >= ends[1]:  # it is not used where it is out of the range
            return self.constant(min(max(a.low, low), high))
        return self.make("narrow", a.args[0] if a.op == "narrow" else a, imm=ends)

    def table(self, entries: Sequence[int], index: Node) -> Node:
        """Return the entry of a constant table; entries beyond its end are not used."""
        if index.low < 0 or index.high >= len(entries):
            bits = max(1, (len(entries) - 1).bit_length())
            index = self.wrap(index, bits, False)
            entries = (*entries, *[entries[-1]] * ((1 << bits) - len(entries)))
        entries = tuple(entries)[: index.high + 1]
        if index.is_constant():
            return self.constant(entries[index.imm])
        return self.make("table", index, imm=entries)

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
            case "left_by" | "right_by":  # what is held may have become anything
                result = getattr(self, node.op)(args[0], self.wrap(args[1], node.args[1].bits, False))
            case "divide_by" | "modulo_by":
                divided = self.floor_divide if node.op == "divide_by" else self.modulo
                result = divided(args[0], self.wrap(args[1], node.args[1].bits, False))
            case "wrap" | "narrow":
                result = getattr(self, node.op)(args[0], *node.imm)
            case "divide":
                result = self.floor_divide(args[0], self.constant(node.imm))
            case "modulo":
                result = self.modulo(args[0], self.constant(node.imm))
            case "table":
                result = self.table(node.imm, args[0])
            case op:
                result = getattr(self, _METHODS.get(op, op))(*args)
        if not node.loose:
            result.loose = False
        if result.name is None and result.op != "constant":
            result.name, result.line = node.name, node.line
        return result


_METHODS = {"and": "and_", "or": "or_", "not": "logical_not"}
