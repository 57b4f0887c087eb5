"""A second thread: for half of what compiled loops do row by row, and for what can be done ahead."""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from typing import TypeVar

import torch


@cache
def _thread(use: str) -> ThreadPoolExecutor:
    """Return the second thread for a use; each has its own, so that none waits for another."""
    return ThreadPoolExecutor(1, f"pearl-{use}", torch.set_num_threads, (1,))


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_thread.cache_clear)  # threads stay behind


def over_rows(n: int, least: int, work: Callable[[slice], None]) -> None:
    """Have ``work`` called for ``n`` rows: for halves of at least so many, where PyTorch has a second thread.

    ``work`` must release Python's lock for most of its time.
    """
    if n < 2 * least or torch.get_num_threads() == 1:
        work(slice(0, n))
        return
    both(lambda: work(slice(0, n // 2)), lambda: work(slice(n // 2, n)))


def both(one: Callable[[], None], other: Callable[[], None]) -> None:
    """Call two functions, the other by the second thread."""
    result = _thread("both").submit(other)
    one()
    result.result()


T = TypeVar("T")


def begun(work: Callable[[], T]) -> Callable[[], T]:
    """Have ``work`` done meanwhile; return a function that returns its result."""
    process, result = os.getpid(), _thread("ahead").submit(work)
    # A forked process has no such thread: it does the work itself.
    return lambda: result.result() if os.getpid() == process else work()
