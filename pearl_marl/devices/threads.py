"""Threads that a device owns, and how many of them pay.

A fork of the process waits for what they are at. The new process has the memory but no threads, so a step
under way would never end there.
"""

from __future__ import annotations

import os
import statistics
import threading
import weakref
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor, wait
from typing import Any, TypeVar

T = TypeVar("T")

SLOW_SECONDS = 300e-6
"""From here on a second thread can pay: handing it work and waiting for it costs about 50 us."""

SECONDS_PER_THREAD = 150e-6
"""The least work a thread is taken for."""


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
            members = self._members = set()
            self._pool = ThreadPoolExecutor(
                self._count, self._name, initializer=lambda: members.add(threading.get_ident())
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


class ThreadCount:
    """How many threads share a task that is done again and again.

    Parameters
    ----------
    threads
        So many; ``None`` begins with one, takes more once the task proves long enough, and gives them up
        again if they do not help.
    trials
        Tasks in a row that decide: a single one may only have been interrupted.
    """

    def __init__(self, threads: int | None, trials: int) -> None:
        self.now = threads or 1
        self.tuning = threads is None and cores() > 1
        self._trials = trials
        self._recent: list[tuple[float, float]] = []
        self._alone = 0.0

    def learn(self, seconds: float, work: int = 1) -> None:
        """Learn from the time that the task took, and from how much there was to do."""
        if self.now == 1 and seconds < SLOW_SECONDS:
            self._recent.clear()
            return
        self._recent.append((seconds, seconds / work))
        if len(self._recent) < self._trials:
            return
        whole, each = (statistics.median(some) for some in zip(*self._recent, strict=True))
        self._recent.clear()
        if self.now == 1:
            self._alone = each
            self.now = min(cores(), max(2, round(whole / SECONDS_PER_THREAD)))
        else:
            self.now = self.now if each < self._alone else 1
            self.tuning = False


def cores() -> int:
    """Return how many cores this process may use."""
    return len(os.sched_getaffinity(0))


_all: weakref.WeakSet[Threads] = weakref.WeakSet()


def _settle_all() -> None:
    for threads in list(_all):
        threads.settle()


os.register_at_fork(before=_settle_all)
