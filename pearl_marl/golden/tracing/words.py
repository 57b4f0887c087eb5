"""What a golden function is traced with: words whose values are not known yet, casts of them, and tables.

Where Python would need the value of a word, that is said here; :mod:`pearl_marl.golden.tracing.trace` adds
where in the author's file it happened.
"""

from __future__ import annotations

import copy
import dataclasses
import functools
import math
import operator
from collections.abc import Callable, Iterable, Sequence
from typing import Any, NoReturn

import numpy as np

from pearl_marl.errors import ArgumentError
from pearl_marl.golden.tracing.graph import Graph
from pearl_marl.golden.tracing.nodes import Node
from pearl_marl.golden.tracing.operations import wrapped

MOST_SHIFT = 63
"""The most that a word is shifted to the left by: a field has 64 bits."""


def _binary(operation: str, swapped: bool = False, negated: bool = False) -> Callable[[Any, Any], Any]:
    """Return the method of a word for an operation of graphs, with another word or a number."""

    def method(self: Word, other: object) -> Word:
        graph, words = self.graph, (node_of(self.graph, self), node_of(self.graph, other))
        node: Node = getattr(graph, operation)(*(reversed(words) if swapped else words))
        return Word(graph, graph.logical_not(node) if negated else node)

    return method


def _both(operation: str) -> tuple[Callable[[Any, Any], Any], Callable[[Any, Any], Any]]:
    return _binary(operation), _binary(operation, swapped=True)


def _guarded(
    operation: str, guard: Callable[[Graph, object], Node]
) -> tuple[Callable[[Any, Any], Any], Callable[[Any, Any], Any]]:
    """Return the methods of an operation that takes not every number on its right: a guard refuses some."""

    def method(self: Word, other: object) -> Word:
        right = guard(self.graph, other)
        return Word(self.graph, getattr(self.graph, operation)(node_of(self.graph, self), right))

    return method, lambda self, other: method(word_of(self.graph, other), self)


def _shift(graph: Graph, value: object, most: float = math.inf) -> Node:
    node = node_of(graph, value)
    low, high = node.low, node.high
    if low < 0 or high > most:
        low, high = graph.limits(node)
    if low < 0 or high > most:
        raise ArgumentError(f"a shift can be by {low} to {high}; possible are 0 to {MOST_SHIFT}")
    return graph.narrow(node, low, high)


def _divisor(graph: Graph, value: object) -> Node:
    node = node_of(graph, value)
    low, high = (node.low, node.high) if node.low >= 1 else graph.limits(node)
    if low < 1:
        found = f"{low}" if low == high else f"{low} to {high}"
        raise ArgumentError(
            f"a divisor can be {found}, and `//` and `%` take one from 1; `max(n, 1)` keeps it in"
        )
    return graph.narrow(node, low, high)  # a kernel has to know that on other paths it may be 0


class Beyond:
    """A number that words leave arithmetic with them to: it has the methods for a word on its left."""

    __slots__ = ()


