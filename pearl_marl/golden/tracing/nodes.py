"""The nodes of a graph: integers, what each is made of, and all that is known of their values.

A node's range is exact where it depends on few bits: such a node has its *function*, an array of its values
over the words it depends on, and two nodes of one function are one node. Elsewhere its range is an interval,
and the bits that can be set are known.

What is known of a *loose* node holds only where the node is used: it is made of a word that is narrowed
down to what a branch has found it to be, and where the branch is not taken the node can be anything.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from pearl_marl.golden.tracing.operations import RANGES, VALUES, bits_of, word_range

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
    loose: bool = False
    """Whether it is a ``narrow``, or made of one: its value can be beyond its range where it is not used."""

    def __repr__(self) -> str:
        name = self.name or (self.imm if self.op == "input" else self.op)
        return f"{name}_{self.number}[{self.low}..{self.high}]"

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


class Nodes:
    """Makes nodes, each once; ``exact`` ones know their functions."""

    def __init__(self, exact: bool = True) -> None:
        self.exact = exact
        self.line: Callable[[], int | None] = lambda: None
        """Says where the author is."""
        self.known: Mapping[Node, Node] = {}
        """Nodes of which more is known where the author is, as narrower ones."""
        self.limits: Callable[[Node], tuple[int, int]] = lambda node: (node.low, node.high)
        """Says between what a node is where the author is."""
        self.certain = True
        """Whether the author's function always comes to where it is."""
        self.decided_in: int | None = None
        """The line that decides whether it does."""
        self.twins: Any = None
        """The lists of an author that may be one another: :class:`pearl_marl.golden.tracing.twins.Twins`."""
        self._nodes: dict[tuple[Any, ...], Node] = {}
        self._same: dict[tuple[Any, ...], Node] = {}
        self._domains: list[npt.NDArray[np.int64]] = []
        self._numbers = itertools.count()

    def constant(self, value: int) -> Node:
        """Return the node of a number."""
        value = int(value)
        key = ("constant", (), value)
        if key not in self._nodes:
            function = Function((), np.array(value)) if abs(value) < SAFE else None
            self._nodes[key] = self._new("constant", (), value, (value, value), max(value, 0), function)
        return self._nodes[key]

    def input(
        self, name: str, bits: int, signed: bool = False, low: int | None = None, high: int | None = None
    ) -> Node:
        """Return a free word, from ``low`` to ``high`` if it has not all values of its bits."""
        key = ("input", (), name)
        if key not in self._nodes:
            least, most = word_range(bits, signed)
            low, high = least if low is None else low, most if high is None else high
            ones = (1 << max(high, 0).bit_length()) - 1
            node = self._nodes[key] = self._new("input", (), name, (low, high), ones)
            self.free(node)
        return self._nodes[key]

    def free(self, node: Node) -> None:
        """Forget how a node of few values came about: what is made of it has it as a free word."""
        node.loose = False
        self._make_axis(node)
        if node.axis is not None:
            node.function = Function((node.axis,), self._domains[node.axis])

    def within(self, node: Node, low: int, high: int) -> Node:
        """Note that a node's values are within a range, which what it is made of does not tell."""
        if node.op != "constant":
            node.low, node.high = max(node.low, low), min(node.high, high)
            node.ones &= (1 << max(node.high, 0).bit_length()) - 1
        return node

    def make(self, op: str, *args: Node, imm: Any = None) -> Node:
        """Return the node of an operation as it stands."""
        key = (op, args, imm)
        if key in self._nodes:
            return self._nodes[key]
        low, high = RANGES[op](imm, *args)
        ones = _ones(op, imm, args, high)
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
            node = self._new(
                op, args, imm, (low, high), ones & ((1 << max(high, 0).bit_length()) - 1), function
            )
            if function is None:
                self._make_axis(node)
            elif not node.loose:  # of one function with another, it could still be wrong where that is right
                self._same[same] = node
        self._nodes[key] = node
        return node

    def _new(
        self,
        op: str,
        args: tuple[Node, ...],
        imm: Any,
        range_: tuple[int, int],
        ones: int,
        function: Any = None,
    ) -> Node:
        loose = op == "narrow" or any(a.loose for a in args)
        return Node(
            op, args, imm, *range_, ones, next(self._numbers), function, None, None, self.line(), loose
        )

    def _make_axis(self, node: Node) -> None:
        if self.exact and node.axis is None and node.high - node.low < MOST_VALUES and node.op != "constant":
            found = node.function
            if found is None:
                values = np.arange(node.low, node.high + 1)
            else:
                least = found.values.min()
                values = least + np.flatnonzero(np.bincount(found.values.ravel() - least))
            node.axis = len(self._domains)
            self._domains.append(values)
            if found is None:
                node.function = Function((node.axis,), values)

    def _function(self, op: str, imm: Any, args: Sequence[Node], low: int, high: int) -> Function | None:
        """Return the function of an operation on nodes that have one, if it has few enough values."""
        functions = [a.function for a in args if a.function is not None]
        if not self.exact or len(functions) < len(args) or op == "narrow":
            return None
        if max(-low, high, *(max(-a.low, a.high) for a in args)) >= SAFE:
            return None
        # Of too many words together, those that hold intermediate results are taken as free ones.
        while self._cases(functions) > MOST_CASES:
            sizes = {
                a: f.values.size
                for a, f in zip(args, functions, strict=True)
                if a.op != "constant" and f.axes != (a.axis,) and a.high - a.low < MOST_VALUES
            }
            if not sizes:
                return None
            largest = max(sizes, key=lambda a: sizes[a])
            self._make_axis(largest)
            assert largest.axis is not None
            whole = Function((largest.axis,), self._domains[largest.axis])
            functions = [whole if a is largest else f for a, f in zip(args, functions, strict=True)]
        axes = self._axes(functions)
        shape = tuple(len(self._domains[axis]) for axis in axes)
        arrays = [
            f.values
            if f.axes in ((), axes)
            else f.values.reshape([n if axis in f.axes else 1 for axis, n in zip(axes, shape, strict=True)])
            for f in functions
        ]
        values = np.asarray(VALUES[op](imm, *arrays), np.int64)
        if values.shape != shape:
            values = np.broadcast_to(values, shape)
        kept = [i for i in range(len(axes)) if not (values == values.take([0], i)).all()]
        if len(kept) < len(axes):
            values = values[tuple(slice(None) if i in kept else 0 for i in range(len(axes)))]
        return Function(tuple(axes[i] for i in kept), np.ascontiguousarray(values))

    def _axes(self, functions: Sequence[Function]) -> tuple[int, ...]:
        several = {f.axes for f in functions if f.axes}
        if len(several) == 1:
            return several.pop()
        return tuple(sorted({axis for axes in several for axis in axes}))

    def _cases(self, functions: Sequence[Function]) -> int:
        return math.prod(len(self._domains[axis]) for axis in self._axes(functions))


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


