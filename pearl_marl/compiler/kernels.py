"""From a golden step to a compiled kernel that steps a whole batch.

The kernel is generated (:mod:`pearl_marl.compiler.kernel_source`) and written to the user's cache folder,
where it can be read and where Numba keeps the machine code beside it. The file's name is a hash of
all that the kernel depends on: a changed golden step is a new file, and a warm start compiles
nothing. ``PEARL_CACHE_DIR`` moves the folder.
"""

from __future__ import annotations

import hashlib
import os
import sys
import tempfile
import types
from collections.abc import Callable, Iterable
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import llvmlite
import numba
import numpy as np

from pearl_marl import rng
from pearl_marl.cache import cache_folder
from pearl_marl.compiler.kernel_source import kernel_source
from pearl_marl.golden import GoldenFunction
from pearl_marl.spec import EnvSpec

# LLVM turns no loop that still has a call in it into SIMD code, and left to itself it keeps a long
# golden step as one: CartPole ran at 40 M steps/s without this, at 230 M with it.
_FORCE_INLINE = True


class Kernels(NamedTuple):
    """The compiled functions of one environment, and the file where their source can be read.

    ``reset(memory, stored, mask, observations, seed_0, seed_1, tick, first_slot, use_stored, n, lo, hi)``
        starts an episode in every slot of ``lo .. hi - 1`` whose mask is set, and writes the
        observation of every slot of the range.
    ``step(memory, stored, actions, table, observations, rewards, terminations, truncations,
    final_observations, seed_0, seed_1, tick, first_slot, limit, next_step, use_stored, n, lo, hi)``
        steps that range. ``final_observations`` are written for a block in which a slot ended.
    ``deliver(*words, observations)``
        turns the words of observations, an array a field, into the observations themselves.
    ``results(*words, code_words, ter_words, stored, table, observations, rewards, terminations, truncations,
    final_observations, seed_0, seed_1, tick, first_slot, next_step, use_stored, n, lo, hi)``
        does so with all the words of a step: of observations, rewards and ends. Unless ``next_step``,
        a slot that ended gets the first observation of its next episode, which begins at ``tick``.
    ``advance(memory, actions, table, rewards, terminations, n, lo, hi)``
        does the golden step and the rewards alone, for benchmarks.

    ``memory`` and ``stored`` are laid out by :mod:`pearl_marl.batch.slot_memory`; flags are ``uint8``;
    ``lo`` is a multiple of :data:`pearl_marl.compiler.kernel_source.BLOCK`. All release the GIL.
    """

    reset: Callable[..., None]
    step: Callable[..., None]
    deliver: Callable[..., None]
    results: Callable[..., None]
    advance: Callable[..., None]
    path: Path


def compile_kernels(spec: EnvSpec) -> Kernels:
    """Return the kernels of an environment; those in the cache are loaded at their first call."""
    source = kernel_source(spec)
    versions = (numba.__version__, llvmlite.__version__, np.__version__, f"{_FORCE_INLINE=}")
    name = kernel_name(spec, source, versions)
    if name not in _loaded:
        compiled: dict[types.FunctionType, Any] = {}
        module, path = load(
            name,
            source,
            kernel=numba.njit(nogil=True, cache=True, error_model="numpy"),
            **{called: _compiled(function, compiled) for called, function in functions(spec).items()},
        )
        _loaded[name] = Kernels(
            module.reset, module.step, module.deliver, module.results, module.advance, path
        )
    return _loaded[name]


_loaded: dict[str, Kernels] = {}
"""By name, which is a hash of all that a kernel depends on."""


def functions(spec: EnvSpec) -> dict[str, GoldenFunction]:
    """Return the functions that a kernel's source calls, by the names it has for them."""
    initial, step, observe = spec.golden
    functions: dict[str, GoldenFunction] = {
        "initial": initial,
        "golden_step": step,
        "observe": observe,
        "key": rng.key,
        "draw": rng.draw,
    }
    return functions if spec.unpack is None else {**functions, "unpack": spec.unpack}


