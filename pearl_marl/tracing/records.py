"""What golden functions do, as text that stays the same until they do something else.

Each is run once over words that only record which operations they are made by. So nothing counts that is not
an operation, a constant, a table or an input: no names, lines or comments. And as nothing is simplified, a
record does not change with the compiler either.
"""

from __future__ import annotations

import hashlib
import types
from collections.abc import Callable, Iterable, Sequence
from typing import Any, NoReturn

import numpy as np

from pearl_marl.errors import ArgumentError
from pearl_marl.remaking import Vocabulary, remade
from pearl_marl.tracing.words import Cast

_ANY_ORDER = frozenset(
    ("add", "multiply", "bitwise_and", "bitwise_or", "bitwise_xor", "equal", "minimum", "maximum")
)
"""Operations, under NumPy's names, whose two arguments may change places."""


def record(function: Callable[..., Any], inputs: Iterable[str], *agent: int) -> list[str]:
    """Return a record of each result of a golden function, given names for its words, and an agent's number.

    The function is one that can be traced: it refuses nothing.
    """
    assert isinstance(function, types.FunctionType)  # specs refuse others
    words = [_Record("input", name) for name in inputs]
    result = remade(function, Vocabulary(_cast, _table).meaning)(*words, *agent)
    return [_text(value) for value in (result if isinstance(result, tuple) else (result,))]


def _text(value: object) -> str:
    """Return what stands for an argument: a word's digest, a name, a table or a number."""
    if isinstance(value, _Record):
        return value.digest
    if isinstance(value, str):
        return value
    if isinstance(value, tuple):
        return f"[{' '.join(map(_text, value))}]"
    return str(int(value))  # type: ignore[call-overload]


class _Record:
    """A word, known by the hash of the operation that made it and of that operation's arguments."""

    __slots__ = ("digest",)
    __array_priority__ = 1000
    __hash__ = None  # type: ignore[assignment]

    def __init__(self, operation: str, *arguments: object) -> None:
        texts = [_text(argument) for argument in arguments]
        if operation in _ANY_ORDER:
            texts.sort()
        self.digest = hashlib.sha256(" ".join((operation, *texts)).encode()).hexdigest()[:32]

    def __array_ufunc__(self, ufunc: Any, method: str, *inputs: Any) -> _Record:
        return _of_ufunc(ufunc.__name__, *inputs)

    def __array_function__(self, function: Any, types_: Any, args: Any, keywords: Any) -> _Record:
        return _Record(function.__name__, *args)

    def __index__(self) -> NoReturn:
        raise ArgumentError(
            "a golden function uses a word where Python needs a number; write the number itself, so that "
            "hardware and saved states can be told apart by what the function does"
        )

    def __neg__(self) -> _Record:
        return _Record("subtract", 0, self)

    def __pos__(self) -> _Record:
        return self

    def __abs__(self) -> _Record:
        return _Record("maximum", self, -self)

    def __invert__(self) -> _Record:
        return _Record("invert", self)


def _of_ufunc(name: str, *arguments: object) -> _Record:
    """Record an operation by its name in NumPy; comparisons are all made of two."""
    match name:
        case "not_equal":
            return _Record("not", _Record("equal", *arguments))
        case "greater":
            return _Record("less", *reversed(arguments))
        case "greater_equal":
            return _Record("not", _Record("less", *arguments))
        case "less_equal":
            return _Record("not", _Record("less", *reversed(arguments)))
    return _Record(name, *arguments)


def _operator(name: str, swapped: bool = False) -> Callable[[_Record, object], _Record]:
    def method(self: _Record, other: object) -> _Record:
        return _of_ufunc(name, other, self) if swapped else _of_ufunc(name, self, other)

    return method


_BOTH_SIDES = {
    "add": "add",
    "sub": "subtract",
    "mul": "multiply",
    "floordiv": "floor_divide",
    "mod": "remainder",
    "pow": "power",
    "and": "bitwise_and",
    "or": "bitwise_or",
    "xor": "bitwise_xor",
    "lshift": "left_shift",
    "rshift": "right_shift",
}
_COMPARISONS = {
    "eq": "equal",
    "ne": "not_equal",
    "lt": "less",
    "le": "less_equal",
    "gt": "greater",
    "ge": "greater_equal",
}
for _method, _name in {**_BOTH_SIDES, **_COMPARISONS}.items():
    setattr(_Record, f"__{_method}__", _operator(_name))
for _method, _name in _BOTH_SIDES.items():
    setattr(_Record, f"__r{_method}__", _operator(_name, swapped=True))


def _cast(dtype: type[np.integer[Any]]) -> Callable[..., Any]:
    cast = Cast(dtype)

    def call(value: object = 0, /) -> Any:
        return _Record(np.dtype(dtype).name, value) if isinstance(value, _Record) else cast(value)

    return call


class _Table(tuple[Any, ...]):
    """A table that a word may index; its entries are numbers, words, or tables of them."""

    __slots__ = ()

    def __getitem__(self, index: Any) -> Any:
        if isinstance(index, tuple):
            table: Any = self
            for i in index:
                table = table[i]
            return table
        if isinstance(index, _Record):
            if all(isinstance(entry, _Table) for entry in self):
                return _Table(_Table(column)[index] for column in zip(*self, strict=True))
            return _Record("table", tuple(self), index)
        found = super().__getitem__(index)
        return _Table(found) if isinstance(index, slice) else found


def _table(values: Sequence[Any]) -> _Table:
    return _Table(_table(value) if isinstance(value, (list, tuple)) else value for value in values)
