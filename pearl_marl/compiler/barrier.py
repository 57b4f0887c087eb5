"""A barrier for two compiled loops, which meet there thousands of times a second.

The operating system takes longer to wake a thread than such loops work between two barriers. So each looks
whether the other has arrived, again and again; after a while it lets other threads run between two looks.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from typing import Any

import numpy as np
from numba import njit, types

from pearl_marl.base.arrays import Array
from pearl_marl.compiler.vector_code import VectorCode, function_of

_FOR_LOOPS: Any = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}
_called: Callable[..., Any] = njit(**_FOR_LOOPS)

_LINE = 8
"""Numbers of a cache line: each loop writes to one of its own."""

_LOOKS = 10_000
"""Looks without a pause, which take some 10 microseconds."""

_FOREVER = np.iinfo(np.int64).max

_let_others_run = types.ExternalFunction("sched_yield", types.intc())


def arrivals() -> Array:
    """Return what two loops share: how often each has arrived, ``int64``."""
    return np.zeros(2 * _LINE, np.int64)


@contextmanager
def released_by_errors(shared: Array) -> Iterator[None]:
    """Have no loop wait for the other any longer if an error ends the block."""
    try:
        yield
    except BaseException:
        shared[:] = _FOREVER
        raise


@function_of
def _write(code: VectorCode, shared: Any, index: Any, number: Any) -> None:
    """Write a number; all that was written before it is there for a loop that reads it."""
    code.builder.store_atomic(number, code.builder.gep(shared, [index]), "release", 8)


@partial(function_of, result=types.int64)
def _read(code: VectorCode, shared: Any, index: Any) -> Any:
    """Read a number that another loop writes."""
    return code.builder.load_atomic(code.builder.gep(shared, [index]), "acquire", 8)


@_called
def arrive(shared: Array, loop: int, number: int) -> bool:
    """Arrive for the ``number``-th time, from 1 on; wait until the other of the loops 0 and 1 has too.

    Return whether to go on: not after an error, see :func:`released_by_errors`.
    """
    _write(shared, loop * _LINE, number)
    looks = 0
    while True:
        other: int = _read(shared, (1 - loop) * _LINE)
        if other >= number:
            return other != _FOREVER
        looks += 1
        if looks > _LOOKS:
            _let_others_run()