def values(nodes: Iterable[Node], inputs: Mapping[str, int]) -> dict[Node, int]:
    """Return what nodes are where the inputs are these: what a graph means, of which all else is made."""
    found: dict[Node, int] = {}
    for node in in_order(nodes):
        if node.op == "input":
            found[node] = inputs[node.imm]
        elif node.op == "constant":
            found[node] = node.imm
        else:
            found[node] = int(VALUES[node.op](node.imm, *(found[arg] for arg in node.args)))
    return found


def arrays(nodes: Sequence[Node], inputs: Mapping[str, npt.NDArray[Any]]) -> list[npt.NDArray[Any]]:
    """Return what nodes are, one element after the other, where the inputs are these arrays of one shape."""
    found: dict[Node, Any] = {}
    for node in in_order(nodes):
        if node.op == "input":
            value = inputs[node.imm]
        elif node.op == "constant":
            value = np.array(node.imm, None if abs(node.imm) < SAFE else object)
        else:
            # Beyond 64 bits they are Python's own integers.
            args = (found[arg].astype(_dtype(node, found[arg].dtype)) for arg in node.args)
            value = VALUES[node.op](node.imm, *args)
        found[node] = np.asarray(value).astype(_dtype(node, np.dtype(np.int64)))
    return [found[node] for node in nodes]


def _dtype(node: Node, narrow: np.dtype[Any]) -> np.dtype[Any]:
    """Return the type in which a node is computed."""
    return narrow if max(-node.low, node.high) < SAFE else np.dtype(object)
