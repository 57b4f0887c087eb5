"""A second thread: for half of what compiled loops do row by row, and for what can be done ahead."""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from typing import TypeVar

import torch


@cache
def _helper() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(1, "pearl-second", torch.set_num_threads, (1,))


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_helper.cache_clear)  # the thread stays behind


def over_rows(n: int, least: int, work: Callable[[slice], None]) -> None:
    """Have ``work`` called for ``n`` rows: for halves of at least so many, where PyTorch has a second thread.

    It must release Python's lock for most of its time.
    """
    if n < 2 * least or torch.get_num_threads() == 1:
        work(slice(0, n))
        return
    other = _helper().submit(work, slice(n // 2, n))
    work(slice(0, n // 2))
    other.result()


T = TypeVar("T")


def begun(work: Callable[[], T]) -> Callable[[], T]:
    """Have ``work`` done meanwhile; return a function that returns its result."""
    process, result = os.getpid(), _helper().submit(work)
    # A forked process has no such thread: it does the work itself.
    return lambda: result.result() if os.getpid() == process else work()