def kernel_name(spec: EnvSpec, source: str, versions: Iterable[str]) -> str:
    """Return a name with a hash of all that a kernel depends on."""
    digest = hashlib.sha256(source.encode())
    for part in versions:
        digest.update(part.encode())
    for function in functions(spec).values():
        digest.update(_fingerprint(function))
    return f"{spec.name}_{digest.hexdigest()[:16]}"


def load(name: str, source: str, **names: Any) -> tuple[Any, Path]:
    """Return the module of a kernel's source, in which ``names`` are known, and its file in the cache."""
    path = cache_folder("kernels") / f"{name}.py"
    if not path.exists():
        # Written beside and renamed, so that another process never reads half a file.
        with tempfile.NamedTemporaryFile("w", dir=path.parent, suffix=".tmp", delete=False) as file:
            file.write(source)
        os.replace(file.name, path)
        # Seaquest's take most of a minute: nobody should wonder whether it hangs.
        text = f"pearl: compiling {name} at its first calls; kept in {path.parent}"
        print(text, file=sys.stderr, flush=True)
    # Numba's cache finds a function again by its module's name, so the module has to be a real one.
    module = types.ModuleType(f"pearl_marl_kernel_{name}")
    module.__file__ = str(path)
    sys.modules[module.__name__] = module
    vars(module).update(np=np, u32=np.uint32, **names)
    exec(compile(source, str(path), "exec"), vars(module))
    return module, path


def _compiled(function: Any, done: dict[types.FunctionType, Any]) -> Any:
    return with_callees(function, done, partial(numba.njit, forceinline=_FORCE_INLINE))


def with_callees(
    function: Any, done: dict[types.FunctionType, Any], jit: Callable[[types.FunctionType], Any]
) -> Any:
    """Give a plain function to Numba, and with it every plain function that it calls.

    Numba compiles a callee only if that is one of its own. So the function is made again over
    names that stand for compiled callees, and golden functions need to know nothing of Numba.

    Parameters
    ----------
    function
        What is no plain function is returned as it is.
    done
        What has been made already, by function.
    jit
        Makes Numba's function of a plain one.
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


def _fingerprint(function: GoldenFunction) -> bytes:
    """Hash what a function computes: its code, and every function and constant that it names."""
    digest = hashlib.sha256()
    seen: set[types.FunctionType] = set()

    def visit_code(code: types.CodeType, scope: dict[str, Any]) -> None:
        digest.update(code.co_code)
        digest.update(repr((code.co_names, code.co_varnames)).encode())
        for constant in code.co_consts:
            if isinstance(constant, types.CodeType):  # an inner function, whose repr holds its address
                visit_code(constant, scope)
            else:
                visit(constant)
        for name in code.co_names:
            value = scope.get(name)
            visit(value)
            if isinstance(value, types.ModuleType):
                for attribute in code.co_names:
                    constant = vars(value).get(attribute)
                    if not isinstance(constant, types.FunctionType):  # Numba knows these or refuses them
                        visit(constant)

    def visit(value: Any) -> None:
        value = getattr(value, "py_func", value)  # what Numba has compiled already
        if isinstance(value, types.FunctionType):
            if value in seen:
                return
            seen.add(value)
            visit_code(value.__code__, value.__globals__)
            for default in (*(value.__defaults__ or ()), *(value.__kwdefaults__ or {}).values()):
                visit(default)
            for cell in value.__closure__ or ():
                visit(cell.cell_contents)
        elif isinstance(value, np.ndarray):
            digest.update(repr((value.dtype, value.shape)).encode())
            digest.update(value.tobytes())
        elif isinstance(value, (int, float, str, bytes, tuple, np.generic, type(None))):
            digest.update(repr(value).encode())

    visit(function)
    return digest.digest()
