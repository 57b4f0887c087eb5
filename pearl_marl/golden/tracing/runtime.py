"""What rewritten functions call in the place of what Python decides."""

from __future__ import annotations

import dataclasses
import functools
import operator
import types
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence, ValuesView
from typing import Any, NoReturn

import numpy as np

from pearl_marl.errors import ArgumentError
from pearl_marl.golden.rebinding import TypeLike
from pearl_marl.golden.tracing.branches import Paths
from pearl_marl.golden.tracing.graph import Graph
from pearl_marl.golden.tracing.joining import Listed, Undefined, has_words, joined
from pearl_marl.golden.tracing.nodes import Node
from pearl_marl.golden.tracing.paths import Path
from pearl_marl.golden.tracing.rewriting import RUNTIME
from pearl_marl.golden.tracing.twins import Twins
from pearl_marl.golden.tracing.words import Beyond, Word, check_places, chosen_entry, node_of, word_of


class Runtime(Paths):
    """What rewritten functions call: see :mod:`pearl_marl.golden.tracing.rewriting`."""

    def __init__(
        self, graph: Graph, again: Callable[[types.FunctionType], Any] = lambda function: function
    ) -> None:
        super().__init__(graph)
        self.again = functools.cache(again)
        """Makes a function again that :meth:`called` has met."""
        graph.limits = self.limits
        self.twins = graph.twins = Twins(graph)
        self._birth: Path | None = None
        self._born: dict[int, tuple[Any, Path | None]] = {}
        """By ``id``, objects that :meth:`called` has made, and where."""

    @property
    def birth(self) -> Path | None:
        """The path from which on a new list is seen: the one at hand, if it is not for what is written."""
        return self._birth or self.path

    def called(self, function: Any) -> Any:
        """Return what is called: what no name of a scope has led to, such as a method, over words, too."""
        match function:
            case types.MethodType():
                again = self.called(function.__func__)
                return function if again is function.__func__ else types.MethodType(again, function.__self__)
            case functools.partial():
                again = self.called(function.func)
                same = again is function.func
                return function if same else functools.partial(again, *function.args, **function.keywords)
            case types.FunctionType() if RUNTIME not in function.__globals__:
                return self.again(function)
            case types.BuiltinFunctionType() | types.MethodWrapperType() | types.WrapperDescriptorType():
                if function.__name__ in _WRITING and self.condition_since(self.root) is not None:
                    raise ArgumentError(
                        f"{function.__name__}() writes where a word decides whether it does; assign instead"
                    )
            case type():
                begin = next((n for n in ("__init__", "__post_init__") if _is_written(function, n)), "")
                own = getattr(function, begin) if begin and _is_plain(function) else None
                if own is not None and self.again(own) is not own:
                    return functools.partial(self._made, function, begin)
            case _ if _is_written(type(function), "__call__"):
                call = type(function).__call__
                again = self.again(call)
                return function if again is call else types.MethodType(again, function)
        return function

    def _made(self, cls: Any, begin: str, *arguments: Any, **keywords: Any) -> Any:
        """Return an object of a class whose author has written how it begins."""
        made, again = cls.__new__(cls), self.again(getattr(cls, begin))
        self._born[id(made)] = made, self.path
        if begin == "__init__":
            again(made, *arguments, **keywords)
        elif hasattr(made, "__dict__"):
            # A dataclass calls it by this name when its fields are there.
            made.__dict__[begin] = functools.partial(again, made)
            cls.__init__(made, *arguments, **keywords)
            del made.__dict__[begin]
        else:
            cls.__init__(made, *arguments, **keywords)
        return made

    def advancing(self, iterator: Any) -> Any:
        """Return an iterator that is about to go on, which is no word's to decide."""
        if self.condition_since(self.root) is not None:
            raise ArgumentError("next() where a word decides whether it is; go on before the `if`")
        return iterator

    def unbound(self, name: str) -> Undefined:
        """Return a variable's value before it has one."""
        return Undefined(f"`{name}` has no value on every path that leads here; give it one before")

    def defined(self, value: Any) -> Any:
        """Return an argument of a call, which has to have a value."""
        if isinstance(value, Undefined):
            value.refuse()
        return value

    def condition_since(self, start: Path) -> Node | None:
        """Return the condition that has come about since a path; ``None`` where there is none."""
        if self.path is None:
            return None
        condition = self.path.since(start)
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

    def both(self, a: Any, b: Callable[[], Any]) -> Any:
        """Return ``a and b()``."""
        flag = self.truth(a)
        if isinstance(flag, bool):
            return b() if flag else a
        return joined(self.graph, flag, self.on(flag, b), False)

    def any_of_two(self, a: Any, b: Callable[[], Any]) -> Any:
        """Return ``a or b()``."""
        flag = self.truth(a)
        if isinstance(flag, bool):
            return a if flag else b()
        there = True if isinstance(a, Word) and a.node.is_flag else a
        return joined(self.graph, flag, there, self.on(self.graph.logical_not(flag), b))

    def negation(self, value: Any) -> Any:
        """Return ``not value``."""
        flag = self.truth(value)
        return not flag if isinstance(flag, bool) else Word(self.graph, self.graph.logical_not(flag))

    def chain(self, names: Sequence[str], first: Any, *later: Callable[[], Any]) -> Any:
        """Return a chain of comparisons, which methods of these names make."""
        second = later[0]()
        result = getattr(self, names[0])(first, second)
        if len(names) == 1:
            return result
        return self.both(result, lambda: self.chain(names[1:], second, *later[1:]))

    def equal(self, a: Any, b: Any) -> Any:
        """Return ``a == b``, of sequences of words, too."""
        if isinstance(a, (tuple, list)) and isinstance(b, (tuple, list)):
            if len(a) != len(b) or isinstance(a, tuple) != isinstance(b, tuple):
                return False
            return self.every(self.equal(x, y) for x, y in zip(a, b, strict=True))
        if _is_record(a) and type(a) is type(b):
            names = [field.name for field in dataclasses.fields(a) if field.compare]
            return self.every(self.equal(getattr(a, name), getattr(b, name)) for name in names)
        return a == b

    def differ(self, a: Any, b: Any) -> Any:
        """Return ``a != b``."""
        if isinstance(a, (tuple, list)) or _is_record(a):
            return self.negation(self.equal(a, b))
        return a != b

    def _ordered(self, compare: Callable[[Any, Any], Any], a: Any, b: Any) -> Any:
        """Return a comparison by order, of sequences of words, too."""
        kind = next((k for k in (tuple, list) if isinstance(a, k) and isinstance(b, k)), None)
        if kind is None or not (has_words(a) or has_words(b)):
            return compare(a, b)
        # The first elements that differ decide, and where none does the lengths.
        result: Any = compare(len(a), len(b))
        for k in reversed(range(min(len(a), len(b)))):
            other = self._ordered(compare, a[k], b[k])
            result = self.either(self.equal(a[k], b[k]), lambda: result, lambda: other)  # noqa: B023
        return result

    less = functools.partialmethod(_ordered, operator.lt)
    less_equal = functools.partialmethod(_ordered, operator.le)
    greater = functools.partialmethod(_ordered, operator.gt)
    greater_equal = functools.partialmethod(_ordered, operator.ge)

    def contains(self, value: Any, among: Any) -> Any:
        """Return ``value in among``."""
        if isinstance(among, Word):
            raise ArgumentError("`in` looks into a word, which is no sequence")
        if isinstance(among, range) and isinstance(value, Word) and among.step == 1:
            return (value >= among.start) & (value < among.stop)
        if isinstance(among, (Iterator, ValuesView)):
            among = list(among)
        if not has_words(value) and not (isinstance(among, (tuple, list)) and has_words(among)):
            return value in among
        return self.some(self.equal(value, other) for other in among)

    def lacks(self, value: Any, among: Any) -> Any:
        """Return ``value not in among``."""
        return self.negation(self.contains(value, among))

    def same(self, a: Any, b: Any) -> Any:
        """Return ``a is b``."""
        if (isinstance(a, Word) and b is not None) or (isinstance(b, Word) and a is not None):
            raise ArgumentError("`is` on a word; use `==`")
        for one, flag in () if a is b else self.twins.others(a):
            if one is b:  # where a word has chosen it
                return Word(self.graph, flag)
        return a is b

    def other(self, a: Any, b: Any) -> Any:
        """Return ``a is not b``."""
        return self.negation(self.same(a, b))

    def count(self, among: Any, value: Any) -> Any:
        """Return ``among.count(value)``."""
        if not isinstance(among, (tuple, list)) or not (has_words(value) or has_words(among)):
            return among.count(value)
        return sum(self.flag(self.equal(one, value)) for one in among)

    def index(self, among: Any, value: Any) -> Any:
        """Return ``among.index(value)``: where a value is, which is there."""
        if not isinstance(among, (tuple, list)) or not (has_words(value) or has_words(among)):
            return among.index(value)
        if self.truth(self.contains(value, among)) is False:
            raise ArgumentError("index() of a value that no element can be")
        result: Any = len(among) - 1
        for place in range(len(among) - 2, -1, -1):
            result = self.either(self.equal(among[place], value), lambda: place, lambda: result)  # noqa: B023
        return result

    def every(self, values: Iterable[Any]) -> Any:
        """Return whether all values are true."""
        result: Any = True
        for value in values:
            result = self.flag(value) & result
            if result is False:
                break
        return result

    def some(self, values: Iterable[Any]) -> Any:
        """Return whether any value is true."""
        result: Any = False
        for value in values:
            result = self.flag(value) | result
            if result is True:
                break
        return result

    def flag(self, value: Any = False) -> Any:
        """Return ``bool(value)``."""
        flag = self.truth(value)
        return flag if isinstance(flag, bool) else Word(self.graph, flag)

    def item(self, of: Any, index: Any) -> Any:
        """Return an element, which a word may choose."""
        if isinstance(index, tuple) and isinstance(of, (tuple, list)):
            check_places(index)
            for part in index:
                of = self.item(of, part)
            return of
        if isinstance(of, Word):
            raise ArgumentError("a word has no elements; its bits are `word >> k & 1`")
        if not isinstance(index, Word):
            _check_ends(index)
            found = of[index]
            return self.listed(found) if isinstance(found, list) and isinstance(index, slice) else found
        if isinstance(of, Undefined):
            of.refuse()
        if isinstance(of, (tuple, list)) and any(isinstance(one, (float, Beyond)) for one in of):
            return self._floats().chosen(Word(self.graph, self.index_within(of, index)), of)
        if isinstance(of, (tuple, list, range)):
            return chosen_entry(self.graph, of, self.index_within(of, index))
        if isinstance(of, dict):
            return self._entry(of, index)
        raise ArgumentError(
            f"a word chooses from {type(of).__name__}; it chooses from lists, tuples and dicts"
        )

    def _entry(self, of: dict[Any, Any], key: Word) -> Any:
        """Return the value of a key that is a word, for every number that it can be."""
        low, high = self.limits(node_of(self.graph, key))
        missing = next((k for k in range(low, high + 1) if k not in of), None)
        if missing is not None:
            raise ArgumentError(
                f"a key can be {low} to {high}, and the dict has no {missing}; `min`, `max` or an `if` keeps "
                "it in"
            )
        return self.item([of[k] for k in range(low, high + 1)], key - low)

    def limits(self, node: Node) -> tuple[int, int]:
        """Return between what a node is on the path at hand, which may say more than the node itself."""
        low, high = node.low, node.high
        if self.path is None or low == high:
            return low, high
        for end in (low, high):
            inside = self.graph.choose(self.here.condition, node, self.graph.constant(end))
            # Of the constant it is the other end that counts.
            low, high = (low, min(high, inside.high)) if end == node.low else (max(low, inside.low), high)
        return low, high

    def index_within(self, of: Sequence[Any], index: Word) -> Node:
        """Return the node of an index, which is within a sequence."""
        node = node_of(self.graph, index)
        low, high = node.low, node.high
        if low < 0 or high >= len(of):
            low, high = self.limits(node)
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
            node, graph = self.index_within(of, index), self.graph
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
        _check_ends(key)
        if isinstance(key, slice):  # what is written may be the list itself
            value = list(value)
        for one, flags in self._same(of, where):
            if isinstance(key, slice) and flags:
                places = range(len(one))[key]
                if len(places) != len(value):
                    self._changes(one, "")
                for place, new in zip(places, value, strict=True):
                    one[place] = self._changed(one, flags, new, one[place])
                continue
            if isinstance(one, dict) and flags and key not in one:
                self._changes(one, "")
            one[key] = self._changed(one, flags, value, one[key]) if flags else value

    def set_attribute(self, of: Any, name: str, value: Any) -> None:
        """Write an attribute, where the path at hand is taken, and in all that may be the same object."""
        if isinstance(of, (type, types.ModuleType, types.FunctionType)):
            raise ArgumentError(
                f"attribute {name!r} of what all slots share is written; return it, or keep it in the state"
            )
        if isinstance(of, tuple) and name in getattr(of, "_fields", ()):
            kind = type(of).__name__
            raise ArgumentError(
                f"attribute {name!r} of a NamedTuple is written: take `_replace({name}=...)`, or make "
                f"{kind} a dataclass"
            )
        for one, flags in self._same(of):
            if flags and not hasattr(one, name):
                raise ArgumentError(
                    f"attribute {name!r} is new where a word decides whether it is; give it a value before"
                )
            setattr(one, name, self._changed(one, flags, value, getattr(one, name)) if flags else value)

    def _same(self, of: Any, where: Node | None = None) -> list[tuple[Any, list[Node]]]:
        """Return what a write goes to, each with the flags under which it does."""
        result = []
        for one, flag in [(of, None), *self.twins.others(of)]:
            flags = [self.condition_since(self._start(one))]
            result.append((one, [f for f in (*flags, where, flag) if f is not None and not f.is_constant(1)]))
        return result

    def _start(self, of: Any) -> Path:
        """Return the path from which on a list, or an object, is seen."""
        _, born = self._born.get(id(of), (None, None))
        start = (of.path if isinstance(of, Listed) else born) or self.root
        # A list that was made on a side that has been left is seen by its own path only.
        is_seen = self.path is None or self.path.literals[: len(start.literals)] == start.literals
        return start if is_seen else self.root

    def _changed(self, of: Any, flags: Sequence[Node], value: Any, old: Any) -> Any:
        """Return a value, to be in a list or an object, where all flags are set, and an old one where not."""
        flag = functools.reduce(self.graph.and_, flags)
        if isinstance(value, Word):
            value = word_of(self.graph, value)
        # The old one is looked at where this path is not taken: what is known here is not known of it.
        # If they are lists, so is a new one, which is seen wherever the one around it is.
        before, self._birth = self._birth, self._start(of)
        try:
            here = dataclasses.replace(self.here, known={})
            return self.at(here, lambda: joined(self.graph, flag, value, old))
        finally:
            self._birth = before

    def growing(self, of: Any, verb: str = "") -> Any:
        """Return a list, which is about to become longer or shorter: that is no word's to decide."""
        if isinstance(of, list) and verb in ("sort", "remove") and has_words(of):
            raise ArgumentError(f"{verb}() of a list of words: their order is not known before hardware runs")
        if isinstance(of, (Word, Beyond, int)):
            return of
        if isinstance(of, (list, dict, set, deque)):
            if any(flags for _, flags in self._same(of)):
                self._changes(of, verb)
        # `of += 1` may call what its author has written.
        elif (
            not verb
            and any(_is_written(type(of), f"__{name}__") for name in _IN_PLACE)
            and self.condition_since(self._start(of)) is not None
        ):
            raise ArgumentError(
                f"an operator of {type(of).__name__} changes it where a word decides; write a function"
            )
        return of

    def _changes(self, of: Any, verb: str) -> NoReturn:
        """Refuse a change that no word can decide."""
        if verb in ("sort", "reverse"):
            raise ArgumentError(f"{verb}() of a list where a word decides whether it is; write its elements")
        if isinstance(of, list):
            raise ArgumentError(
                "a list grows or shrinks where a word decides whether it does; give it its full length before"
            )
        raise ArgumentError(
            f"a {type(of).__name__} changes where a word decides whether it does; use a list of a flag, or a "
            "number, for each that it may hold"
        )

    def listed(self, values: Iterable[Any] = ()) -> Listed:
        """Return a list whose elements may be written by words."""
        result = Listed(values)
        result.path, result.runtime = self.path, self
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
            "bool": TypeLike(bool, self.flag, _is_bool),
            "int": TypeLike(int, self._whole, lambda value: isinstance(value, (int, Word))),
            "list": TypeLike(list, self.listed),
            "round": self._rounded,
            "divmod": lambda a, b: (a // b, a % b),
            "map": TypeLike(map, lambda function, *values: map(self.called(function), *values)),
            "filter": TypeLike(filter, lambda function, values: filter(self.called(function), values)),
            "range": TypeLike(range, _range),
            "sorted": self._sorted,
            "print": _print,
            "set": TypeLike(set, _no_set),
            "setattr": self.set_attribute,
        }

    def _least(self, native: Any, operation: str, values: Sequence[Any], keywords: dict[str, Any]) -> Any:
        every = list(values[0]) if len(values) == 1 else list(values)
        key = keywords.get("key")
        if every:
            keywords = {name: value for name, value in keywords.items() if name != "default"}
        if key is None and any(isinstance(value, (float, Beyond)) for value in every):
            return self._floats().functions[native](every, **keywords)
        keys = every if key is None else list(map(self.called(key), every))
        if not has_words(keys):
            return native(every, **keywords)
        if key is None and all(isinstance(value, (Word, int, np.integer, np.bool_)) for value in every):
            nodes = [node_of(self.graph, value) for value in every]
            result = nodes[0]
            for node in nodes[1:]:
                result = getattr(self.graph, operation)(result, node)
            return Word(self.graph, result)
        # The first of those that are the least is Python's.
        before = self.less if native is min else self.greater
        found, best = every[0], keys[0]
        for value, own in zip(every[1:], keys[1:], strict=True):
            is_it = before(own, best)
            found = self.either(is_it, lambda: value, lambda: found)  # noqa: B023
            best = self.either(is_it, lambda: own, lambda: best)  # noqa: B023
        return found

    def _rounded(self, value: Any, digits: int | None = None) -> Any:
        if isinstance(value, Word) and (digits is None or digits >= 0):
            return value
        return round(value, digits)

    def type_of(self, value: Any) -> Any:
        """Return the type of what is the same for Python and here."""
        if isinstance(value, (Word, Beyond, int, float, list, set, range)):
            raise ArgumentError(
                "type() of a number or a list, which is of another one before hardware runs; isinstance() "
                "tells numbers from lists"
            )
        return type(value)

    def _whole(self, value: Any = 0, *base: Any) -> Any:
        if isinstance(value, Beyond):
            return self._floats().functions[int](value)
        return value if isinstance(value, Word) else int(value, *base)

    def _floats(self) -> Any:
        """Return what floats do, where the environment has reals."""
        if self.graph.floats is None:
            raise ArgumentError("a float where words are; its state has no reals, such as Real[-1, 1]")
        return self.graph.floats

    def _sorted(self, values: Iterable[Any], **keywords: Any) -> Any:
        every, key = list(values), keywords.get("key")
        # What it is sorted by may be words where the elements are none.
        if not any(map(has_words, every if key is None else [self.called(key)(value) for value in every])):
            return self.listed(sorted(every, **keywords))
        raise ArgumentError("sorted() of words; pearl_marl.golden.inserted puts one into its place")


