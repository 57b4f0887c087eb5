"""Running a golden function once over symbolic words, which leaves the graph of what it does.

Loops and helpers unroll by themselves. What depends on a word where Python wants a value, such as an ``if``,
is found here, and said in one sentence with the line of the author's file.
"""

from __future__ import annotations

import inspect
import operator
import os
import sys
import types
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any, NoReturn

import numpy as np

from pearl_marl.compiler.graph import Graph
from pearl_marl.compiler.nodes import Node
from pearl_marl.compiler.operations import wrapped
from pearl_marl.compiler.remaking import remade
from pearl_marl.errors import ArgumentError

_HERE = os.path.dirname(__file__)

MOST_SHIFT = 63
"""The most that a word is shifted to the left by: a field has 64 bits."""


def _binary(operation: str, swapped: bool = False, negated: bool = False) -> Callable[[Any, Any], Any]:
    """Return the method of a word for an operation of graphs, with another word or a number."""

    def method(self: Word, other: object) -> Word:
        graph, words = self.graph, (self.node, _node(self.graph, other))
        node: Node = getattr(graph, operation)(*(reversed(words) if swapped else words))
        return Word(graph, graph.logical_not(node) if negated else node)

    return method


def _both(operation: str) -> tuple[Callable[[Any, Any], Any], Callable[[Any, Any], Any]]:
    return _binary(operation), _binary(operation, swapped=True)


def _shift(operation: str) -> tuple[Callable[[Any, Any], Any], Callable[[Any, Any], Any]]:
    shift = _binary(operation)

    def checked(value: Any, by: Any) -> Any:
        node = _node(value.graph, by)
        if node.low < 0 or (operation == "left_by" and node.high > MOST_SHIFT):
            raise ArgumentError(
                f"{_place()}: a shift can be by {node.low} to {node.high}; possible are 0 to {MOST_SHIFT}"
            )
        return shift(value, by)

    return checked, lambda self, value: checked(_word(self.graph, value), self)


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
            f"{_place()}: a word decides what Python does next (`if`, `and`, `or`, `not`, `while`, `min`, "
            "`max`); use np.where, `&`, `|` and comparisons instead"
        )

    def __index__(self) -> int:
        if self.node.is_constant():
            return int(self.node.imm)
        raise ArgumentError(
            f"{_place()}: Python needs a number here, and a word has none before hardware runs"
        )

    __int__ = __index__

    def __float__(self) -> NoReturn:
        raise ArgumentError(f"{_place()}: a word becomes a float; golden functions work on integers")

    def __iter__(self) -> NoReturn:
        raise ArgumentError(f"{_place()}: a word is taken apart like a sequence")

    def __truediv__(self, other: object) -> NoReturn:
        raise ArgumentError(f"{_place()}: `/` makes a float; golden functions divide by `//`")

    __rtruediv__ = __truediv__

    def __pow__(self, exponent: object) -> Word:
        if not isinstance(exponent, int) or exponent < 0:
            raise ArgumentError(f"{_place()}: a power of a word has a constant exponent from 0")
        node = self.graph.constant(1)
        for _ in range(exponent):
            node = self.graph.mul(node, self.node)
        return Word(self.graph, node)

    def __floordiv__(self, other: object) -> Word:
        return Word(self.graph, self.graph.floor_divide(self.node, self._divisor(other)))

    def __mod__(self, other: object) -> Word:
        return Word(self.graph, self.graph.modulo(self.node, self._divisor(other)))

    def _divisor(self, other: object) -> Node:
        node = _node(self.graph, other)
        if not node.is_constant() or node.imm < 1:
            raise ArgumentError(f"{_place()}: `//` and `%` take a constant divisor from 1")
        return node

    def __rfloordiv__(self, other: object) -> NoReturn:
        raise ArgumentError(f"{_place()}: `//` and `%` take a constant divisor from 1")

    __rmod__ = __rfloordiv__

    def __neg__(self) -> Word:
        return Word(self.graph, self.graph.sub(self.graph.constant(0), self.node))

    def __pos__(self) -> Word:
        return self

    def __abs__(self) -> Word:
        return Word(self.graph, self.graph.maximum(self.node, (-self).node))

    def __invert__(self) -> Word:
        return Word(self.graph, self.graph.invert(self.node))

    def __array_ufunc__(self, ufunc: Any, method: str, *inputs: Any, **keywords: Any) -> Word:
        made = _UFUNCS.get(ufunc.__name__)
        if made is None or method != "__call__" or keywords:
            _refuse_numpy(ufunc.__name__)
        return _word(self.graph, made(*(_word(self.graph, x) for x in inputs)))

    def __array_function__(self, function: Any, types_: Any, args: Any, keywords: Any) -> Word:
        if function is np.where and len(args) == 3:
            flag, a, b = (_node(self.graph, x) for x in args)
            if not flag.is_flag:
                flag = self.graph.logical_not(self.graph.equal(flag, self.graph.constant(0)))
            return Word(self.graph, self.graph.choose(flag, a, b))
        if function is np.clip and len(args) == 3:
            value, low, high = (_node(self.graph, x) for x in args)
            return Word(self.graph, self.graph.minimum(self.graph.maximum(value, low), high))
        _refuse_numpy(function.__name__)


