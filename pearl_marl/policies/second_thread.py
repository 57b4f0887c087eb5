"""A second thread for compiled loops over many rows, each of which is on its own."""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import cache

import torch


@cache
def _helper() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(1, "pearl-rows")


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
