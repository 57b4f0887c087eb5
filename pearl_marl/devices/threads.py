"""Threads that a device owns."""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any, TypeVar

T = TypeVar("T")


class Threads:
    """A pool of ``count`` threads, begun at first use, and again in a forked process, which has none."""

    def __init__(self, count: int, name: str) -> None:
        self._count, self._name = count, name
        self._pool: ThreadPoolExecutor | None = None
        self._process = 0

    def submit(self, call: Callable[..., T], *arguments: Any) -> Future[T]:
        """Have a call made; its result is the future's."""
        if self._pool is None or self._process != os.getpid():
            self._process = os.getpid()
            self._pool = ThreadPoolExecutor(self._count, thread_name_prefix=self._name)
        return self._pool.submit(call, *arguments)

    def close(self) -> None:
        """Wait for all that was submitted, and end the threads."""
        if self._pool is not None and self._process == os.getpid():
            self._pool.shutdown(wait=True)
        self._pool = None
