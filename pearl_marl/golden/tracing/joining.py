"""Values of an author's variables where paths meet: one of two, by a flag."""

from __future__ import annotations

import copy
import dataclasses
from collections.abc import Callable, Iterable, Sequence
from typing import Any, NoReturn

import numpy as np

from pearl_marl.errors import ArgumentError
from pearl_marl.golden.tracing.graph import Graph
from pearl_marl.golden.tracing.nodes import Node
from pearl_marl.golden.tracing.paths import Exits, Path
from pearl_marl.golden.tracing.words import Beyond, Word, node_of


class Undefined:
    """What a variable holds where it has no value on some path, or values that cannot be one."""

    def __init__(self, why: str) -> None:
        object.__setattr__(self, "_why", why)

    def refuse(self, *_: Any, **__: Any) -> NoReturn:
        """Say why it has no value."""
        raise ArgumentError(object.__getattribute__(self, "_why"))

    __getattr__ = __setattr__ = refuse


_BINARY = "add", "sub", "mul", "floordiv", "truediv", "mod", "pow", "and", "or", "xor", "lshift", "rshift"
for _name in (
    *_BINARY,
    *(f"r{name}" for name in _BINARY),
    *("eq", "ne", "lt", "le", "gt", "ge", "bool", "index", "int", "float", "iter", "len"),
    *("getitem", "setitem", "call", "neg", "pos", "abs", "invert", "contains"),
):
    setattr(Undefined, f"__{_name}__", Undefined.refuse)


class Listed(list[Any]):
    """A list of a golden function: a word may choose its elements, and its length depends on no word."""

    path: Path | None = None
    """The path on which it was made."""
    runtime: Any = None
    """What it was made by: it knows where a word decides."""

    def _new(self, values: Iterable[Any]) -> list[Any]:
        """Return another list, made where the author is."""
        made: list[Any] = list(values) if self.runtime is None else self.runtime.listed(values)
        return made

    def copy(self) -> list[Any]:
        """Return a list of the same elements."""
        return self._new(self)

    __copy__ = copy

    def __deepcopy__(self, memo: Any) -> list[Any]:
        return self._new(copy.deepcopy(value, memo) for value in self)

    def __add__(self, other: Any) -> Any:
        return self._new(super().__add__(other)) if isinstance(other, list) else NotImplemented

    def __mul__(self, count: Any) -> Any:
        if isinstance(count, Word) and not node_of(count.graph, count).is_constant():
            raise ArgumentError("a list as long as a word says; give it its full length")
        return self._new(super().__mul__(count))

    __rmul__ = __mul__


def _growing(name: str) -> Callable[..., Any]:
    def method(self: Listed, *args: Any, **keywords: Any) -> Any:
        if self.runtime is not None:
            self.runtime.growing(self)
        return getattr(list, name)(self, *args, **keywords)

    return method


for _name in (
    *("append", "extend", "insert", "pop", "remove", "clear", "sort", "reverse"),
    *("__delitem__", "__iadd__"),
):
    setattr(Listed, _name, _growing(_name))


def check_defined(value: Any) -> None:
    """Refuse what holds a variable without a value."""
    if isinstance(value, Undefined):
        value.refuse()
    if isinstance(value, (tuple, list)):
        for part in value:
            check_defined(part)


def has_words(value: Any) -> bool:
    """Return whether a value is a word, or holds one."""
    if isinstance(value, (tuple, list)):
        return any(map(has_words, value))
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return any(has_words(getattr(value, field.name)) for field in dataclasses.fields(value))
    return isinstance(value, (Word, Beyond))


def merged(
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


def variables(graph: Graph, flag: Node, a: Sequence[Any], b: Sequence[Any]) -> tuple[Any, ...]:
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
            one.refuse()
    if _is_number(a) and _is_number(b):
        node = graph.choose(flag, node_of(graph, a), node_of(graph, b))
        if graph.certain:  # outside of all branches it is right everywhere, of whatever it is a choice
            node.loose = False
        return Word(graph, node)
    if graph.floats is not None and all(isinstance(x, (float, Beyond)) or _is_number(x) for x in (a, b)):
        return graph.floats.select(Word(graph, flag), a, b)
    if isinstance(a, (tuple, list)) and isinstance(b, (tuple, list)):
        if len(a) != len(b):
            raise ArgumentError(
                f"one side of a branch leaves {len(a)} elements and the other {len(b)}; "
                "a length cannot depend on a word"
            )
        parts = [joined(graph, flag, x, y) for x, y in zip(a, b, strict=True)]
        if isinstance(a, list) and isinstance(b, list):
            new = Listed(parts)
            new.runtime = getattr(a, "runtime", None) or getattr(b, "runtime", None)
            # It is made here, not on the side that one of them may be from.
            new.path = None if new.runtime is None else new.runtime.birth
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
    if callable(a) and callable(b):
        raise ArgumentError("a word chooses between two functions; call each on its side of the branch")
    if type(a) is type(b) and hasattr(a, "__dict__"):
        name = type(a).__name__
        raise ArgumentError(
            f"a word chooses between two objects of {name}; make {name} a NamedTuple or a dataclass"
        )
    raise ArgumentError(f"one side of a branch leaves {_described(a)} and the other {_described(b)}")


def _chosen(graph: Graph, flag: Node, new: Any, a: Any, b: Any) -> Any:
    """Return what is ``a`` where a flag is set and ``b`` where it is not."""
    if graph.twins is not None:
        graph.twins.chosen(new, [(flag, a), (graph.logical_not(flag), b)])
    return new


def _is_number(value: Any) -> bool:
    return isinstance(value, (Word, int, np.integer, np.bool_))


def _described(value: Any) -> str:
    if isinstance(value, Word):
        return "a word"
    if isinstance(value, (tuple, list)):
        return f"{len(value)} elements"
    if value is None:
        return "nothing"
    return repr(value) if isinstance(value, (int, str, float)) else f"a {type(value).__name__}"
