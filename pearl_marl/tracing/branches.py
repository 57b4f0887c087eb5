"""What becomes of an author's decisions on words while a function is traced.

A *path* is the condition under which the statement at hand runs. A :class:`Fork` runs both sides of an
``if``, each on its path, and joins the variables that they leave. A ``return``, ``break`` or ``continue``
ends a path; what it takes along is joined where it arrives, in the order in which paths ended. An element of
a list is written under the condition of its path, so a list that keeps its name need not be joined.

On a path more is known of words: under ``x == 3`` it is 3, and under ``x > 0`` not 0.
"""

from __future__ import annotations

import dataclasses
import functools
import operator
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, NamedTuple, NoReturn

import numpy as np

from pearl_marl.errors import ArgumentError
from pearl_marl.tracing.graph import Graph
from pearl_marl.tracing.nodes import Node
from pearl_marl.tracing.twins import Twins
from pearl_marl.tracing.words import Word, chosen_entry, flag_of, node_of

MOST_ROUNDS = 1000
"""Rounds after which a ``while`` counts as one without a bound."""

Exits = frozenset[Any]


class Literal(NamedTuple):
    """A flag that is set on a path."""

    flag: Node
    exits: Exits
    """What ended the paths on which it is not set; empty where it is a side of an ``if``."""


@dataclasses.dataclass(frozen=True, eq=False)
class Path:
    """The condition under which a statement runs, and what it tells of words."""

    graph: Graph
    condition: Node
    literals: tuple[Literal, ...] = ()
    facts: Mapping[Node, bool] = dataclasses.field(default_factory=dict)
    """Flags that are known here."""
    known: Mapping[Node, Node] = dataclasses.field(default_factory=dict)
    """Nodes of which more is known here, as nodes of narrower ranges."""

    def where(self, flag: Node, exits: Exits = frozenset()) -> Path:
        """Return the path on which a flag is set, too."""
        if flag.is_constant(1):
            return self
        facts, known = dict(self.facts), dict(self.known)
        for node, value in _facts(self.graph, flag, True):
            facts[node] = value
            for word, low, high in _bounds(node, value):
                _narrow(self.graph, known, word, low, high)
        condition = self.graph.and_(self.condition, flag)
        return Path(self.graph, condition, (*self.literals, Literal(flag, exits)), facts, known)

    def decided(self, flag: Node) -> bool | None:
        """Return what a flag is here, if that is known."""
        graph = self.graph
        if flag.is_constant():
            return bool(flag.imm)
        if flag in self.facts:
            return self.facts[flag]
        if graph.and_(self.condition, flag).is_constant(0):
            return False
        if graph.and_(self.condition, graph.logical_not(flag)).is_constant(0):
            return True
        return None

    def since(self, start: Path, but: Exits = frozenset()) -> Node:
        """Return the condition that leads here from another path, without what ``but`` alone has ended."""
        result = self.graph.constant(1)
        for literal in self.literals[len(start.literals) :]:
            if not literal.exits or not literal.exits <= but:
                result = self.graph.and_(result, literal.flag)
        return result


def _facts(graph: Graph, flag: Node, value: bool) -> list[tuple[Node, bool]]:
    """Return the flags that follow from one."""
    found = [(flag, value), (graph.logical_not(flag), not value)]
    if flag.op == "not":
        found += _facts(graph, flag.args[0], not value)
    if (flag.op == "and" and value) or (flag.op == "or" and not value):
        for arg in flag.args:
            if arg.is_flag:
                found += _facts(graph, arg, value)
    return found


def _bounds(flag: Node, value: bool) -> list[tuple[Node, int, int]]:
    """Return between what words are where a comparison has come out so."""
    if flag.op == "equal":
        a, b = flag.args
        if value:
            return [(a, b.low, b.high), (b, a.low, a.high)]
        if b.is_constant():
            return [(a, a.low + (a.low == b.imm), a.high - (a.high == b.imm))]
    if flag.op == "less":
        a, b = flag.args
        if value:
            return [(a, a.low, b.high - 1), (b, a.low + 1, b.high)]
        return [(a, b.low, a.high), (b, b.low, a.high)]
    return []


