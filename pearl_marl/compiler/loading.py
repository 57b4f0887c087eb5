"""Loading kernels: their source from the user's cache folder, golden functions compiled, and their hash.

The source can be read there; Numba keeps the machine code beside it. ``PEARL_CACHE_DIR`` moves the folder.
"""

from __future__ import annotations

import functools
import hashlib
import inspect
import os
import sys
import tempfile
import types
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numba
import numpy as np

from pearl_marl.cache import cache_folder, locked
from pearl_marl.golden import GoldenFunction


def load(name: str, source: str, **names: Any) -> tuple[Any, Path]:
    """Return the module of a kernel's source, in which ``names`` are known, and its file in the cache."""
    path = cache_folder("kernels") / f"{name}.py"
    if not path.exists():
        # Written beside and renamed, so that another process never reads half a file.
        with tempfile.NamedTemporaryFile("w", dir=path.parent, suffix=".tmp", delete=False) as file:
            file.write(source)
        os.replace(file.name, path)
        # It takes seconds: nobody should wonder whether it hangs.
        text = f"pearl: compiling {name} at its first calls; kept in {path.parent}"
        print(text, file=sys.stderr, flush=True)
    # Numba's cache finds a function again by its module's name, so the module has to be a real one.
    module = types.ModuleType(f"pearl_marl_kernel_{name}")
    module.__file__ = str(path)
    sys.modules[module.__name__] = module
    vars(module).update({"np": np, "u32": np.uint32, **names})
    exec(compile(source, str(path), "exec"), vars(module))
    return module, path


def one_at_a_time(name: str, kernel: Any) -> Any:
    """Have one process at a time compile what Numba was given: others find it in the cache."""
    compile_, lock = kernel.compile, cache_folder("kernels") / f"{name}.lock"

    def compile_alone(signature: Any) -> Any:
        with locked(lock):
            return compile_(signature)

    kernel.compile = compile_alone
    return kernel


def loop(function: Callable[..., Any], *uses: types.ModuleType) -> Callable[..., Any]:
    """Compile a function of this package at its first call, and keep it as kernels are kept.

    By itself, Numba asks whether the function's own file has changed; this asks for the modules, too, that it
    ``uses``, of which it calls functions.
    """

    @functools.cache
    def made() -> Any:
        module = sys.modules[function.__module__]
        texts = [inspect.getsource(part) for part in (module, *uses)]
        digest = hashlib.sha256(repr((texts, numba.__version__, np.__version__)).encode()).hexdigest()
        name = f"{module.__name__.rpartition('.')[2]}{function.__name__}_{digest[:16]}"
        known = {key: value for key, value in vars(module).items() if not key.startswith("__")}
        loaded, _ = load(name, inspect.getsource(function), **known)
        jit = numba.njit(nogil=True, cache=True, error_model="numpy", fastmath={"contract"})
        return one_at_a_time(name, jit(getattr(loaded, function.__name__)))

    @functools.wraps(function)
    def call(*given: Any) -> Any:
        return made()(*given)

    return call


def with_callees(
    function: Any, done: dict[types.FunctionType, Any], jit: Callable[[types.FunctionType], Any]
) -> Any:
    """Give a plain function to Numba, and with it every plain function that it calls.

    Numba compiles a callee only if that is one of its own. So the function is made again by ``jit`` over
    names that stand for compiled callees, and its author need know nothing of Numba. ``done`` keeps
    what has been made already. What is no plain function is returned as it is.
    """
    if not isinstance(function, types.FunctionType):
        return function
    if function not in done:
        code, named = function.__code__, function.__globals__
        names = {name: with_callees(named[name], done, jit) for name in code.co_names if name in named}
        cells = tuple(
            types.CellType(with_callees(cell.cell_contents, done, jit)) for cell in function.__closure__ or ()
        )
        again = types.FunctionType(code, {**named, **names}, code.co_name, function.__defaults__, cells)
        done[function] = jit(again)
    return done[function]


def fingerprint(function: GoldenFunction) -> bytes:
    """Hash what a function computes: its code, and every function and constant that it names."""
    digest = hashlib.sha256()
    seen: set[types.FunctionType] = set()
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
        elif isinstance(value, (int, float, str, bytes, tuple, list, np.generic, type(None))):
            digest.update(repr(value).encode())
    return digest.digest()


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
            constants = (vars(value).get(attribute) for attribute in code.co_names)
            # Functions of other modules Numba knows or refuses.
            yield from (c for c in constants if not isinstance(c, types.FunctionType))
