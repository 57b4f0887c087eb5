"""Ctrl-C: one sentence and exit status 130, whatever Python was doing."""

from __future__ import annotations

import contextlib
import os
import signal
import sys
import threading
from collections.abc import Iterator
from typing import Any

STATUS = 130
"""Of a command that was interrupted, as shells have it."""


class Interrupts:
    """Whether there was a Ctrl-C, for where the exception of it does not arrive as what it was.

    ``noted`` says so; ``advice`` is what an interrupted command says besides, and begins with a colon.
    """

    def __init__(self) -> None:
        self.noted = False
        self.advice = ""
        self._at_once = False
        self._later = ""

    @property
    def sentence(self) -> str:
        """What to say."""
        return f"interrupted{self.advice}"

    @contextlib.contextmanager
    def watched(self) -> Iterator[None]:
        """Note Ctrl-C in the block."""
        self.noted, self.advice = False, ""
        if threading.current_thread() is not threading.main_thread():  # only that one is told of signals
            yield
            return
        before = signal.signal(signal.SIGINT, self._interrupt)
        try:
            yield
        finally:
            signal.signal(signal.SIGINT, before)

    @contextlib.contextmanager
    def at_once(self) -> Iterator[None]:
        """End the process at once in the block: half a library raises anything, and nothing is open yet."""
        self._at_once = True
        try:
            yield
        finally:
            self._at_once = False

    @contextlib.contextmanager
    def later(self, sentence: str) -> Iterator[None]:
        """In the block, say a sentence at the first Ctrl-C, and leave it to what asks ``noted``."""
        self._later = sentence
        try:
            yield
        finally:
            self._later = ""

    def _interrupt(self, *_: Any) -> None:
        self.noted = True
        if self._at_once:
            sys.stderr.flush()
            os.write(2, f"pearl: {self.sentence}\n".encode())
            os._exit(STATUS)
        # Who cannot wait until all is closed ends it by a second one.
        signal.signal(signal.SIGINT, signal.SIG_DFL)
        if not self._later:
            raise KeyboardInterrupt
        os.write(2, f"\npearl: {self._later}\n".encode())


interrupts = Interrupts()
"""Of this process."""
