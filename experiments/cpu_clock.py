"""What share of a script's time some functions take."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import wraps
from typing import Any


class CPUClock:
    """Adds up the seconds of CPU of the methods that it times."""

    def __init__(self) -> None:
        self.seconds = 0.0

    def time(self, owner: Any, *names: str) -> None:
        """Time methods of an object, or of all objects of a class."""
        for name in names:
            setattr(owner, name, self._timed(getattr(owner, name)))

    def _timed(self, function: Callable[..., Any]) -> Callable[..., Any]:
        @wraps(function)
        def timed(*args: Any, **kwargs: Any) -> Any:
            began = time.process_time()
            try:
                return function(*args, **kwargs)
            finally:
                self.seconds += time.process_time() - began

        return timed
