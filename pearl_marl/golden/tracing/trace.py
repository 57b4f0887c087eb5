"""Running a golden function once over symbolic words, which leaves the graph of what it does.

Loops and helpers unroll by themselves. What depends on a word where Python wants a value, such as an ``if``,
is found here, and said in one sentence with the line of the author's file.
"""

from __future__ import annotations

import inspect
import math
import sys
import types
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

from pearl_marl.base.source_lines import (
    author_of,
    is_an_authors,
    is_of_a_library,
    last_line_of_an_author,
    source_line,
)
from pearl_marl.errors import ArgumentError
from pearl_marl.golden.rebinding import Vocabulary, rebound, refused
from pearl_marl.golden.tracing.graph import Graph
from pearl_marl.golden.tracing.nodes import Node
from pearl_marl.golden.tracing.rewriting import RUNTIME, Refusal, rewritten
from pearl_marl.golden.tracing.runtime import Runtime
from pearl_marl.golden.tracing.words import Beyond, Cast, Word, node_of, table

_INSIDE = "pearl_marl.golden.tracing.", "pearl_marl.golden.reals.", "pearl_marl.golden.rebinding", "numpy"


def trace(graph: Graph, function: Callable[..., Any], arguments: Sequence[Node], *agent: int) -> list[Node]:
    """Run a golden function over nodes of a graph, and an agent's number; return the nodes of its results.

    Nodes get the names of the variables that they are assigned to, the author's before those of helpers, and
    the lines they are made in.

    Raises
    ------
    ArgumentError
        The function does what no hardware can, or fails; the message names the file and the line.
    """
    if not isinstance(function, types.FunctionType):
        raise ArgumentError(f"{function!r} is no plain Python function, and a golden function is one")
    words = [*(Word(graph, node) for node in arguments), *agent]
    try:
        inspect.signature(function).bind(*words)
    except TypeError as error:
        raise ArgumentError(
            f"{location(function)}: {function.__name__}() is called with {len(words)} words: {error}"
        ) from None
    with _watched(graph, author_of(function).__code__.co_filename):
        try:
            result = _traced(graph, function)(*words)
        except Refusal:
            raise
        except RecursionError as error:
            raise ArgumentError(
                f"{_place_of(error, function)}: a function calls itself without end: nothing that is known "
                "of words stops it; use `for` and `break`"
            ) from None
        except Exception as error:
            kind = "" if isinstance(error, ArgumentError) else f"{type(error).__name__}: "
            raise ArgumentError(f"{_place_of(error, function)}: {kind}{error}") from error
    nodes = []
    for value in result if isinstance(result, (tuple, list)) else (result,):
        try:
            nodes.append(node_of(graph, value))
        except ArgumentError as error:
            why = str(error)
            if isinstance(value, Beyond) or (isinstance(value, float) and graph.floats is not None):
                why = f"{value!r} where an integer is due; int() and round() make one"
            elif not isinstance(value, float):
                why = f"{value!r}, and an integer is due"
            raise ArgumentError(f"{location(function)}: {function.__name__}() returns {why}") from None
    return nodes


def _traced(graph: Graph, function: types.FunctionType) -> Callable[..., Any]:
    """Return a function made again over words, with calls in the place of decisions."""
    if hasattr(function, "admits"):  # floats, as those of an environment with reals do
        function.admits(graph)
    functions = graph.floats.functions if graph.floats else {}

    def again(met: types.FunctionType) -> Any:
        if not _is_authors(met):
            return met
        return rebound(met, _of_methods(functions).meaning, code=_code, names={**names, **_orders(names)})

    runtime = Runtime(graph, again)
    names = {**runtime.builtins(), RUNTIME: runtime}
    meaning = Vocabulary(Cast, table, functions).meaning
    made: Callable[..., Any] = rebound(function, meaning, code=_code, names=names)
    return made


def _of_methods(functions: Mapping[Any, Callable[..., Any]]) -> Vocabulary:
    """Return the vocabulary of functions that the reference leaves as they are.

    What would be something else there, such as NumPy's casts, is refused.
    """

    def no(value: Any) -> Any:
        hint = " in a method or a function of a list; write a function and call it by its name"
        return refused(value.__name__, hint)

    own = {f: no(f) if f in _FLOATS_OF_PYTHON else made for f, made in functions.items()}
    return Vocabulary(no, table, own)


def _orders(names: Mapping[str, Any]) -> dict[str, Callable[..., Any]]:
    """Return min() and max() of such functions: of reals and floats, Python's own make one or the other."""

    def of_integers(name: str) -> Callable[..., Any]:
        def function(*values: Any, **keywords: Any) -> Any:
            every = list(values[0]) if len(values) == 1 else values
            if any(isinstance(value, Beyond) for value in every):
                raise ArgumentError(f"{name}() of reals in a method; np.{name}imum() takes two, everywhere")
            return names[name](every, **keywords)

        return function

    return {name: of_integers(name) for name in ("min", "max")}


_FLOATS_OF_PYTHON = {math.sin, math.cos, math.sqrt, math.exp, math.tanh, math.hypot, math.fabs, math.pow}
_OUR_OWN = "golden", "fixed_point"
"""The modules of this package, beside its environments, whose functions are written as an author's are."""


def _is_authors(function: types.FunctionType, *own: str) -> bool:
    """Return whether a function is no library's, and of this package an environment's or of ``own``."""
    module: str = function.__globals__.get("__name__", "")
    package, _, rest = module.partition(".")
    return (
        (rest in own or rest.startswith("envs.")) if package == "pearl_marl" else not is_of_a_library(module)
    )


def _code(function: types.FunctionType) -> types.CodeType:
    return rewritten(function.__code__) if _is_authors(function, *_OUR_OWN) else function.__code__


def location(function: Callable[..., Any], line: int | None = None) -> str:
    """Return the file of a golden function and a line in it, by default its first."""
    code = author_of(function).__code__
    return source_line(code.co_filename, line or code.co_firstlineno)


def _place_of(error: BaseException, function: Callable[..., Any]) -> str:
    """Return where an author's code was at work: neither this package's vocabulary nor NumPy."""
    return last_line_of_an_author(error, is_an_authors) or location(function)


@contextmanager
def _watched(graph: Graph, own: str) -> Iterator[None]:
    """Name nodes after the variables they are assigned to, and note lines of the file ``own``."""
    named: dict[Node, bool] = {}

    def watch(frame: types.FrameType, event: str, _: Any) -> Any:
        if event in ("line", "return"):
            authors = frame.f_code.co_filename == own
            for name, value in frame.f_locals.items():
                word = getattr(value, "word", None) if isinstance(value, Beyond) else value
                if isinstance(word, Word) and not name.startswith("_"):
                    node = word.node
                    if node.op not in ("constant", "input") and (
                        node not in named or (authors and not named[node])
                    ):
                        node.name, named[node] = name, authors
        return watch

    def enter(frame: types.FrameType, event: str, _: Any) -> Any:
        # Names within words, reals and NumPy's functions are no author's.
        module = frame.f_globals.get("__name__", "")
        return None if module.startswith(_INSIDE) else watch

    def line() -> int | None:
        frame = inspect.currentframe()
        while frame is not None:
            if frame.f_code.co_filename == own:
                return frame.f_lineno
            frame = frame.f_back
        return None

    before, graph.line, old_line = sys.gettrace(), line, graph.line
    sys.settrace(enter)
    try:
        yield
    finally:
        sys.settrace(before)
        graph.line = old_line
