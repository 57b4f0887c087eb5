"""Calls that Ctrl-C does not cut in two.

Python runs a signal's handler between any two of its instructions, and the handler of Ctrl-C raises
KeyboardInterrupt there. Slots would have moved while the step counter had not. A function under
:func:`uninterrupted` keeps signals until its end, and only then has their handlers run::

    call begins --- Ctrl-C (kept) --- call is done to its end --- KeyboardInterrupt, and a note that says so

So after KeyboardInterrupt a batch is as before the call or as after it, and its ``tick`` says which. A second
Ctrl-C, :data:`PATIENCE` seconds after the first or later, is not kept: hardware may not answer for long.
"""

from __future__ import annotations

# What `signal` is made of: its conversions to enums take 3 us a call.
import _signal  # type: ignore[import-not-found]
import functools
import itertools
import os
import threading
import time
from collections.abc import Callable
from typing import Any, ParamSpec, TypeVar

P = ParamSpec("P")
R = TypeVar("R")

PATIENCE = 0.5
"""Seconds after a signal that was kept from which on the next one is not."""

# Besides Ctrl-C, those that programs have handlers for which raise: of a timeout, or of a request to end.
_KEPT = [_signal.SIGINT, _signal.SIGTERM, _signal.SIGALRM, _signal.SIGHUP, _signal.SIGUSR1, _signal.SIGUSR2]


class _Signals:
    """The signals of the main thread, which is the only one that runs their handlers."""

    def __init__(self) -> None:
        # The handlers of those that are kept now, by number: empty outside of a call.
        self.handlers: dict[int, Any] = {}
        # Those that came, with what their handlers are given.
        self.came: list[tuple[int, Any]] = []
        self._first = 0.0

    def keep(self) -> None:
        """From now on, keep every signal that has a handler."""
        for number in _KEPT:
            handler = _signal.getsignal(number)
            if callable(handler):
                self.handlers[number] = handler
                _signal.signal(number, self._note)

    def release(self) -> BaseException | None:
        """Put the handlers back, and run those of the signals that came; return what they raised.

        Of several, the one that ends a program comes first, and has the others as its context.
        """
        handlers = dict(self.handlers)
        raised: list[BaseException] = []
        while self.handlers:
            try:
                number = next(iter(self.handlers))
                here = _signal.signal(number, self.handlers[number])
                if here != self._note:  # the call itself put another one there
                    _signal.signal(number, here)
                del self.handlers[number]
            except BaseException as error:  # by a signal that came right after its handler was back
                raised.append(error)
        while self.came:
            number, frame = self.came.pop(0)
            try:
                # Not by raising the signal again: asyncio would hear of it twice.
                handlers[number](number, frame)
            except BaseException as error:
                raised.append(error)
        raised.sort(key=lambda error: isinstance(error, Exception))
        for first, second in itertools.pairwise(raised):
            first.__context__ = first.__context__ or second
        return raised[0] if raised else None

    def forget(self) -> None:
        """Put the handlers back in a forked process: where another thread forked, no call is under way."""
        while self.handlers:
            _signal.signal(*self.handlers.popitem())
        self.came.clear()

    def _note(self, number: int, frame: Any) -> None:
        now = time.monotonic()
        if self.came and now - self._first > PATIENCE:
            self.handlers[number](number, frame)
        else:
            self._first = self._first if self.came else now
            self.came.append((number, frame))


_signals = _Signals()
os.register_at_fork(after_in_child=_signals.forget)


def uninterrupted(call: Callable[P, R]) -> Callable[P, R]:
    """Have a function, or a method, done to its end before signals that come meanwhile have an effect.

    Costs a microsecond. In a call within another one, and in threads other than the main one, nothing.
    """

    @functools.wraps(call)
    def whole(*args: P.args, **kwargs: P.kwargs) -> R:
        if _signals.handlers or threading.get_ident() != threading.main_thread().ident:
            return call(*args, **kwargs)
        done = False
        try:
            _signals.keep()
            result = call(*args, **kwargs)
            done = True
        finally:
            if (interrupt := _signals.release()) is not None:
                if done:
                    completed(interrupt, call.__name__)
                raise interrupt
        return result

    return whole


def completed(interrupt: BaseException, name: str) -> None:
    """Have an interrupt say that a call was done to its end before it."""
    interrupt.add_note(f"pearl_marl: {name}() was done to its end before this, and only its result is lost")
