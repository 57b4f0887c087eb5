"""Functions made again in which names stand for something else, and with them every function that they call.

A golden function names NumPy's types, tables and helpers. To run it on symbols, or to compile it, these names
have to stand for other things.
"""

from __future__ import annotations

import random
import types
from collections.abc import Callable, Hashable, Iterator, Mapping
from types import MappingProxyType
from typing import Any, NamedTuple, NoReturn

import numpy as np

from pearl_marl.errors import ArgumentError

_INSTEAD = {
    np.where: "`a if test else b`",
    np.minimum: "`min(a, b)`",
    np.maximum: "`max(a, b)`",
    np.clip: "`min(max(x, low), high)`",
}
"""What golden functions of integers say where NumPy's would make its own integers, which overflow."""


def rebound(
    function: Any,
    change: Callable[[Any], Any] = lambda value: value,
    finish: Callable[[types.FunctionType], Any] = lambda function: function,
    code: Callable[[types.FunctionType], types.CodeType] = lambda function: function.__code__,
    names: Mapping[str, Any] = MappingProxyType({}),
    done: dict[types.FunctionType, Any] | None = None,
) -> Any:
    """Return a function like this one in whose scope every other value is what ``change`` makes of it.

    Functions in its scope are made again likewise. ``finish`` is applied to every function that was: Numba
    compiles a callee only if that is one of its own. ``code`` gives the code of each, and ``names`` are names
    that none of them defines, such as Python's own. ``done`` has what has been made already.
    """
    done = {} if done is None else done

    def value(old: Any) -> Any:
        old = getattr(old, "py_func", old)  # what Numba has compiled already
        # NamedTuple is a function to Python, and a class where one is made of it.
        if not isinstance(old, types.FunctionType) or hasattr(old, "__mro_entries__"):
            return change(old)
        if old not in done:
            scope, its_code = {**names, **old.__globals__}, code(old)
            closure = dict(zip(old.__code__.co_freevars, old.__closure__ or (), strict=True))
            cells = tuple(types.CellType() for _ in its_code.co_freevars)
            new = types.FunctionType(its_code, scope, old.__name__, old.__defaults__, cells)
            done[old] = finish(new)  # known to itself, and to functions that call it in turn
            new.__defaults__ = tuple(map(value, old.__defaults__ or ()))
            new.__kwdefaults__ = {
                name: value(default) for name, default in (old.__kwdefaults__ or {}).items()
            }
            used = (name for name in _names(old.__code__) if name in old.__globals__)
            scope.update({name: value(old.__globals__[name]) for name in used})
            for name, cell in zip(its_code.co_freevars, cells, strict=True):
                cell.cell_contents = value(closure[name].cell_contents)
        return done[old]

    return value(function)


def _names(code: types.CodeType) -> Iterator[str]:
    """Yield the names that a function uses, and those that functions inside it do."""
    yield from code.co_names
    for constant in code.co_consts:
        if isinstance(constant, types.CodeType):
            yield from _names(constant)


class Vocabulary(NamedTuple):
    """What the names of a golden function stand for, where casts and tables are not NumPy's: ``meaning``."""

    cast: Callable[[type[np.integer[Any]]], Any]
    table: Callable[[Any], Any]
    """Takes a list or tuple, of which some may be inside others."""
    functions: Mapping[Any, Callable[..., Any]] = MappingProxyType({})
    """What takes the place of functions such as ``math.sin``."""

    def meaning(self, value: Any) -> Any:
        """Return what takes the place of a value in a golden function's scope."""
        if isinstance(value, types.ModuleType):
            return _Module(self, value)
        if callable(value) and isinstance(value, Hashable) and value in self.functions:
            return self.functions[value]
        if isinstance(value, type) and issubclass(value, np.integer):
            return self.cast(value)
        if isinstance(value, np.ndarray):
            listed = value.tolist()
            return self.table(ArrayEntries(listed)) if isinstance(listed, list) else self.meaning(listed)
        if isinstance(value, (np.integer, np.bool_)):
            return int(value)
        if type(value) in (list, tuple, dict):
            return self.table(value)
        if isinstance(getattr(value, "__self__", value), _DICE):
            return refused(getattr(value, "__name__", "random numbers"), "; ask `draws` for random numbers")
        return value


class TypeLike:
    """What a type of Python's becomes: called, it makes something else; all else is the type's."""

    def __init__(
        self, type_: type, make: Callable[..., Any], knows: Callable[[Any], bool] | None = None
    ) -> None:
        self._type, self._make = type_, make
        self._knows = knows or (lambda value: isinstance(value, type_))

    def __call__(self, *arguments: Any, **keywords: Any) -> Any:
        """Return what is made in the place of an object of the type."""
        return self._make(*arguments, **keywords)

    def __instancecheck__(self, value: Any) -> bool:
        return self._knows(value)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._type, name)


class ArrayEntries(list[Any]):
    """The entries of an array of NumPy's, which takes an index for each dimension at once."""

    def __getitem__(self, index: Any) -> Any:
        if not isinstance(index, tuple):
            return super().__getitem__(index)
        found: Any = self
        for part in index:
            found = found[part]
        return found


_DICE = random.Random, np.random.Generator, np.random.RandomState


class _Module:
    """A module of which a golden function names functions and constants."""

    def __init__(self, vocabulary: Vocabulary, module: types.ModuleType) -> None:
        self._vocabulary, self._module = vocabulary, module

    def __getattr__(self, name: str) -> Any:
        module, value = self._module, getattr(self._module, name)
        if callable(value) and isinstance(value, Hashable) and value in self._vocabulary.functions:
            return self._vocabulary.functions[value]
        if isinstance(value, float) and self._vocabulary.functions:
            return value
        if module is np:
            if isinstance(value, int):
                return value
            if not isinstance(value, type) or not issubclass(value, np.integer):
                instead = next((text for function, text in _INSTEAD.items() if function is value), None)
                write = f"write {instead}" if instead else "use Python's own functions"
                raise ArgumentError(f"golden functions of integers have no np.{name}; {write}")
        random_one = module.__name__ in ("random", "secrets")
        if isinstance(value, types.FunctionType) and not random_one:
            return rebound(value, self._vocabulary.meaning)
        if callable(value) and not isinstance(value, type):
            hint = "; ask `draws` for random numbers" if random_one else ""
            return refused(f"{module.__name__}.{name}", hint)
        return self._vocabulary.meaning(value)


def refused(name: str, hint: str) -> Callable[..., NoReturn]:
    """Return a function that says that golden functions cannot use something of that name."""

    def refuse(*_: Any, **__: Any) -> NoReturn:
        raise ArgumentError(f"golden functions cannot use {name}{hint}")

    return refuse