class Word:
    """A word whose value is not known yet: what a golden function is called with to be traced."""

    __slots__ = ("graph", "node")
    __array_priority__ = 1000

    def __hash__(self) -> NoReturn:
        raise ArgumentError(
            "a word is in a set, or looked up by what wants its value; `d[word]` reads a dict, and a list of "
            "flags can be a set"
        )

    def __init__(self, graph: Graph, node: Node) -> None:
        self.graph, self.node = graph, node

    __add__, __radd__ = _both("add")
    __sub__, __rsub__ = _both("sub")
    __mul__, __rmul__ = _both("mul")
    __and__, __rand__ = _both("and_")
    __or__, __ror__ = _both("or_")
    __xor__, __rxor__ = _both("xor")
    __lshift__, __rlshift__ = _guarded("left_by", functools.partial(_shift, most=MOST_SHIFT))
    __rshift__, __rrshift__ = _guarded("right_by", _shift)
    __floordiv__, __rfloordiv__ = _guarded("floor_divide", _divisor)
    __mod__, __rmod__ = _guarded("modulo", _divisor)
    __eq__ = _binary("equal")
    __ne__ = _binary("equal", negated=True)
    __lt__ = _binary("less")
    __gt__ = _binary("less", swapped=True)
    __ge__ = _binary("less", negated=True)
    __le__ = _binary("less", swapped=True, negated=True)

    def __bool__(self) -> NoReturn:
        raise ArgumentError(
            "a word decides what Python does next, where its source is not at hand, as in a library's "
            "function, or a property or an operator of a class; write a function in a file (or a notebook's "
            "cell), not in an interactive shell or by exec(), and name it where you call it"
        )

    def __copy__(self) -> Word:
        return self

    def __deepcopy__(self, memo: object) -> Word:
        return self

    def asked(self) -> None:
        """Refuse to be a random draw where a word decides whether it is asked for."""
        if not self.graph.certain:
            line = f", in line {self.graph.decided_in}" if self.graph.decided_in else ""
            raise ArgumentError(
                f"a draw is asked for where a word decides whether it is{line}; ask before that, since a "
                "draw that is not needed costs nothing"
            )

    def entry(self, entries: Sequence[Any]) -> Any:
        """Return the entry of a sequence that this word chooses."""
        return chosen_entry(self.graph, entries, node_of(self.graph, self))

    def __index__(self) -> int:
        node = node_of(self.graph, self)
        if node.is_constant():
            return int(node.imm)
        raise ArgumentError(
            "Python needs a number here, such as a length, and a word has none before hardware runs"
        )

    __int__ = __index__

    def __float__(self) -> NoReturn:
        raise ArgumentError("a word becomes a float; golden functions work on integers")

    def __format__(self, specification: str) -> NoReturn:
        raise ArgumentError("a word becomes text, and it has no value before hardware runs")

    def __str__(self) -> NoReturn:
        self.__format__("")

    def __repr__(self) -> str:
        return "a word"

    def __iter__(self) -> NoReturn:
        raise ArgumentError("a word is taken apart like a sequence")

    def __truediv__(self, other: object) -> NoReturn:
        raise ArgumentError("`/` makes a float; golden functions divide by `//`")

    __rtruediv__ = __truediv__

    def __rpow__(self, base: object) -> Any:
        raise ArgumentError(
            "a word is an exponent; powers of 2 are `1 << k`, and those of others a list that a word indexes"
        )

    def __pow__(self, exponent: object, modulus: object = None) -> Any:
        if modulus is not None:
            return self.__pow__(exponent) % modulus
        if not isinstance(exponent, int) or exponent < 0:
            raise ArgumentError("a power of a word has a constant exponent from 0")
        node = self.graph.constant(1)
        for _ in range(exponent):
            node = self.graph.mul(node, node_of(self.graph, self))
        return Word(self.graph, node)

    def __neg__(self) -> Word:
        return Word(self.graph, self.graph.sub(self.graph.constant(0), node_of(self.graph, self)))

    def __pos__(self) -> Word:
        return self

    def __abs__(self) -> Word:
        return Word(self.graph, self.graph.maximum(node_of(self.graph, self), (-self).node))

    def __invert__(self) -> Word:
        return Word(self.graph, self.graph.invert(node_of(self.graph, self)))

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
        _no(function.__name__)


def _leaving(name: str) -> Callable[[Any, Any], Any]:
    """Return a method of words that leaves numbers beyond them, and floats where there are any, to others."""
    own = getattr(Word, name)

    def method(self: Word, other: object, *rest: object) -> Any:
        if isinstance(other, Beyond):
            return NotImplemented
        floats = self.graph.floats
        if floats is not None and (isinstance(other, float) or name in ("__truediv__", "__rtruediv__")):
            return getattr(floats(self), name)(other)
        return own(self, other, *rest)

    return method


for _name in ("add", "sub", "mul", "truediv", "mod", "pow"):
    for _method in (f"__{_name}__", f"__r{_name}__"):
        setattr(Word, _method, _leaving(_method))
for _name in ("eq", "ne", "lt", "le", "gt", "ge"):
    setattr(Word, f"__{_name}__", _leaving(f"__{_name}__"))

OPERATORS: dict[str, Callable[[Any, Any], Any]] = {
    "add": operator.add,
    "subtract": operator.sub,
    "multiply": operator.mul,
    "floor_divide": operator.floordiv,
    "remainder": operator.mod,
    "equal": operator.eq,
    "not_equal": operator.ne,
    "less": operator.lt,
    "less_equal": operator.le,
    "greater": operator.gt,
    "greater_equal": operator.ge,
}
"""What NumPy's functions of these names do to two numbers, integers or reals."""

_UFUNCS = OPERATORS | {
    "bitwise_and": operator.and_,
    "bitwise_or": operator.or_,
    "bitwise_xor": operator.xor,
    "left_shift": operator.lshift,
    "right_shift": operator.rshift,
}


def _no(name: str) -> NoReturn:
    raise ArgumentError(f"golden functions have no np.{name}")


def word_of(graph: Graph, value: object) -> Word:
    """Return a word of what an author's function has at hand."""
    return Word(graph, node_of(graph, value))


def node_of(graph: Graph, value: object) -> Node:
    """Return the node of a word, a narrower one if more is known of it here, or of a number."""
    if isinstance(value, Word):
        return graph.known.get(value.node, value.node)
    return graph.constant(_integer(value))


def flag_of(graph: Graph, node: Node) -> Node:
    """Return the flag of whether a node is not 0."""
    return node if node.is_flag else graph.logical_not(graph.equal(node, graph.constant(0)))


def _integer(value: object) -> int:
    if isinstance(value, (float, np.floating, complex)):
        raise ArgumentError(f"{value!r} is a float; golden functions work on integers")
    if isinstance(value, (list, tuple)):
        raise ArgumentError("a sequence where a number is due; the length of one depends on no word")
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
            return Word(value.graph, value.graph.wrap(node_of(value.graph, value), self.bits, self.signed))
        return wrapped(_integer(value), self.bits, self.signed)


