"""Loading kernels: their source from the user's cache folder, golden functions compiled, and their hash.

The source can be read there; the machine code is kept beside it. ``PEARL_CACHE_DIR`` moves the folder.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import inspect
import sys
import threading
import types
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numba
import numpy as np

from pearl_marl.base.cache import cache_folder
from pearl_marl.base.files import write_whole
from pearl_marl.base.machine_code import kept_code
from pearl_marl.base.source_lines import is_of_a_library
from pearl_marl.compiler import vector_code
from pearl_marl.golden import GoldenFunction

_MAKING = threading.RLock()
"""Held while a loop is made, which two threads may ask for at the same time."""


def load(name: str, source: str, **names: Any) -> tuple[Any, Path]:
    """Return the module of a kernel's source, in which ``names`` are known, and its file in the cache."""
    path = cache_folder("kernels") / f"{name}.py"
    content, known = source.encode(), path.exists()
    with contextlib.suppress(OSError):  # people read that file, and nothing else does
        if not known or path.read_bytes() != content:
            write_whole(path, content)
    if not known:
        # It takes seconds, and should not look as if it hung.
        text = f"pearl: compiling {name} at its first calls; kept in {path.parent}"
        print(text, file=sys.stderr, flush=True)
    # Machine code names the module that it comes from, so the module has to be a real one.
    module = types.ModuleType(f"pearl_marl_kernel_{name}")
    module.__file__ = str(path)
    sys.modules[module.__name__] = module
    vars(module).update({"np": np, "u32": np.uint32, **names})
    exec(compile(source, str(path), "exec"), vars(module))
    return module, path


def compiled_loop(
    function: Callable[..., Any], *uses: types.ModuleType, fused: bool = False
) -> Callable[[], Callable[..., Any]]:
    """Return a function that returns a function of this package compiled; it is kept as kernels are kept.

    It depends on its own module, those that it ``uses``, of which it calls functions, and how vectors are
    written. In a ``fused`` one, and in what it calls, a product and a sum may be rounded once; other devices
    round twice.
    """

    @functools.cache
    def once() -> Any:
        module = sys.modules[function.__module__]
        texts = [inspect.getsource(part) for part in (module, vector_code, *uses)]
        digest = hashlib.sha256(repr((texts, fused, numba.__version__, np.__version__)).encode()).hexdigest()
        name = f"{module.__name__.rpartition('.')[2]}{function.__name__}_{digest[:16]}"
        known = {key: value for key, value in vars(module).items() if not key.startswith("__")}
        loaded, _ = load(name, inspect.getsource(function), **known)
        jit = numba.njit(nogil=True, error_model="numpy", fastmath={"contract"} if fused else False)
        return kept_code(jit(getattr(loaded, function.__name__)), name)

    def made() -> Any:
        with _MAKING:
            return once()

    return made


def fingerprint(function: GoldenFunction | type) -> bytes:
    """Hash what a function, or a class, computes: its code, and every function and constant that it names."""
    digest = hashlib.sha256()
    seen: set[types.FunctionType] = set()
    objects: dict[int, Any] = {}
    """Those that were looked into, by their ``id``, which is theirs as long as they are here."""
    left: list[Any] = [function]
    while left:
        value = left.pop()
        value = getattr(value, "py_func", value)  # what Numba has compiled already
        if isinstance(value, types.FunctionType):
            if value not in seen:
                seen.add(value)
                left += _parts(value.__code__, value.__globals__)
                left += (*(value.__defaults__ or ()), *(value.__kwdefaults__ or {}).values())
                left += (cell.cell_contents for cell in value.__closure__ or ())
        elif isinstance(value, np.ndarray):
            digest.update(repr((value.dtype, value.shape)).encode() + value.tobytes())
        elif isinstance(value, (int, float, str, bytes, np.generic, type(None))):
            digest.update(repr(value).encode())
        elif isinstance(value, tuple) or id(value) not in objects:
            objects[id(value)] = value
            inside = _inside(value)
            digest.update(f"{type(value).__name__} of {len(inside)}".encode())
            left += inside
    return digest.digest()


def _inside(value: Any) -> list[Any]:
    """Return what an object is made of: a container, a class or an object of an author's."""
    match value:
        case tuple() | list():
            return list(value)
        case dict():
            return [part for pair in value.items() for part in pair]
        case set() | frozenset():
            return sorted(value, key=repr)
        case functools.partial():
            return [value.func, value.args, value.keywords]
        case types.MethodType() | staticmethod() | classmethod():
            return [value.__func__]
        case property():
            return [value.fget, value.fset]
        case type() if _is_authors(value.__module__):
            own = {name: part for name, part in vars(value).items() if name not in _OF_CLASSES}
            return [value.__bases__, own]
    is_authors = hasattr(value, "__dict__") and _is_authors(type(value).__module__)
    return [type(value), vars(value)] if is_authors else []


_OF_CLASSES = {"__dict__", "__weakref__", "__doc__", "__module__", "__annotations__", "__slots__"}
"""What classes have that nothing computes with."""


def _is_authors(module: str | None) -> bool:
    return not is_of_a_library(module or "builtins") and not str(module).startswith(("numba.", "pearl_marl."))


def _parts(code: types.CodeType, scope: dict[str, Any]) -> Iterator[Any]:
    """Yield a function's instructions, and the values that they work on."""
    yield code.co_code
    yield code.co_names, code.co_varnames
    for constant in code.co_consts:
        if isinstance(constant, types.CodeType):  # an inner function, whose repr holds its address
            yield from _parts(constant, scope)
        else:
            yield constant
    for name in code.co_names:
        value = scope.get(name)
        yield value
        if isinstance(value, types.ModuleType):
            parts = [vars(value).get(attribute) for attribute in code.co_names]
            # Functions of libraries Numba knows or refuses.
            yield from (
                p for p in parts if not isinstance(p, types.FunctionType) or _is_authors(p.__module__)
            )
