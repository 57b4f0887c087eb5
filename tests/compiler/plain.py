"""Functions of plain Python, written into a function of Numba's as kernels have them."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import Any

import numba
import numpy as np

from pearl_marl.compiler.llvm_functions import Code, Frame, written

ROOM = 4096


def inlined(function: Callable[..., None], alone: bool = False) -> Any:
    """Return a function for Numba's to call; ``alone``, it is compiled by itself where it is long."""
    names = list(inspect.signature(function).parameters)

    def run(code: Code, frame: Frame) -> None:
        code.inline(function, *(getattr(frame, name) for name in names))

    def body(code: Code, arguments: dict[str, Any]) -> None:
        if alone:
            code.run(run, Frame(**arguments))
        else:
            run(code, Frame(**arguments))

    return written(body, names, {})


def returning(function: Callable[..., Any]) -> Callable[..., tuple[Any, ...]]:
    """Return a function of words, compiled, which returns a tuple of words."""
    dtypes: list[str] = []

    def body(code: Code, arguments: dict[str, Any]) -> None:
        out, *words = arguments.values()
        results = code.inline(function, *words)
        results = results if isinstance(results, tuple) else (results,)
        dtypes[:] = [str(result.type) for result in results]
        for k, result in enumerate(results):
            out[k] = result

    names = ["out", *(f"word_{k}" for k in range(len(inspect.signature(function).parameters)))]
    scope: dict[str, Any] = {"write": written(body, names, {})}
    exec(f"def call({', '.join(names)}): write({', '.join(names)})", scope)
    compiled = numba.njit(scope["call"])

    def call(*words: Any) -> tuple[Any, ...]:
        out = np.zeros(ROOM, np.int64)
        compiled(out, *words)
        return tuple(number.astype(dtype) for number, dtype in zip(out[: len(dtypes)], dtypes, strict=True))

    return call