class _Indexed:
    """What a constant table does with an index: a word may be one, and NumPy's tables take several."""

    __slots__ = ()

    def __getitem__(self, index: Any) -> Any:
        if isinstance(index, tuple):
            check_places(index)
            table: Any = self
            for i in index:
                table = table[i]
            return table
        if isinstance(index, Word):
            return chosen_entry(index.graph, self, node_of(index.graph, index))  # type: ignore[arg-type]
        return super().__getitem__(index)  # type: ignore[misc]


class Table(_Indexed, tuple[Any, ...]):
    """A constant table, which a word may index."""

    __slots__ = ()

    def __getitem__(self, index: Any) -> Any:
        found = super().__getitem__(index)
        return Table(found) if isinstance(index, slice) else found


def _constant(*_: Any, **__: Any) -> NoReturn:
    raise ArgumentError(
        "what is made outside of the function is written, and each slot would need its own; make it inside, "
        "as by list(), or keep it in the state"
    )


class TableList(_Indexed, list[Any]):
    """A constant table that its author has made as a list: what is copied of it is one."""

    def __copy__(self) -> list[Any]:
        return list(self)

    def __deepcopy__(self, memo: Any) -> list[Any]:
        return [copy.deepcopy(value, memo) for value in self]

    __setitem__ = __delitem__ = __iadd__ = __imul__ = _constant
    append = extend = insert = pop = remove = clear = sort = reverse = _constant


class TableDict(dict[Any, Any]):
    """A constant dict."""

    __setitem__ = __delitem__ = __ior__ = _constant
    clear = pop = popitem = setdefault = update = _constant


def check_places(index: tuple[Any, ...]) -> None:
    """Refuse an index of several parts that NumPy would take to be a slice of a table."""
    if any(isinstance(part, slice) or part is None or part is Ellipsis for part in index):
        raise ArgumentError("a table is indexed by one number for each of its dimensions; a slice is none")


def chosen_entry(graph: Graph, entries: Sequence[Any], index: Node) -> Any:
    """Return the entry that a node chooses: a word, or a sequence of such words.

    Raises
    ------
    ArgumentError
        The entries have different shapes.
    """
    if index.is_constant():
        return entries[index.imm]
    if all(isinstance(entry, (tuple, list)) for entry in entries):
        if len({len(entry) for entry in entries}) > 1:
            raise ArgumentError("a word chooses from sequences of different lengths")
        parts = [chosen_entry(graph, column, index) for column in zip(*entries, strict=True)]
        kind = list if isinstance(entries[0], TableList) else type(entries[0])
        new = kind(*parts) if hasattr(kind, "_fields") else kind(parts)
        return _which(graph, new, entries, index) if isinstance(new, list) else new
    if graph.floats is not None and any(isinstance(entry, (float, Beyond)) for entry in entries):
        return graph.floats.chosen(Word(graph, index), entries)
    kinds = {type(entry) for entry in entries}
    if len(kinds) == 1 and dataclasses.is_dataclass(kind := kinds.pop()):
        names = [field.name for field in dataclasses.fields(kind)]
        columns = {name: [getattr(entry, name) for entry in entries] for name in names}
        values = {name: chosen_entry(graph, column, index) for name, column in columns.items()}
        return _which(graph, dataclasses.replace(entries[0], **values), entries, index)
    if all(type(entry) is int for entry in entries):  # a long table, without a node for each
        return Word(graph, graph.table(entries, index))
    nodes = [node_of(graph, entry) for entry in entries]
    if all(node.is_constant() for node in nodes):
        return Word(graph, graph.table([node.imm for node in nodes], index))
    low, high = max(index.low, 0), min(index.high, len(nodes) - 1)
    result = nodes[high]
    for i in range(high - 1, low - 1, -1):
        result = graph.choose(graph.equal(index, graph.constant(i)), nodes[i], result)
    return Word(graph, result)


def _which(graph: Graph, new: Any, entries: Sequence[Any], index: Node) -> Any:
    """Return what is the entry that a node chooses, so that what is written there is written into both."""
    if graph.twins is not None:
        places = range(max(index.low, 0), min(index.high, len(entries) - 1) + 1)
        graph.twins.chosen(new, [(graph.equal(index, graph.constant(k)), entries[k]) for k in places])
    return new


def table(values: Iterable[Any]) -> Table | TableList | TableDict:
    """Return a table of numbers, or of tables; entries that are objects of a class stay such."""
    if isinstance(values, dict):
        return TableDict(
            (key, table(v) if type(v) in (list, tuple, dict) else v) for key, v in values.items()
        )
    made = (
        type(v)(*table(v)) if hasattr(v, "_fields") else table(v) if isinstance(v, (list, tuple)) else v
        for v in values
    )
    return TableList(made) if isinstance(values, list) else Table(made)