_IN_PLACE = "iadd", "isub", "imul", "ifloordiv", "imod", "iand", "ior", "ixor", "ilshift", "irshift"
_WRITING = {
    *("setitem", "delitem", "iconcat", "__setitem__", "__delitem__", "__setattr__", "__delattr__"),
    *("heappush", "heappop", "heapify", "heapreplace", "heappushpop"),
}
"""Functions of Python's that change what they are given."""


def _is_written(cls: type, name: str) -> bool:
    """Return whether a method of a class is written in Python, by hand."""
    method = getattr(cls, name, None)
    return isinstance(method, types.FunctionType) and method.__code__.co_filename != "<string>"


def _is_plain(cls: Any) -> bool:
    """Return whether objects of a class are made as Python makes them."""
    return bool(cls.__new__ is object.__new__)


def _is_record(value: Any) -> bool:
    """Return whether a value is an object of a dataclass that compares its fields."""
    parameters = getattr(type(value), "__dataclass_params__", None)
    return parameters is not None and bool(parameters.eq)


def _is_bool(value: Any) -> bool:
    if isinstance(value, Word):
        raise ArgumentError("isinstance() asks whether a word is a bool, and a flag is a word like others")
    return isinstance(value, bool)


def _range(*args: Any) -> range:
    if any(isinstance(a, Word) and not a.node.is_constant() for a in args):
        raise ArgumentError(
            "range() of a word; go over all rounds that there can be, and `break` where it is enough"
        )
    return range(*args)


def _check_ends(index: Any) -> None:
    """Refuse a slice that a word ends."""
    if isinstance(index, slice) and any(
        isinstance(end, Word) and not node_of(end.graph, end).is_constant()
        for end in (index.start, index.stop, index.step)
    ):
        raise ArgumentError(
            "a word ends a slice, and its length would depend on it; take all elements, and an `if` for each "
            "that tells whether it counts"
        )


def _print(*values: Any, **keywords: Any) -> None:
    if any(map(has_words, values)):
        raise ArgumentError("print() of a word, which has no value before hardware runs")
    print(*values, **keywords)


def _no_set(values: Iterable[Any] = ()) -> set[Any]:
    every = list(values)
    if any(map(has_words, every)):
        raise ArgumentError("a set of words; golden functions have lists and tuples of them")
    return set(every)
