"""Threads that a device owns, and the step that goes on in one."""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any, TypeVar

from pearl_marl.batch.step import Array, BatchStep

T = TypeVar("T")


class Threads:
    """A pool of threads, begun at first use, and again in a forked process, which threads do not survive.

    Parameters
    ----------
    count
        How many.
    name
        What theirs begin with.
    """

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


class StepUnderWay:
    """A step that goes on in the background, and its results to come.

    Parameters
    ----------
    name
        Of the thread.
    buffer
        Where the words of a step are kept meanwhile: the caller may change his own.

    Attributes
    ----------
    pending
        What will have the results; ``None`` where nothing is under way.
    """

    def __init__(self, name: str, buffer: Array) -> None:
        self._thread = Threads(1, name)
        self._words: Any = buffer
        self._buffer = buffer
        self.pending: Future[BatchStep] | None = None

    def begin(self, step: Callable[[Array], BatchStep], words: Array) -> None:
        """Start a step."""
        if words is not self._buffer:
            self._buffer[:] = words
        self._words, self.pending = self._buffer, self._thread.submit(step, self._buffer)

    def done(self, words: Any, results: BatchStep) -> None:
        """Take up a step whose results are there already."""
        self._words, self.pending = words, Future()
        self.pending.set_result(results)

    def finish(self) -> tuple[Any, BatchStep]:
        """Wait for the step that is under way; return its words and its results."""
        pending = self.pending
        assert pending is not None
        try:
            return self._words, pending.result()
        finally:
            if pending.done():  # or Ctrl-C came first, and the step is still under way
                self.pending = None

    def close(self) -> None:
        """Wait for the step, and end the thread."""
        self._thread.close()
