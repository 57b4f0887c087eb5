"""Functions that Numba compiles once for all processes: machine code is kept in the user's cache folder.

Numba has a cache of its own, whose files it loads without a look at whether they are whole: a damaged one
ends the process. So its place is taken by one whose entries carry checksums.
"""

from __future__ import annotations

import functools
import hashlib
import inspect
import linecache
import os
import pickle
import re
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numba
import numpy as np
from numba.core.caching import CompileResultCacheImpl
from numba.core.errors import NumbaError
from numba.core.runtime.nrt import rtsys
from numba.core.serialize import dumps

from pearl_marl.base import object_code
from pearl_marl.base.cache import cache_folder, keep, kept, locked
from pearl_marl.base.source_lines import source_line
from pearl_marl.errors import ArgumentError, DeviceError

CONFIG: Any = numba.config

SETTINGS = (
    *("OPT", "LOOP_VECTORIZE", "SLP_VECTORIZE", "BOUNDSCHECK", "DEBUGINFO_DEFAULT", "DISABLE_INTEL_SVML"),
    *("ENABLE_AVX", "ENABLE_PROFILING", "LLVM_REFPRUNE_PASS"),
)

IMPLEMENTATION: Any = CompileResultCacheImpl
"""Numba's, of what its cache would write. Its methods use nothing of their object."""


class Entries:
    """What has been made of one function: an entry of the cache for each key, as Numba has them.

    ``name`` begins the names of the entries, and says all that they depend on besides their key.
    """

    def __init__(self, name: str, dumps: Callable[[Any], bytes] = dumps) -> None:
        self._name = name
        self._dumps = dumps

    def _path(self, key: Any) -> Path:
        versions = _format(), sys.implementation.cache_tag, numba.__version__, np.__version__
        # What of Numba's own variables is in the code.
        settings = [getattr(CONFIG, name, None) for name in SETTINGS]
        digest = hashlib.sha256(repr((key, versions, settings)).encode()).hexdigest()[:16]
        return cache_folder("kernels") / f"{self._name}-{digest}.code"

    def load(self, key: Any) -> Any:
        """Return what was saved, or None if it is not there or is damaged."""
        content = kept(self._path(key))
        return None if content is None else pickle.loads(content)

    def save(self, key: Any, data: Any) -> None:
        """Save what has been made, where there is room for it."""
        keep(self._path(key), self._dumps(data))

    def flush(self) -> None:
        """Remove all entries of the function."""
        for path in cache_folder("kernels").glob(f"{self._name}-*.code"):
            path.unlink(missing_ok=True)


@functools.cache
def _format() -> str:
    """Return what changes when entries are written another way: then older ones are not found."""
    return hashlib.sha256(inspect.getsource(sys.modules[__name__]).encode()).hexdigest()


class MachineCode(Entries):
    """What Numba's dispatchers ask of a cache: machine code for each signature and processor."""

    @property
    def cache_path(self) -> str:
        """The folder of the entries."""
        return str(cache_folder("kernels"))

    def load_overload(self, signature: Any, context: Any) -> Any:
        """Return the machine code for a signature, or None where there is none."""
        found = self.load((signature, context.codegen().magic_tuple()))
        if found is None:
            return None
        called, made = found
        # Machine code may call Numba's runtime. All else that `context.refresh()` gets ready is for the
        # compiler, which calls it: here it would take half of a process's time to its first step.
        rtsys.initialize(context)
        object_code.add(called)
        return IMPLEMENTATION.rebuild(None, context, made)

    def save_overload(self, signature: Any, made: Any) -> None:
        """Keep what has been compiled for a signature, unless it holds addresses of this process."""
        if not made.library.has_dynamic_globals:
            key = signature, made.target_context.codegen().magic_tuple()
            called = object_code.called(made.library.get_llvm_str())
            self.save(key, (called, IMPLEMENTATION.reduce(None, made)))


def kept_code(dispatcher: Any, name: str) -> Any:
    """Have what Numba compiles for a function kept under a name, which says all that it depends on.

    Processes that need it at the same time, as shards do, wait for the first one and then find it there.

    Raises
    ------
    DeviceError
        Numba's compiler is turned off.
    ArgumentError
        At the first call: an author's ``unpack`` does what cannot be compiled; names the line.
    """
    if CONFIG.DISABLE_JIT:
        raise DeviceError(
            "NUMBA_DISABLE_JIT turns off the compiler that kernels need: unset this variable, or choose the "
            "device 'reference', which compiles nothing"
        )
    compile_ = dispatcher.compile
    # As enable_caching() does, with what Numba has for it.
    vars(dispatcher).update(_cache=MachineCode(name))

    def compile_alone(signature: Any) -> Any:
        with locked(cache_folder("kernels") / f"{name}.lock"):
            try:
                return compile_(signature)
            except NumbaError as error:
                raise ArgumentError(_why_not_compiled(error)) from None

    dispatcher.compile = compile_alone
    return dispatcher


def _why_not_compiled(error: NumbaError) -> str:
    """Return what an author is told: the last line of a file of his own that is named."""
    text = re.sub(r"\x1b\[[0-9;]*m", "", str(error))
    places = re.findall(r'File "([^"]+)", line (\d+)', text)
    for file, line in reversed(places):
        statement = linecache.getline(os.path.abspath(file), int(line)).strip()
        if statement and "kernels" not in Path(file).parts:
            return (
                f"{source_line(file, int(line))}: unpack() cannot be compiled here: `{statement}`; "
                "it takes numbers, tuples of them, loops and `if`s, and writes elements of `row`"
            )
    return "unpack() cannot be compiled; it takes numbers, tuples of them, loops and `if`s"


def compiled(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile a function of this package with Numba, and keep the result.

    It depends on its module and on the numbers around it, and calls nothing of other modules.
    """
    if CONFIG.DISABLE_JIT:  # it takes longer, and gives the same
        return function
    module = sys.modules[function.__module__]
    around = [cell.cell_contents for cell in function.__closure__ or ()]
    parts = repr((inspect.getsource(module), function.__qualname__, around))
    name = f"{function.__name__.strip('_')}_{hashlib.sha256(parts.encode()).hexdigest()[:16]}"
    result: Callable[..., Any] = kept_code(numba.njit(nogil=True)(function), name)
    return result
