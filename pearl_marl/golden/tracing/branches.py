"""What becomes of an author's branches while a function is traced.

A *path* is the condition under which the statement at hand runs. A :class:`Fork` runs both sides of an
``if``, each on its path, and joins the variables that they leave. A ``return``, ``break`` or ``continue``
ends a path; what it takes along is joined where it arrives, in the order in which paths ended. An element of
a list is written under the condition of its path, so a list that keeps its name need not be joined.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Sequence
from typing import Any

from pearl_marl.errors import ArgumentError
from pearl_marl.golden.tracing.graph import Graph
from pearl_marl.golden.tracing.joining import check_defined, joined, merged, variables
from pearl_marl.golden.tracing.nodes import Node
from pearl_marl.golden.tracing.paths import Exits, Literal, Path
from pearl_marl.golden.tracing.words import Beyond, Word, flag_of, node_of

MOST_ROUNDS = 1000
"""Rounds after which a ``while`` counts as one without a bound."""


class Paths:
    """Knows the path of the statement at hand."""

    def __init__(self, graph: Graph) -> None:
        self.graph = graph
        self.root = Path(graph)
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
        self.graph.certain = path is not None and not path.literals
        self.graph.decided_in = None if path is None else path.line

    @property
    def here(self) -> Path:
        """The path at hand, where one is."""
        assert self._path is not None
        return self._path

    def frame(self) -> CallPaths:
        """Return what keeps the paths of a call."""
        return CallPaths(self)

    def truth(self, value: Any) -> bool | Node:
        """Return whether a value counts as true: a flag, where that depends on a word."""
        if isinstance(value, Beyond):
            value = value.__ne__(0)
        if not isinstance(value, Word):
            return bool(value)
        flag = flag_of(self.graph, node_of(self.graph, value))
        decided = self.here.decided(flag)
        return flag if decided is None else decided

    def at(self, path: Path, function: Callable[[], Any]) -> Any:
        """Return what a function gives on a path."""
        before, self.path = self.path, path
        try:
            return function()
        finally:
            self.path = before


class CallPaths:
    """The paths of one call of a function."""

    def __init__(self, runtime: Paths) -> None:
        self.runtime, self.entry, self.mark = runtime, runtime.here, len(runtime.exits)
        self.results: list[tuple[Path, Any]] = []

    def lives(self) -> bool:
        """Return whether any path is left."""
        return self.runtime.path is not None

    def fork(self, test: Any, before: tuple[Any, ...]) -> Fork:
        """Return what keeps the sides of an ``if``."""
        return Fork(self.runtime, test, before)

    def loop(self) -> LoopPaths:
        """Return what keeps the rounds of a loop."""
        return LoopPaths(self)

    def returns(self, value: Any) -> None:
        """End a path by ``return``."""
        check_defined(value)
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
        counts = sorted({len(value) for _, value in self.results if type(value) is tuple})
        if len(counts) > 1:
            raise ArgumentError(
                f"one `return` gives {counts[0]} values and another {counts[-1]}; each has to give the same"
            )
        return merged(runtime.graph, self.results, self.entry, frozenset([self]), joined)


class Fork:
    """The two sides of an ``if``."""

    def __init__(self, runtime: Paths, test: Any, before: tuple[Any, ...]) -> None:
        self.runtime, self.before, self.start = runtime, before, runtime.here
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
        after: tuple[Any, ...] = runtime.at(self.start, lambda: variables(graph, flag, a, b))
        return after


def _retagged(path: Path, place: int, exits: Exits) -> Path:
    literals = list(path.literals)
    literals[place] = Literal(literals[place].flag, exits)
    return dataclasses.replace(path, literals=tuple(literals))


class LoopPaths:
    """The rounds of a ``for`` or a ``while``."""

    def __init__(self, frame: CallPaths) -> None:
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
        ends, self.continued = self.continued, []
        if runtime.path is not None:
            ends.append((runtime.path, values))
        runtime.exits[self.mark :] = [e for e in runtime.exits[self.mark :] if e is not self.passed]
        if ends:
            values = self._merged(ends, self.round, frozenset([self.frame, self.broken, self.passed]))
            path, begin = self.round, len(self.round.literals)
            exits = {e for end, _ in ends for lit in end.literals[begin:] for e in lit.exits}
            lost = frozenset(exits - {self.passed})
            if lost or runtime.exits[self.mark :]:
                path = path.where(self._reached(path, ends), lost or frozenset([self.frame]))
            runtime.path = path
        self.round = runtime.path or self.round
        return values

    def _reached(self, start: Path, ends: Sequence[tuple[Path, Any]]) -> Node:
        """Return whether any of some ends is reached from a path."""
        graph = self.runtime.graph
        return functools.reduce(graph.or_, (path.since(start) for path, _ in ends), graph.constant(0))

    def _merged(self, ends: Sequence[tuple[Path, Any]], start: Path, but: Exits) -> tuple[Any, ...]:
        # What is known where the last of them ended is not known of the others.
        values: tuple[Any, ...] = self.runtime.at(
            start, lambda: merged(self.runtime.graph, ends, start, but, variables)
        )
        return values

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
        runtime.path = self.start.where(self._reached(self.start, ends), frozenset([self.broken, "else"]))
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
        runtime.path, returned = self.start, frozenset(runtime.exits[self.mark :])
        if returned:
            runtime.path = self.start.where(self._reached(self.start, ends), returned)
        return values