def _narrow(graph: Graph, known: dict[Node, Node], word: Node, low: int, high: int) -> None:
    """Note that a word is within a range."""
    if word.is_constant():
        return
    # A word of few values needs no other node: what is made of it is joined exactly.
    if low != high and word.function is not None:
        return
    low, high = max(low, word.low), min(high, word.high)
    if (low, high) == (word.low, word.high) or low > high:
        return
    new = graph.narrow(word, low, high)
    for old in [node for node, now in known.items() if now is word]:
        known[old] = new
    known[word] = new


class Undefined:
    """What a variable holds where it has no value on some path, or values that cannot be one."""

    def __init__(self, why: str) -> None:
        object.__setattr__(self, "_why", why)

    def _raise(self, *_: Any, **__: Any) -> NoReturn:
        raise ArgumentError(object.__getattribute__(self, "_why"))

    __getattr__ = __setattr__ = _raise


for _name in [
    "add",
    "radd",
    "sub",
    "rsub",
    "mul",
    "rmul",
    "floordiv",
    "rfloordiv",
    "truediv",
    "rtruediv",
    "mod",
    "rmod",
    "pow",
    "rpow",
    "and",
    "rand",
    "or",
    "ror",
    "xor",
    "rxor",
    "lshift",
    "rlshift",
    "rshift",
    "rrshift",
    "eq",
    "ne",
    "lt",
    "le",
    "gt",
    "ge",
    "bool",
    "index",
    "int",
    "float",
    "iter",
    "len",
    "getitem",
    "setitem",
    "call",
    "neg",
    "pos",
    "abs",
    "invert",
    "contains",
]:
    setattr(Undefined, f"__{_name}__", Undefined._raise)


class Listed(list[Any]):
    """A list of a golden function: a word may choose its elements, and its length depends on no word."""

    path: Path | None = None
    """The path on which it was made."""
    runtime: Runtime | None = None

    def _grow(self) -> None:
        if self.runtime is not None:
            self.runtime.growing(self)


def _growing(name: str) -> Callable[..., Any]:
    def method(self: Listed, *args: Any, **keywords: Any) -> Any:
        self._grow()
        return getattr(list, name)(self, *args, **keywords)

    return method


for _name in (
    "append",
    "extend",
    "insert",
    "pop",
    "remove",
    "clear",
    "sort",
    "reverse",
    "__delitem__",
    "__iadd__",
):
    setattr(Listed, _name, _growing(_name))


