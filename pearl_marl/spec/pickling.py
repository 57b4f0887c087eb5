"""How an environment's description is pickled: as where it is found, or as the call that made it.

Pickle writes a function as its module and its name there. Golden functions that are made inside others, for
options, have none. So an :class:`~pearl_marl.spec.EnvSpec` is written as the name that it has itself in the
module of its functions, such as ``SPEC``; or else as ``configure(**options)`` and what differs from that; or
as the id that it is registered by.
"""

from __future__ import annotations

import sys
import types
from collections.abc import Callable, Iterator, Mapping
from dataclasses import fields, replace
from importlib import import_module
from typing import Any

import numpy as np
from gymnasium.spaces import Box

from pearl_marl.errors import ArgumentError
from pearl_marl.layout import Layout


def reduced(spec: Any) -> tuple[Any, ...] | None:
    """Return how a spec comes back, as ``__reduce__`` does; ``None`` where only field by field."""
    configure, values = spec.configure, {f.name: getattr(spec, f.name) for f in fields(spec)}
    functions = list(_functions(tuple(values.values())))
    # Not in the module of a program, which other processes may not have.
    modules = sorted({function.__module__ for function in functions} - {"__main__"})
    for module in modules:
        for name, held in list(vars(sys.modules.get(module, types)).items()):
            if held is spec:
                return _held, (module, name)
    if configure is not None and _has_a_name(configure):
        made = configure(**spec.options)
        changed = {name: value for name, value in values.items() if not _alike(value, getattr(made, name))}
        return _configured, (configure, dict(spec.options), changed)
    if not all(map(_has_a_name, functions)) and _is_registered(spec):
        return _registered, (modules, _finders[spec.id], spec.id)
    return None


_finders: dict[str, Callable[[str], Any]] = {}
"""What returns a registered spec by its id."""


def found_by(spec_id: str, find: Callable[[str], Any]) -> None:
    """Have the spec of that id, which ``find`` returns, come back by it."""
    _finders[spec_id] = find


def _is_registered(spec: Any) -> bool:
    try:
        return spec.id in _finders and _finders[spec.id](spec.id) is spec
    except ArgumentError:  # another one has taken its name
        return False


def _registered(modules: list[str], find: Callable[[str], Any], spec_id: str) -> Any:
    for module in modules:  # which register it
        import_module(module)
    return find(spec_id)


def _held(module: str, name: str) -> Any:
    return getattr(import_module(module), name)


def _configured(configure: Callable[..., Any], options: dict[str, Any], changed: dict[str, Any]) -> Any:
    made = configure(**options)
    return replace(made, **changed) if changed else made


def _functions(value: Any) -> Iterator[types.FunctionType]:
    """Yield a value if it is a function, else those in it if it is a tuple or a mapping."""
    if isinstance(value, types.FunctionType):
        yield value
    elif isinstance(value, Mapping):
        yield from _functions(tuple(value.values()))
    elif isinstance(value, tuple):
        for part in value:
            yield from _functions(part)


def _has_a_name(function: Any) -> bool:
    """Return whether pickle finds a function by its name; what is no function says so itself."""
    if not isinstance(function, types.FunctionType):
        return True
    return getattr(sys.modules.get(function.__module__), function.__qualname__, None) is function


def _alike(one: Any, other: Any) -> bool:
    """Return whether two values are the same; of functions, whether they do the same. In doubt, ``False``.

    Of classes with fields, whether they have the same.
    """
    if one is other:
        return True
    if type(one) is not type(other):
        return False
    if isinstance(one, (tuple, list)):
        return len(one) == len(other) and all(map(_alike, one, other))
    if isinstance(one, Mapping):
        return _alike(list(one.items()), list(other.items()))
    if isinstance(one, np.ndarray):
        return one.dtype == other.dtype and np.array_equal(one, other)
    if isinstance(one, Box):  # whose == overlooks small differences
        return bool(one == other) and _alike((one.low, one.high), (other.low, other.high))
    if isinstance(one, Layout):
        return _alike(one.cls, other.cls)
    if isinstance(one, type):  # made in a function, for options
        known = [(cls.__module__, cls.__qualname__, "__annotations__" in vars(cls)) for cls in (one, other)]
        return known[0] == known[1] and known[0][2] and Layout(one).fields == Layout(other).fields
    if isinstance(one, types.FunctionType):
        return one.__globals__ is other.__globals__ and _alike(_parts(one), _parts(other))
    return bool(one == other)


def _parts(function: types.FunctionType) -> tuple[Any, ...]:
    """Return what a function does besides what its module says."""
    held = [cell.cell_contents for cell in function.__closure__ or ()]
    return function.__code__, function.__defaults__, function.__kwdefaults__, held
