"""Loading a kernel: its source from the user's cache folder, its golden functions in their compiled form.

The source can be read there, and Numba keeps the machine code beside it. ``PEARL_CACHE_DIR`` moves that folder.
"""

from __future__ import annotations

import os
import sys
import tempfile
import types
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from pearl_marl.cache import cache_folder


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
