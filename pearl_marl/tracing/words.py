"""What a golden function is traced with: words whose values are not known yet, casts of them, and tables.

Where Python would need the value of a word, that is said here; :mod:`pearl_marl.tracing.trace` adds where in
the author's file it happened.
"""

from __future__ import annotations

import operator
from collections.abc import Callable, Iterable
from typing import Any, NoReturn

import numpy as np

from pearl_marl.errors import ArgumentError
from pearl_marl.tracing.graph import Graph
from pearl_marl.tracing.nodes import Node
from pearl_marl.tracing.operations import wrapped

MOST_SHIFT = 63
"""The most that a word is shifted to the left by: a field has 64 bits."""


def _binary(operation: str, swapped: bool = False, negated: bool = False) -> Callable[[Any, Any], Any]:
    """Return the method of a word for an operation of graphs, with another word or a number."""

    def method(self: Word, other: object) -> Word:
        graph, words = self.graph, (self.node, node_of(self.graph, other))
        node: Node = getattr(graph, operation)(*(reversed(words) if swapped else words))
        return Word(graph, graph.logical_not(node) if negated else node)

    return method


def _both(operation: str) -> tuple[Callable[[Any, Any], Any], Callable[[Any, Any], Any]]:
    return _binary(operation), _binary(operation, swapped=True)


def _shift(operation: str) -> tuple[Callable[[Any, Any], Any], Callable[[Any, Any], Any]]:
    shift = _binary(operation)

    def checked(value: Any, by: Any) -> Any:
        node = node_of(value.graph, by)
        if node.low < 0 or (operation == "left_by" and node.high > MOST_SHIFT):
            raise ArgumentError(
                f"a shift can be by {node.low} to {node.high}; possible are 0 to {MOST_SHIFT}"
            )
        return shift(value, by)

    return checked, lambda self, value: checked(word_of(self.graph, value), self)


class Beyond:
    """A number that words leave arithmetic with them to: it has the methods for a word on its left."""

    __slots__ = ()


class Word:
    """A word whose value is not known yet: what a golden function is called with to be traced."""

    __slots__ = ("graph", "node")
    __array_priority__ = 1000
    __hash__ = None  # type: ignore[assignment]

    def __init__(self, graph: Graph, node: Node) -> None:
        self.graph, self.node = graph, node

    __add__, __radd__ = _both("add")
    __sub__, __rsub__ = _both("sub")
    __mul__, __rmul__ = _both("mul")
    __and__, __rand__ = _both("and_")
    __or__, __ror__ = _both("or_")
    __xor__, __rxor__ = _both("xor")
    __lshift__, __rlshift__ = _shift("left_by")
    __rshift__, __rrshift__ = _shift("right_by")
    __eq__ = _binary("equal")
    __ne__ = _binary("equal", negated=True)
    __lt__ = _binary("less")
    __gt__ = _binary("less", swapped=True)
    __ge__ = _binary("less", negated=True)
    __le__ = _binary("less", swapped=True, negated=True)

    def __bool__(self) -> NoReturn:
        raise ArgumentError(
            "a word decides what Python does next (`if`, `and`, `or`, `not`, `while`, `min`, "
            "`max`); use np.where, `&`, `|` and comparisons instead"
        )

    def __index__(self) -> int:
        if self.node.is_constant():
            return int(self.node.imm)
        raise ArgumentError("Python needs a number here, and a word has none before hardware runs")

    __int__ = __index__

    def __float__(self) -> NoReturn:
        raise ArgumentError("a word becomes a float; golden functions work on integers")

    def __iter__(self) -> NoReturn:
        raise ArgumentError("a word is taken apart like a sequence")

    def __truediv__(self, other: object) -> NoReturn:
        raise ArgumentError("`/` makes a float; golden functions divide by `//`")

    __rtruediv__ = __truediv__

    def __pow__(self, exponent: object) -> Word:
        if not isinstance(exponent, int) or exponent < 0:
            raise ArgumentError("a power of a word has a constant exponent from 0")
        node = self.graph.constant(1)
        for _ in range(exponent):
            node = self.graph.mul(node, self.node)
        return Word(self.graph, node)

    def __floordiv__(self, other: object) -> Word:
        return Word(self.graph, self.graph.floor_divide(self.node, self._divisor(other)))

    def __mod__(self, other: object) -> Word:
        return Word(self.graph, self.graph.modulo(self.node, self._divisor(other)))

    def _divisor(self, other: object) -> Node:
        node = node_of(self.graph, other)
        if not node.is_constant() or node.imm < 1:
            raise ArgumentError("`//` and `%` take a constant divisor from 1")
        return node

    def __rfloordiv__(self, other: object) -> NoReturn:
        raise ArgumentError("`//` and `%` take a constant divisor from 1")

    __rmod__ = __rfloordiv__

    def __neg__(self) -> Word:
        return Word(self.graph, self.graph.sub(self.graph.constant(0), self.node))

    def __pos__(self) -> Word:
        return self

    def __abs__(self) -> Word:
        return Word(self.graph, self.graph.maximum(self.node, (-self).node))

    def __invert__(self) -> Word:
        return Word(self.graph, self.graph.invert(self.node))

    def __array_ufunc__(self, ufunc: Any, method: str, *inputs: Any, **keywords: Any) -> Any:
        if any(isinstance(x, Beyond) for x in inputs):
            return NotImplemented
        floats = self.graph.floats
        if floats is not None and any(isinstance(x, float) for x in inputs):
            return getattr(ufunc, method)(
                *(floats(x) if isinstance(x, Word) else x for x in inputs), **keywords
            )
        made = _UFUNCS.get(ufunc.__name__)
        if made is None or method != "__call__" or keywords:
            _no(ufunc.__name__)
        return word_of(self.graph, made(*(word_of(self.graph, x) for x in inputs)))

    def __array_function__(self, function: Any, types_: Any, args: Any, keywords: Any) -> Any:
        if any(isinstance(x, Beyond) for x in args):
            return NotImplemented
        if function is np.where and len(args) == 3:
            flag, a, b = (node_of(self.graph, x) for x in args)
            if not flag.is_flag:
                flag = self.graph.logical_not(self.graph.equal(flag, self.graph.constant(0)))
            return Word(self.graph, self.graph.choose(flag, a, b))
        if function is np.clip and len(args) == 3:
            value, low, high = (node_of(self.graph, x) for x in args)
            return Word(self.graph, self.graph.minimum(self.graph.maximum(value, low), high))
        _no(function.__name__)