class Runtime:
    """What rewritten functions call: see :mod:`pearl_marl.tracing.rewriting`."""

    def __init__(self, graph: Graph) -> None:
        self.graph = graph
        self.twins = graph.twins = Twins(graph)
        self.root = Path(graph, graph.constant(1))
        self.exits: list[Any] = []
        """What has ended paths, in order, until it is joined."""
        self._path: Path | None = self.root

    @property
    def path(self) -> Path | None:
        """The path at hand; ``None`` where none is left."""
        return self._path

    @path.setter
    def path(self, path: Path | None) -> None:
        self._path = path
        self.graph.known = path.known if path is not None else {}
        self.graph.certain = path is not None and path.condition.is_constant(1)

    @property
    def here(self) -> Path:
        """The path at hand, where one is."""
        assert self._path is not None
        return self._path

    def frame(self) -> Frame:
        """Return what keeps the paths of a call."""
        return Frame(self)

    def unbound(self, name: str) -> Undefined:
        """Return a variable's value before it has one."""
        return Undefined(f"`{name}` has no value on every path that leads here; give it one before")

    def truth(self, value: Any) -> bool | Node:
        """Return whether a value counts as true: a flag, where that depends on a word."""
        if not isinstance(value, Word):
            return bool(value)
        flag = flag_of(self.graph, node_of(self.graph, value))
        decided = self.here.decided(flag)
        return flag if decided is None else decided

    def condition_since(self, start: Path | None) -> Node | None:
        """Return the condition that has come about since a path; ``None`` where there is none."""
        start = start or self.root
        if self._path is None or len(self._path.literals) <= len(start.literals):
            return None
        # A list that was made on a side that has been left is seen by its own path only.
        if self._path.literals[: len(start.literals)] != start.literals:
            start = self.root
        condition = self._path.since(start)
        return None if condition.is_constant(1) else condition

    def either(self, test: Any, a: Callable[[], Any], b: Callable[[], Any]) -> Any:
        """Return ``a() if test else b()``."""
        flag = self.truth(test)
        if isinstance(flag, bool):
            return a() if flag else b()
        return joined(self.graph, flag, self.on(flag, a), self.on(self.graph.logical_not(flag), b))

    def on(self, flag: Node, function: Callable[[], Any]) -> Any:
        """Return what a function gives where a flag is set."""
        return self.at(self.here.where(flag), function)

    def at(self, path: Path, function: Callable[[], Any]) -> Any:
        """Return what a function gives on a path."""
        before, self.path = self.path, path
        try:
            return function()
        finally:
            self.path = before

    def both(self, a: Any, b: Callable[[], Any]) -> Any:
        """Return ``a and b()``."""
        flag = self.truth(a)
        if isinstance(flag, bool):
            return b() if flag else a
        return joined(self.graph, flag, self.on(flag, b), False if a.node.is_flag else a)

    def any_of_two(self, a: Any, b: Callable[[], Any]) -> Any:
        """Return ``a or b()``."""
        flag = self.truth(a)
        if isinstance(flag, bool):
            return a if flag else b()
        there = True if a.node.is_flag else a
        return joined(self.graph, flag, there, self.on(self.graph.logical_not(flag), b))

    def negation(self, value: Any) -> Any:
        """Return ``not value``."""
        flag = self.truth(value)
        return not flag if isinstance(flag, bool) else Word(self.graph, self.graph.logical_not(flag))

    def chain(self, names: Sequence[str], first: Any, *later: Callable[[], Any]) -> Any:
        """Return a chain of comparisons."""
        second = later[0]()
        result = self.compared(names[0], first, second)
        if len(names) == 1:
            return result
        return self.both(result, lambda: self.chain(names[1:], second, *later[1:]))

    def compared(self, name: str, a: Any, b: Any) -> Any:
        """Return one comparison, by the name of its node."""
        mine: dict[str, Callable[[Any, Any], Any]] = {
            "Eq": self.equal,
            "NotEq": self.differ,
            "In": self.contains,
            "NotIn": self.lacks,
            "Lt": operator.lt,
            "LtE": operator.le,
            "Gt": operator.gt,
            "GtE": operator.ge,
            "Is": self.same,
            "IsNot": self.other,
        }
        return mine[name](a, b)

    def equal(self, a: Any, b: Any) -> Any:
        """Return ``a == b``, of sequences of words, too."""
        if isinstance(a, (tuple, list)) and isinstance(b, (tuple, list)):
            if len(a) != len(b) or isinstance(a, tuple) != isinstance(b, tuple):
                return False
            return self.every(self.equal(x, y) for x, y in zip(a, b, strict=True))
        return a == b

    def differ(self, a: Any, b: Any) -> Any:
        """Return ``a != b``."""
        if isinstance(a, (tuple, list)) and isinstance(b, (tuple, list)):
            return self.negation(self.equal(a, b))
        return a != b

    def contains(self, value: Any, among: Any) -> Any:
        """Return ``value in among``."""
        if isinstance(among, Word):
            raise ArgumentError("`in` looks into a word, which is no sequence")
        if isinstance(among, range) and isinstance(value, Word) and among.step == 1:
            return (value >= among.start) & (value < among.stop)
        if not _has_words(value) and not (isinstance(among, (tuple, list)) and _has_words(among)):
            return value in among
        return self.some(self.equal(value, other) for other in among)

    def lacks(self, value: Any, among: Any) -> Any:
        """Return ``value not in among``."""
        return self.negation(self.contains(value, among))

    def same(self, a: Any, b: Any) -> bool:
        """Return ``a is b``."""
        if (isinstance(a, Word) and b is not None) or (isinstance(b, Word) and a is not None):
            raise ArgumentError("`is` on a word; use `==`")
        return a is b

    def other(self, a: Any, b: Any) -> bool:
        """Return ``a is not b``."""
        return not self.same(a, b)

    def count(self, among: Any, value: Any) -> Any:
        """Return ``among.count(value)``."""
        if not isinstance(among, (tuple, list)) or not (_has_words(value) or _has_words(among)):
            return among.count(value)
        return sum(self.flag(self.equal(one, value)) for one in among)

    def index(self, among: Any, value: Any) -> Any:
        """Return ``among.index(value)``: where a value is, which is there."""
        if not isinstance(among, (tuple, list)) or not (_has_words(value) or _has_words(among)):
            return among.index(value)
        result: Any = len(among) - 1
        for place in range(len(among) - 2, -1, -1):
            result = self.either(self.equal(among[place], value), lambda: place, lambda: result)  # noqa: B023
        return result

    def every(self, values: Iterable[Any]) -> Any:
        """Return whether all values are true."""
        result: Any = True
        for value in values:
            result = self.both(result, lambda value=value: self.flag(value))  # type: ignore[misc]
            if result is False:
                break
        return result

    def some(self, values: Iterable[Any]) -> Any:
        """Return whether any value is true."""
        result: Any = False
        for value in values:
            result = self.any_of_two(result, lambda value=value: self.flag(value))  # type: ignore[misc]
            if result is True:
                break
        return result

    def flag(self, value: Any) -> Any:
        """Return ``bool(value)``."""
        flag = self.truth(value)
        return flag if isinstance(flag, bool) else Word(self.graph, flag)

    def item(self, of: Any, index: Any) -> Any:
        """Return an element, which a word may choose."""
        if isinstance(index, tuple) and isinstance(of, (tuple, list)):
            for part in index:
                of = self.item(of, part)
            return of
        if isinstance(of, Word):
            raise ArgumentError("a word has no elements; its bits are `word >> k & 1`")
        if not isinstance(index, Word):
            found = of[index]
            return self.listed(found) if isinstance(found, list) and isinstance(index, slice) else found
        if isinstance(of, Undefined):
            of._raise()
        if isinstance(of, (tuple, list, range)):
            return chosen_entry(self.graph, of, self.place(of, index))
        raise ArgumentError(f"a word chooses from {type(of).__name__}; it chooses from lists and tuples")

    def place(self, of: Sequence[Any], index: Word) -> Node:
        """Return the node of an index, which is within a sequence."""
        node = node_of(self.graph, index)
        low, high = node.low, node.high
        if self._path is not None and (low < 0 or high >= len(of)):
            # What is known here may say more than the word itself.
            inside = self.graph.choose(self.here.condition, node, self.graph.constant(max(low, 0)))
            low, high = max(low, inside.low), min(high, inside.high)
        if low < 0 or high >= len(of):
            raise ArgumentError(
                f"an index can be {low} to {high}, and there are {len(of)} elements; "
                "`min`, `max` or an `if` keeps it in"
            )
        return node

    def put(self, of: Any, index: Any, value: Any) -> None:
        """Write an element, where the path at hand is taken."""
        if isinstance(index, tuple) and isinstance(of, list) and index:
            *before, index = index
            for part in before:
                of = self.item(of, part)
        if isinstance(index, Word) and isinstance(of, list):
            node, graph = self.place(of, index), self.graph
            for k in range(max(node.low, 0), min(node.high, len(of) - 1) + 1):
                here = graph.equal(node, graph.constant(k))
                if not here.is_constant(0):
                    self.store(of, k, value, here)
            return
        if isinstance(index, Word):
            raise ArgumentError(f"a word chooses what is written in {type(of).__name__}; it takes a list")
        self.store(of, index, value)

    def store(self, of: Any, key: Any, value: Any, where: Node | None = None) -> None:
        """Write one element, where a flag is set, and in all that may be the same list."""
        for one, flags in self._same(of, where):
            if isinstance(key, slice) and flags:
                raise ArgumentError("a slice is written where a word decides; write its elements")
            one[key] = self._changed(flags, value, one[key]) if flags else value

    def set_attribute(self, of: Any, name: str, value: Any) -> None:
        """Write an attribute, where the path at hand is taken, and in all that may be the same object."""
        for one, flags in self._same(of):
            setattr(one, name, self._changed(flags, value, getattr(one, name)) if flags else value)

    def _same(self, of: Any, where: Node | None = None) -> list[tuple[Any, list[Node]]]:
        """Return what a write goes to, each with the flags under which it does."""
        result = []
        for one, flag in [(of, None), *self.twins.others(of)]:
            flags = [self.condition_since(getattr(one, "path", None) if isinstance(one, Listed) else None)]
            result.append((one, [f for f in (*flags, where, flag) if f is not None and not f.is_constant(1)]))
        return result

    def _changed(self, flags: Sequence[Node], value: Any, old: Any) -> Any:
        """Return a value where all flags are set, and an old one where not."""
        graph = self.graph
        if isinstance(value, Word):
            value = Word(graph, node_of(graph, value))
        # What is known of words on this path is not known where the old value stays.
        return self.at(self.root, lambda: joined(graph, functools.reduce(graph.and_, flags), value, old))

    def growing(self, of: Any, verb: str = "") -> Any:
        """Return a list, which is about to become longer or shorter: that is no word's to decide."""
        if isinstance(of, list):
            if verb in ("sort", "remove") and _has_words(of):
                raise ArgumentError(
                    f"{verb}() of a list of words: their order is not known before hardware runs"
                )
            for _, flags in self._same(of):
                if flags:
                    raise ArgumentError(
                        "a list grows or shrinks where a word decides whether it does; give it its full "
                        "length before"
                    )
        return of

    def listed(self, values: Iterable[Any]) -> Listed:
        """Return a list whose elements may be written by words."""
        result = Listed(values)
        result.path, result.runtime = self._path, self
        return result

    def items(self, values: Any) -> Any:
        """Return what a ``for`` goes over."""
        if isinstance(values, Word):
            raise ArgumentError("`for` goes over a word, which is no sequence")
        return values

    def keeps(self, value: Any) -> bool:
        """Return whether a comprehension keeps an element, which is no word's to decide."""
        flag = self.truth(value)
        if not isinstance(flag, bool):
            raise ArgumentError(
                "a word decides whether an element is left out, and a length depends on no word; "
                "any(), all() and sum() take such an `if`"
            )
        return flag

    def raises(self) -> None:
        """Refuse an exception where a word decides whether it is raised."""
        if not self.here.condition.is_constant(1):
            raise ArgumentError("a `raise` where a word decides; hardware has nobody to tell")

    def asserts(self, value: Any) -> None:
        """Check what is no word."""
        flag = self.truth(value)
        if not isinstance(flag, bool) or not (flag or self.here.condition.is_constant(1)):
            raise ArgumentError("an `assert` on a word; hardware has nobody to tell")
        if not flag:
            raise AssertionError("an `assert` does not hold")

    def builtins(self) -> dict[str, Any]:
        """Return what Python's functions become, by their names."""
        return {
            "min": lambda *values, **keywords: self._least(min, "minimum", values, keywords),
            "max": lambda *values, **keywords: self._least(max, "maximum", values, keywords),
            "any": self.some,
            "all": self.every,
            "bool": _Type((bool, Word), self.flag),
            "int": _Type((int, Word), lambda value=0: value if isinstance(value, Word) else int(value)),
            "list": _Type(list, lambda values=(): self.listed(values)),
            "divmod": lambda a, b: (a // b, a % b),
            "range": _Type(range, _range),
            "sorted": self._sorted,
            "print": _print,
            "set": _Type(set, _no_set),
        }

    def _least(self, native: Any, operation: str, values: Sequence[Any], keywords: dict[str, Any]) -> Any:
        every = list(values[0]) if len(values) == 1 else list(values)
        if not any(isinstance(value, Word) for value in every):
            return native(every, **keywords)
        if keywords:
            raise ArgumentError(f"{native.__name__}() of words takes no {next(iter(keywords))}=")
        nodes = [node_of(self.graph, value) for value in every]
        result = nodes[0]
        for node in nodes[1:]:
            result = getattr(self.graph, operation)(result, node)
        return Word(self.graph, result)

    def _sorted(self, values: Iterable[Any], **keywords: Any) -> Any:
        every = list(values)
        if not any(map(_has_words, every)):
            return self.listed(sorted(every, **keywords))
        raise ArgumentError("sorted() of words; pearl_marl.golden.inserted puts one into its place")


class _Type:
    """What a type of Python's becomes: called, it makes something else, and ``isinstance`` knows it."""

    def __init__(self, types: Any, make: Callable[..., Any]) -> None:
        self._types, self._make = types, make

    def __call__(self, *args: Any) -> Any:
        return self._make(*args)

    def __instancecheck__(self, value: Any) -> bool:
        return isinstance(value, self._types)


def _range(*args: Any) -> range:
    if any(isinstance(a, Word) and not a.node.is_constant() for a in args):
        raise ArgumentError(
            "range() of a word; go over all rounds that there can be, and `break` where it is enough"
        )
    return range(*args)


def _print(*values: Any, **keywords: Any) -> None:
    if any(map(_has_words, values)):
        raise ArgumentError("print() of a word, which has no value before hardware runs")
    print(*values, **keywords)


def _no_set(values: Iterable[Any] = ()) -> set[Any]:
    every = list(values)
    if any(map(_has_words, every)):
        raise ArgumentError("a set of words; golden functions have lists and tuples of them")
    return set(every)


def _defined(value: Any) -> None:
    """Refuse what holds a variable without a value."""
    if isinstance(value, Undefined):
        value._raise()
    if isinstance(value, (tuple, list)):
        for part in value:
            _defined(part)


def _has_words(value: Any) -> bool:
    if isinstance(value, (tuple, list)):
        return any(map(_has_words, value))
    return isinstance(value, Word)


class Frame:
    """The paths of one call of a function."""

    def __init__(self, runtime: Runtime) -> None:
        self.runtime, self.entry, self.mark = runtime, runtime.here, len(runtime.exits)
        self.results: list[tuple[Path, Any]] = []

    def lives(self) -> bool:
        """Return whether any path is left."""
        return self.runtime.path is not None

    def fork(self, test: Any, before: tuple[Any, ...]) -> Fork:
        """Return what keeps the sides of an ``if``."""
        return Fork(self.runtime, test, before)

    def loop(self) -> Loop:
        """Return what keeps the rounds of a loop."""
        return Loop(self)

    def returns(self, value: Any) -> None:
        """End a path by ``return``."""
        _defined(value)
        self.results.append((self.runtime.here, value))
        self.runtime.exits.append(self)
        self.runtime.path = None

    def result(self) -> Any:
        """Return what the call does."""
        runtime = self.runtime
        if runtime.path is not None:
            self.results.append((runtime.path, None))
        runtime.path = self.entry
        del runtime.exits[self.mark :]
        return _merged(runtime.graph, self.results, self.entry, frozenset([self]), joined)


class Fork:
    """The two sides of an ``if``."""

    def __init__(self, runtime: Runtime, test: Any, before: tuple[Any, ...]) -> None:
        self.runtime, self.variables, self.start = runtime, before, runtime.here
        self.flag = runtime.truth(test)
        self.sides: list[Path | None]
        if isinstance(self.flag, bool):
            self.sides = [self.start if self.flag else None, None if self.flag else self.start]
        else:
            negated = runtime.graph.logical_not(self.flag)
            self.sides = [self.start.where(self.flag), self.start.where(negated)]
        self.left: list[tuple[Path | None, tuple[Any, ...], Exits]] = []
        self.mark = 0

    def takes(self, side: int) -> bool:
        """Return whether a side may be taken, and go there."""
        path = self.sides[side]
        if path is None:
            return False
        self.runtime.path, self.mark = path, len(self.runtime.exits)
        return True

    def before(self) -> tuple[Any, ...]:
        """Return the variables before both sides."""
        return self.variables

    def leaves(self, values: tuple[Any, ...]) -> None:
        """Note what a side leaves."""
        exits = frozenset(self.runtime.exits[self.mark :])
        self.left.append((self.runtime.path, values, exits))

    def joined(self) -> tuple[Any, ...]:
        """Return the variables after both sides."""
        runtime, graph, flag = self.runtime, self.runtime.graph, self.flag
        if isinstance(flag, bool):
            runtime.path, values, _ = self.left[0]
            return values
        (one, a, exits_a), (other, b, exits_b) = self.left
        one_start, other_start = self.sides
        assert one_start is not None
        assert other_start is not None
        if one is None or other is None:
            # The side that is left goes on; that it was this one tells what the other has ended.
            runtime.path = other if one is None else one
            if runtime.path is not None:
                exits = exits_a if one is None else exits_b
                runtime.path = _retagged(runtime.path, len(self.start.literals), exits)
            return b if one is None else a
        if one is one_start and other is other_start:
            runtime.path = self.start
        else:
            left = graph.choose(flag, one.since(one_start), other.since(other_start))
            runtime.path = self.start.where(left, exits_a | exits_b)
        after: tuple[Any, ...] = runtime.at(self.start, lambda: _variables(graph, flag, a, b))
        return after


def _retagged(path: Path, place: int, exits: Exits) -> Path:
    literals = list(path.literals)
    literals[place] = Literal(literals[place].flag, exits)
    return dataclasses.replace(path, literals=tuple(literals))


class Loop:
    """The rounds of a ``for`` or a ``while``."""

    def __init__(self, frame: Frame) -> None:
        self.frame, self.runtime = frame, frame.runtime
        self.start = self.round = self.runtime.here
        self.mark, self.rounds = len(self.runtime.exits), 0
        self.ended: list[tuple[Path, tuple[Any, ...]]] = []
        """Where the loop was left, by a break or because it stopped."""
        self.stopped: list[tuple[Path, tuple[Any, ...]]] = []
        self.continued: list[tuple[Path, tuple[Any, ...]]] = []
        self.broken, self.passed, self.over = (self, "break"), (self, "continue"), (self, "stop")
        self.first = frozenset([self.frame, self.broken, self.over])
        """What ends of this loop need not say that it did not happen: it would come first among them."""

    def again(self, test: Any, values: tuple[Any, ...]) -> bool:
        """Return whether a ``while`` may go round once more."""
        runtime = self.runtime
        if runtime.path is None:
            return False
        flag = runtime.truth(test)
        if isinstance(flag, bool):
            return flag and self._count()
        stop = runtime.here.where(runtime.graph.logical_not(flag))
        self.ended.append((stop, values))
        self.stopped.append((stop, values))
        runtime.exits.append(self.over)
        runtime.path = self.round = runtime.here.where(flag, frozenset([self.over]))
        return self._count()

    def _count(self) -> bool:
        self.rounds += 1
        self.round = self.runtime.here
        if self.rounds > MOST_ROUNDS:
            raise ArgumentError(
                f"a `while` goes round more than {MOST_ROUNDS} times: nothing that is known of its words "
                "ends it; use `for` and `break`"
            )
        return True

    def breaks(self, values: tuple[Any, ...]) -> None:
        """End a path by ``break``."""
        self.ended.append((self.runtime.here, values))
        self.runtime.exits.append(self.broken)
        self.runtime.path = None

    def continues(self, values: tuple[Any, ...]) -> None:
        """End a path by ``continue``."""
        self.continued.append((self.runtime.here, values))
        self.runtime.exits.append(self.passed)
        self.runtime.path = None

    def next_round(self, values: tuple[Any, ...]) -> tuple[Any, ...]:
        """Return the variables after a round."""
        runtime = self.runtime
        ends = self.continued
        self.continued = []
        if runtime.path is not None:
            ends.append((runtime.path, values))
        others = [e for e in runtime.exits[self.mark :] if e is not self.passed]
        runtime.exits[self.mark :] = others
        if ends:
            but = frozenset([self.frame, self.broken, self.passed])
            values = self._merged(ends, self.round, but)
            runtime.path = self._after(self.round, ends, frozenset([self.passed]))
        self.round = runtime.path or self.round
        return values

    def _after(self, start: Path, ends: Sequence[tuple[Path, Any]], resolved: Exits) -> Path:
        """Return the path on which any of some ends was reached."""
        graph = self.runtime.graph
        exits = frozenset(
            e for path, _ in ends for lit in path.literals[len(start.literals) :] for e in lit.exits
        )
        lost = exits - resolved
        if not lost and not self._left_otherwise(start, ends):
            return start
        condition = graph.constant(0)
        for path, _ in ends:
            condition = graph.or_(condition, path.since(start))
        return start.where(condition, lost or frozenset([self.frame]))

    def _left_otherwise(self, start: Path, ends: Sequence[tuple[Path, Any]]) -> bool:
        """Return whether a path that began here did not come to one of these ends."""
        return bool(self.runtime.exits[self.mark :])

    def _merged(self, ends: Sequence[tuple[Path, Any]], start: Path, but: Exits) -> tuple[Any, ...]:
        # What is known where the last of them ended is not known of the others.
        merged: tuple[Any, ...] = self.runtime.at(
            start, lambda: _merged(self.runtime.graph, ends, start, but, _variables)
        )
        return merged

    def finished(self, values: tuple[Any, ...]) -> tuple[Any, ...]:
        """Return the variables where the loop was not broken, for its ``else``."""
        runtime = self.runtime
        ends = list(self.stopped)
        if runtime.path is not None:
            ends.append((runtime.path, values))
        self.ended = [end for end in self.ended if all(end[0] is not stop for stop, _ in self.stopped)]
        self.stopped = []
        if not ends:
            return values
        values = self._merged(ends, self.start, self.first)
        self.first -= {self.over}  # which come last now
        condition = runtime.graph.constant(0)
        for path, _ in ends:
            condition = runtime.graph.or_(condition, path.since(self.start))
        runtime.path = self.start.where(condition, frozenset([self.broken, "else"]))
        return values

    def joined(self, values: tuple[Any, ...]) -> tuple[Any, ...]:
        """Return the variables after the loop."""
        runtime, ends = self.runtime, list(self.ended)
        if runtime.path is not None:
            ends.append((runtime.path, values))
        runtime.exits[self.mark :] = [
            e for e in runtime.exits[self.mark :] if e is not self.broken and e is not self.over
        ]
        if not ends:
            runtime.path = None
            return values
        values = self._merged(ends, self.start, self.first)
        returned = bool(runtime.exits[self.mark :])
        if not returned:
            runtime.path = self.start
        else:
            condition = runtime.graph.constant(0)
            for path, _ in ends:
                condition = runtime.graph.or_(condition, path.since(self.start))
            runtime.path = self.start.where(condition, frozenset(runtime.exits[self.mark :]))
        return values


def _merged(
    graph: Graph,
    ends: Sequence[tuple[Path, Any]],
    start: Path,
    but: Exits,
    join: Callable[[Graph, Node, Any, Any], Any],
) -> Any:
    """Return the value of the first of several ends whose path was taken; one was."""
    value = ends[-1][1]
    for path, earlier in reversed(ends[:-1]):
        value = join(graph, path.since(start, but), earlier, value)
    return value


def _variables(graph: Graph, flag: Node, a: Sequence[Any], b: Sequence[Any]) -> tuple[Any, ...]:
    """Return variables after a choice; one that cannot be joined may be used no more."""
    result: list[Any] = []
    for x, y in zip(a, b, strict=True):
        try:
            result.append(x if x is y else joined(graph, flag, x, y))
        except ArgumentError as error:
            result.append(Undefined(str(error)))
    return tuple(result)


def joined(graph: Graph, flag: Node, a: Any, b: Any) -> Any:
    """Return ``a`` where a flag is set and ``b`` where it is not: words, numbers, and sequences of them.

    Raises
    ------
    ArgumentError
        They have different shapes, or are of no kind that a word can choose.
    """
    if a is b or flag.is_constant():
        return a if a is b or flag.imm else b
    for one in (a, b):
        if isinstance(one, Undefined):
            one._raise()
    if _is_number(a) and _is_number(b):
        return Word(graph, graph.choose(flag, node_of(graph, a), node_of(graph, b)))
    choose = getattr(a, "joined", None) or getattr(b, "joined", None)
    if choose is not None:
        return choose(graph, flag, a, b)
    if isinstance(a, (tuple, list)) and isinstance(b, (tuple, list)):
        if len(a) != len(b):
            raise ArgumentError(
                f"one side of a branch leaves {len(a)} elements and the other {len(b)}; "
                "a length cannot depend on a word"
            )
        parts = [joined(graph, flag, x, y) for x, y in zip(a, b, strict=True)]
        if isinstance(a, list) and isinstance(b, list):
            new = Listed(parts)
            new.path, new.runtime = getattr(a, "path", None), getattr(a, "runtime", None)
            return _chosen(graph, flag, new, a, b)
        kind = type(a) if type(a) is type(b) else tuple
        return kind(*parts) if hasattr(kind, "_fields") else kind(parts)
    if dataclasses.is_dataclass(a) and type(a) is type(b):
        names = [f.name for f in dataclasses.fields(a)]
        values = {name: joined(graph, flag, getattr(a, name), getattr(b, name)) for name in names}
        return _chosen(graph, flag, dataclasses.replace(a, **values), a, b)  # type: ignore[type-var]
    if type(a) is type(b) and not isinstance(a, float) and a == b:
        return a
    for one in (a, b):
        if isinstance(one, float):
            node_of(graph, one)  # says so
    raise ArgumentError(f"one side of a branch leaves {_told(a)} and the other {_told(b)}")


def _chosen(graph: Graph, flag: Node, new: Any, a: Any, b: Any) -> Any:
    """Return what is ``a`` where a flag is set and ``b`` where it is not."""
    if graph.twins is not None:
        graph.twins.chosen(new, [(flag, a), (graph.logical_not(flag), b)])
    return new


def _is_number(value: Any) -> bool:
    return isinstance(value, (Word, int, np.integer, np.bool_))


def _told(value: Any) -> str:
    if isinstance(value, Word):
        return "a word"
    if isinstance(value, (tuple, list)):
        return f"{len(value)} elements"
    if value is None:
        return "nothing"
    return repr(value) if isinstance(value, (int, str, float)) else f"a {type(value).__name__}"