_UFUNCS: dict[str, Any] = {
    "minimum": _binary("minimum"),
    "maximum": _binary("maximum"),
    "absolute": operator.abs,
    "negative": operator.neg,
    "invert": operator.invert,
    **{f"bitwise_{name}": getattr(operator, f"{name}_") for name in ("and", "or")},
    "bitwise_xor": operator.xor,
    "logical_and": lambda a, b: (a != 0) & (b != 0),
    "logical_or": lambda a, b: (a != 0) | (b != 0),
    "logical_not": lambda a: a == 0,
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


def _refuse_numpy(name: str) -> NoReturn:
    raise ArgumentError(
        f"{_place()}: golden functions have no np.{name}; of NumPy they have where, minimum, maximum and clip"
    )


def _word(graph: Graph, value: object) -> Word:
    return Word(graph, _node(graph, value))


def _node(graph: Graph, value: object) -> Node:
    return value.node if isinstance(value, Word) else graph.constant(_integer(value))


def _integer(value: object) -> int:
    if isinstance(value, (float, np.floating, complex)):
        raise ArgumentError(f"{_place()}: {value!r} is a float; golden functions work on integers")
    try:
        return operator.index(value)  # type: ignore[arg-type]
    except TypeError:
        if isinstance(value, np.bool_):
            return int(value)
        raise ArgumentError(
            f"{_place()}: {value!r} is no integer; golden functions work on integers"
        ) from None


class _Cast:
    """A type of NumPy's, called: its value modulo ``2**bits``."""

    def __init__(self, dtype: type[np.integer[Any]]) -> None:
        self.bits, self.signed = np.dtype(dtype).itemsize * 8, issubclass(dtype, np.signedinteger)

    def __call__(self, value: object = 0) -> Any:
        if isinstance(value, Word):
            return Word(value.graph, value.graph.wrap(value.node, self.bits, self.signed))
        return wrapped(_integer(value), self.bits, self.signed)


class _Table(tuple[Any, ...]):
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
            return _Table(found) if isinstance(index, slice) else found
        node = index.node
        if node.low < 0 or node.high >= len(self):
            raise ArgumentError(
                f"{_place()}: an index can be {node.low} to {node.high}, "
                f"and the table has {len(self)} entries"
            )
        return _chosen(index.graph, list(self), node)


def _chosen(graph: Graph, entries: list[Any], index: Node) -> Any:
    """Return the entry that a word chooses: a word, or a table of such words."""
    if all(isinstance(entry, _Table) for entry in entries):
        return _Table(_chosen(graph, list(column), index) for column in zip(*entries, strict=True))
    nodes = [_node(graph, entry) for entry in entries]
    if all(node.is_constant() for node in nodes):
        return Word(graph, graph.table([node.imm for node in nodes], index))
    result = nodes[index.high]
    for i in range(index.high - 1, index.low - 1, -1):
        result = graph.choose(graph.equal(index, graph.constant(i)), nodes[i], result)
    return Word(graph, result)


class _NumPy:
    """What of NumPy a golden function may name."""

    def __getattr__(self, name: str) -> Any:
        value = getattr(np, name)
        if name in ("where", "minimum", "maximum", "clip") or isinstance(value, int):
            return value
        if isinstance(value, type) and issubclass(value, np.integer):
            return _Cast(value)
        return _refuse_numpy(name)


def _stand_in(value: Any) -> Any:
    """Return what a name in the scope of a golden function stands for while it is traced."""
    if value is np:
        return _NumPy()
    if isinstance(value, type) and issubclass(value, np.integer):
        return _Cast(value)
    if isinstance(value, np.ndarray):
        return _table(value.tolist())
    if isinstance(value, (list, tuple)) and type(value) in (list, tuple):
        return _table(value)
    return _Module(value) if isinstance(value, types.ModuleType) else value


def _table(values: Any) -> Any:
    return _Table(_table(v) if isinstance(v, (list, tuple)) else v for v in values)


class _Module:
    """A module of which a golden function names functions and constants."""

    def __init__(self, module: types.ModuleType) -> None:
        self._module = module

    def __getattr__(self, name: str) -> Any:
        value, module = getattr(self._module, name), self._module.__name__
        if isinstance(value, types.FunctionType) and module not in ("random", "secrets"):
            return remade(value, _stand_in)
        if callable(value) and not isinstance(value, type):
            hint = "; random draws come as arguments" if module in ("random", "secrets") else ""
            raise ArgumentError(f"{_place()}: golden functions cannot use {module}.{name}{hint}")
        return _stand_in(value)


def trace(graph: Graph, function: Callable[..., Any], arguments: Sequence[Node]) -> list[Node]:
    """Run a golden function over nodes of a graph; return the nodes of its results.

    Nodes get the names of the variables that they are assigned to, the author's before those of helpers, and
    the lines they are made in.

    Raises
    ------
    ArgumentError
        The function does what no hardware can, or fails; the message names the file and the line.
    """
    if not isinstance(function, types.FunctionType):
        raise ArgumentError(f"{function!r} is no plain Python function, and a golden function is one")
    own = function.__code__.co_filename
    words = [Word(graph, node) for node in arguments]
    with _watched(graph, own):
        try:
            inspect.signature(function).bind(*words)
        except TypeError as error:
            raise ArgumentError(
                f"{_where(own, function.__code__.co_firstlineno)}: {function.__name__}() is called with "
                f"{len(words)} words: {error}"
            ) from None
        try:
            result = remade(function, _stand_in)(*words)
        except ArgumentError:
            raise
        except Exception as error:
            line = _line_of(error, own)
            raise ArgumentError(f"{_where(own, line)}: {type(error).__name__}: {error}") from error
        place = _where(own, function.__code__.co_firstlineno)
        results = result if isinstance(result, tuple) else (result,)
        try:
            return [_node(graph, value) for value in results]
        except ArgumentError as error:
            raise ArgumentError(
                f"{place}: {function.__name__}() returns " + str(error).split(": ", 1)[1]
            ) from None


@contextmanager
def _watched(graph: Graph, own: str) -> Iterator[None]:
    """Name nodes after the variables they are assigned to, and note lines of the file ``own``."""
    named: dict[Node, bool] = {}

    def watch(frame: types.FrameType, event: str, _: Any) -> Any:
        if event in ("line", "return"):
            authors = frame.f_code.co_filename == own
            for name, value in frame.f_locals.items():
                if isinstance(value, Word) and not name.startswith("_"):
                    node = value.node
                    if node.op not in ("constant", "input") and (
                        node not in named or (authors and not named[node])
                    ):
                        node.name, named[node] = name, authors
        return watch

    def enter(frame: types.FrameType, event: str, _: Any) -> Any:
        # NumPy's own functions have names for their arguments that are not the author's.
        foreign = frame.f_globals.get("__name__", "").startswith("numpy")
        return None if foreign or frame.f_code.co_filename.startswith(_HERE) else watch

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


def _place() -> str:
    """Return the file and line of the golden function that is at work."""
    frame = inspect.currentframe()
    while frame is not None and frame.f_code.co_filename.startswith(_HERE):
        frame = frame.f_back
    return "a golden function" if frame is None else _where(frame.f_code.co_filename, frame.f_lineno)


def _where(file: str, line: int | None) -> str:
    parts = file.split(os.sep)
    return f"{os.sep.join(parts[-2:])}, line {line}"


def _line_of(error: BaseException, own: str) -> int | None:
    line, trace_back = None, error.__traceback__
    while trace_back is not None:
        if trace_back.tb_frame.f_code.co_filename == own:
            line = trace_back.tb_lineno
        trace_back = trace_back.tb_next
    return line
