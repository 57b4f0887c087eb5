"""A second thread: for half of what compiled loops do, and for what can be done ahead."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from functools import cache
from typing import TypeVar

import torch

_of_thread = threading.local()


@cache
def _thread(use: str) -> ThreadPoolExecutor:
    """Return the second thread for a use; each has its own, so that none waits for another."""
    return ThreadPoolExecutor(1, f"pearl-{use}", _be_alone)


def _be_alone() -> None:
    """Have this thread use no other one."""
    torch.set_num_threads(1)
    _of_thread.threads = 1


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_thread.cache_clear)  # threads stay behind


T = TypeVar("T")


def is_free() -> bool:
    """Return whether this thread may use the second: there is one, and it is not inside :func:`both`."""
    threads: int = getattr(_of_thread, "threads", 0) or torch.get_num_threads()
    return threads > 1


@contextmanager
def torch_threads(number: int) -> Iterator[None]:
    """Have PyTorch use so many threads in the block."""
    before = torch.get_num_threads()
    torch.set_num_threads(number)
    try:
        yield
    finally:
        torch.set_num_threads(before)


@contextmanager
def left_to_loops(threads: int) -> Iterator[None]:
    """Leave so many threads to compiled loops in the block: PyTorch has one.

    PyTorch's second thread looks for more work for a while, and takes the time of the loops' then.
    """
    with torch_threads(1), _threads(threads):
        yield


@contextmanager
def _threads(number: int) -> Iterator[None]:
    before = getattr(_of_thread, "threads", 0)
    _of_thread.threads = number
    try:
        yield
    finally:
        _of_thread.threads = before


def both(one: Callable[[], T], other: Callable[[], T]) -> tuple[T, T]:
    """Call ``one`` in this thread and ``other`` in the second; return their results.

    The functions must release Python's lock for most of their time.
    """
    result = _thread("both").submit(other)
    with _threads(1):
        first = one()
    return first, result.result()


def over_rows(n: int, least: int, work: Callable[[slice], None]) -> None:
    """Have ``work`` called for ``n`` rows: for halves of at least so many, if the second thread is free."""
    if n < 2 * least or not is_free():
        work(slice(0, n))
    else:
        both(lambda: work(slice(0, n // 2)), lambda: work(slice(n // 2, n)))


def begun(work: Callable[[], T]) -> Callable[[], T]:
    """Have ``work`` done meanwhile; return a function that returns its result."""
    process, result = os.getpid(), _thread("ahead").submit(work)
    # A forked process has no such thread: it does the work itself.
    return lambda: result.result() if os.getpid() == process else work()
