"""Threads that a device owns.

A fork of the process waits for what they are at. The new process has the memory but no threads, so a step
under way would never end there.
"""

from __future__ import annotations

import os
import threading
import weakref
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor, wait
from typing import Any, TypeVar

T = TypeVar("T")


class Threads:
    """A pool of ``count`` threads, begun at first use, and again in a forked process, which has none."""

    def __init__(self, count: int, name: str) -> None:
        self._count, self._name = count, name
        self._pool: ThreadPoolExecutor | None = None
        self._process = 0
        # No longer than that: results may be arrays whose memory is to be used again.
        self._under_way: set[Future[Any]] = set()
        self._members: set[int] = set()
        _all.add(self)

    def submit(self, call: Callable[..., T], *arguments: Any) -> Future[T]:
        """Have a call made; its result is the future's."""
        if self._pool is None or self._process != os.getpid():
            self._process = os.getpid()
            self._under_way.clear()
            self._members.clear()
            self._pool = ThreadPoolExecutor(
                self._count, self._name, initializer=_become_member, initargs=(self._members,)
            )
        future = self._pool.submit(call, *arguments)
        self._under_way.add(future)
        future.add_done_callback(self._under_way.discard)
        return future

    def settle(self) -> None:
        """Wait for all that was submitted; one of these threads does not, as it would wait for itself."""
        if self._process == os.getpid() and threading.get_ident() not in self._members:
            wait(list(self._under_way))

    def close(self) -> None:
        """Wait for all that was submitted, and end the threads."""
        if self._pool is not None and self._process == os.getpid():
            self._pool.shutdown(wait=True)
        self._pool = None


def _become_member(members: set[int]) -> None:
    members.add(threading.get_ident())


_all: weakref.WeakSet[Threads] = weakref.WeakSet()


def _settle_all() -> None:
    for threads in list(_all):
        threads.settle()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(before=_settle_all)
