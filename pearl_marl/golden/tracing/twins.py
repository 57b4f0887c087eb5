"""Lists and objects that may be one another: what a word has chosen is each of several where a flag is set.

Python's ``row = board[y]`` gives a list another name, and what is written by that name shows in ``board``.
Where ``y`` is a word, ``row`` is a list of its own while a function is traced, so a write into one of them is
made in all that may be the same.
"""

from __future__ import annotations

import itertools
import weakref
from collections.abc import Callable, Iterable, Iterator
from typing import Any

from pearl_marl.golden.tracing.graph import Graph
from pearl_marl.golden.tracing.nodes import Node


class Twins:
    """Knows of each list, or object, where it is which of those that an author has made."""

    def __init__(self, graph: Graph) -> None:
        self.graph = graph
        self._numbers = itertools.count()
        self._where: dict[int, dict[int, Node]] = {}
        """By ``id``: the numbers of what a value may be, of all that an author has made, and where."""
        self._places: dict[int, dict[int, tuple[Callable[[], Any], Node]]] = {}
        """By such a number: who may be it, and where."""

    def chosen(self, new: Any, options: Iterable[tuple[Node, Any]]) -> None:
        """Note that something new is each of several where a flag is set, and always one of them."""
        where: dict[int, Node] = {}
        for flag, option in options:
            for number, own in self._which(option).items():
                here = self.graph.and_(flag, own)
                where[number] = self.graph.or_(where[number], here) if number in where else here
        self._note(new, where)

    def _note(self, value: Any, where: dict[int, Node]) -> None:
        key = id(value)
        known = _known(value, lambda: self._forget(key))
        self._where[key] = where
        for number, flag in where.items():
            self._places.setdefault(number, {})[key] = known, flag

    def others(self, of: Any) -> Iterator[tuple[Any, Node]]:
        """Yield who else may be the same, and where it is."""
        same: dict[int, tuple[Callable[[], Any], Node]] = {}
        for number, own in self._where.get(id(of), {}).items():
            # While conditions are made, some may be forgotten.
            for key, (known, flag) in list(self._places[number].items()):
                if key != id(of):
                    here = self.graph.and_(own, flag)
                    same[key] = known, self.graph.or_(same[key][1], here) if key in same else here
        for known, flag in same.values():
            other = known()
            if other is not None and not flag.is_constant(0):
                yield other, flag

    def _which(self, of: Any) -> dict[int, Node]:
        """Return what something may be, and where."""
        if id(of) not in self._where:
            self._note(of, {next(self._numbers): self.graph.constant(1)})
        return self._where[id(of)]

    def _forget(self, key: int) -> None:
        """Forget a value that no longer exists."""
        for number in self._where.pop(key, {}):
            self._places[number].pop(key, None)


def _known(value: Any, forget: Callable[[], None]) -> Callable[[], Any]:
    """Return a function that returns a value as long as it exists; plain lists are kept."""
    try:
        return weakref.ref(value, lambda _: forget())
    except TypeError:
        return lambda: value