def _leaving(name: str) -> Callable[[Any, Any], Any]:
    """Return a method of words that leaves numbers beyond them, and floats where there are any, to others."""
    own = getattr(Word, name)

    def method(self: Word, other: object) -> Any:
        if isinstance(other, Beyond):
            return NotImplemented
        floats = self.graph.floats
        if floats is not None and (isinstance(other, float) or name in ("__truediv__", "__rtruediv__")):
            return getattr(floats(self), name)(other)
        return own(self, other)

    return method


for _name in ("add", "sub", "mul", "truediv", "mod"):
    for _method in (f"__{_name}__", f"__r{_name}__"):
        setattr(Word, _method, _leaving(_method))
for _name in ("eq", "ne", "lt", "le", "gt", "ge", "pow"):
    setattr(Word, f"__{_name}__", _leaving(f"__{_name}__"))

_UFUNCS: dict[str, Any] = {
    "minimum": _binary("minimum"),
    "maximum": _binary("maximum"),
    **{f"bitwise_{name}": getattr(operator, f"{name}_") for name in ("and", "or")},
    "bitwise_xor": operator.xor,
    "add": operator.add,
    "subtract": operator.sub,
    "multiply": operator.mul,
    "left_shift": operator.lshift,
    "right_shift": operator.rshift,
    "equal": operator.eq,
    "not_equal": operator.ne,
    "less": operator.lt,
    "less_equal": operator.le,
    "greater": operator.gt,
    "greater_equal": operator.ge,
}


def _no(name: str) -> NoReturn:
    raise ArgumentError(f"golden functions have no np.{name}")


def word_of(graph: Graph, value: object) -> Word:
    """Return a word of what an author's function has at hand."""
    return Word(graph, node_of(graph, value))


def node_of(graph: Graph, value: object) -> Node:
    """Return the node of a word, or of a number."""
    return value.node if isinstance(value, Word) else graph.constant(_integer(value))


def _integer(value: object) -> int:
    if isinstance(value, (float, np.floating, complex)):
        raise ArgumentError(f"{value!r} is a float; golden functions work on integers")
    try:
        return operator.index(value)  # type: ignore[arg-type]
    except TypeError:
        if isinstance(value, np.bool_):
            return int(value)
        raise ArgumentError(f"{value!r} is no integer; golden functions work on integers") from None


class Cast:
    """A type of NumPy's, called: its value modulo ``2**bits``."""

    def __init__(self, dtype: type[np.integer[Any]]) -> None:
        self.bits, self.signed = np.dtype(dtype).itemsize * 8, issubclass(dtype, np.signedinteger)

    def __call__(self, value: object = 0, /) -> Any:
        """Return the value modulo ``2**bits``."""
        if isinstance(value, Word):
            return Word(value.graph, value.graph.wrap(value.node, self.bits, self.signed))
        return wrapped(_integer(value), self.bits, self.signed)


class Table(tuple[Any, ...]):
    """A constant table, which a word may index."""

    __slots__ = ()

    def __getitem__(self, index: Any) -> Any:
        if isinstance(index, tuple):
            table: Any = self
            for i in index:
                table = table[i]
            return table
        if not isinstance(index, Word):
            found = super().__getitem__(index)
            return Table(found) if isinstance(index, slice) else found
        node = index.node
        if node.low < 0 or node.high >= len(self):
            raise ArgumentError(
                f"an index can be {node.low} to {node.high}, and the table has {len(self)} entries; "
                "np.minimum or np.clip keeps it in"
            )
        return _chosen(index.graph, list(self), node)


def _chosen(graph: Graph, entries: list[Any], index: Node) -> Any:
    """Return the entry that a word chooses: a word, or a table of such words."""
    if all(isinstance(entry, Table) for entry in entries):
        return Table(_chosen(graph, list(column), index) for column in zip(*entries, strict=True))
    nodes = [node_of(graph, entry) for entry in entries]
    if all(node.is_constant() for node in nodes):
        return Word(graph, graph.table([node.imm for node in nodes], index))
    result = nodes[index.high]
    for i in range(index.high - 1, index.low - 1, -1):
        result = graph.choose(graph.equal(index, graph.constant(i)), nodes[i], result)
    return Word(graph, result)


def table(values: Iterable[Any]) -> Table:
    """Return a table of numbers, or of tables."""
    return Table(table(v) if isinstance(v, (list, tuple)) else v for v in values)
