"""Making a function again over other names, and with it every function that it calls.

A golden function names NumPy's types, tables and helpers. Whoever runs it over something else than NumPy's
words, or compiles it, makes it again in a scope where those names stand for something else.
"""

from __future__ import annotations

import types
from collections.abc import Callable, Iterator
from typing import Any


def remade(
    function: types.FunctionType,
    change: Callable[[Any], Any],
    finish: Callable[[types.FunctionType], Any] = lambda function: function,
) -> Any:
    """Return a function like this one in whose scope every other value is what ``change`` makes of it.

    Functions in its scope are made again likewise. ``finish`` is applied to every function that was.
    """
    done: dict[types.FunctionType, Any] = {}

    def value(old: Any) -> Any:
        old = getattr(old, "py_func", old)  # what Numba has compiled already
        if not isinstance(old, types.FunctionType):
            return change(old)
        if old not in done:
            scope, cells = dict(old.__globals__), tuple(types.CellType() for _ in old.__closure__ or ())
            new = types.FunctionType(old.__code__, scope, old.__name__, old.__defaults__, cells)
            new.__kwdefaults__ = old.__kwdefaults__
            done[old] = finish(new)  # known to itself, and to functions that call it in turn
            names = (name for name in _names(old.__code__) if name in old.__globals__)
            scope.update({name: value(old.__globals__[name]) for name in names})
            for cell, known in zip(cells, old.__closure__ or (), strict=True):
                cell.cell_contents = value(known.cell_contents)
        return done[old]

    return value(function)


def _names(code: types.CodeType) -> Iterator[str]:
    """Yield the names that a function uses, and those that functions inside it do."""
    yield from code.co_names
    for constant in code.co_consts:
        if isinstance(constant, types.CodeType):
            yield from _names(constant)
