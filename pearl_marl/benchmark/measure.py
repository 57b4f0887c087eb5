"""Timing contenders in turns, round after round.

So a machine that slows down or speeds up does so for all of them; the median round is quoted.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

Step = Callable[[], Any]
"""Steps every slot once."""


class UnavailableError(Exception):
    """A contender cannot run here; the message says why, for the table."""


@dataclass
class Contender:
    """Something to time.

    Parameters
    ----------
    name
        For the table.
    counts
        What one of its steps includes, in words: which sport this is.
    n
        Slots it steps at a time.
    make
        Returns the function to time, which steps every slot once.
    ours
        Whether it is this package.
    wait
        Waits for what steps have only started.
    """

    name: str
    counts: str
    n: int
    make: Callable[[], Step]
    ours: bool = False
    wait: Callable[[], Any] = lambda: None
    unavailable: str | None = None
    seconds: list[float] = field(default_factory=list)

    @property
    def seconds_per_step(self) -> float:
        """Median seconds of a step of all slots."""
        return statistics.median(self.seconds)

    def row(self) -> dict[str, Any]:
        """Return the figures by name, for JSON."""
        result: dict[str, Any] = {"name": self.name, "counts": self.counts, "n": self.n, "ours": self.ours}
        if self.unavailable is not None:
            return {**result, "unavailable": self.unavailable}
        return {
            **result,
            "steps_per_second": self.n / self.seconds_per_step,
            "microseconds_per_step": self.seconds_per_step * 1e6,
            "rounds_microseconds": [s * 1e6 for s in self.seconds],
        }


def measure(contenders: list[Contender], rounds: int, seconds: float) -> Iterator[str]:
    """Time contenders in turns; yields the name of each as it is about to be timed.

    Parameters
    ----------
    contenders
        Their ``seconds`` are filled; those that cannot run get ``unavailable`` instead.
    rounds
        How often each is timed.
    seconds
        About how long one timing lasts.
    """
    running: list[tuple[Contender, Step, int]] = []
    for contender in contenders:
        yield contender.name
        try:
            step = contender.make()
        except UnavailableError as error:
            contender.unavailable = str(error)
            continue
        step()  # compilation and first use of memory
        contender.wait()
        running.append((contender, step, max(1, round(seconds / _time(step, 1, contender.wait)))))
    for _ in range(rounds):
        for contender, step, count in running:
            yield contender.name
            contender.seconds.append(_time(step, count, contender.wait))


def _time(step: Step, count: int, wait: Callable[[], Any]) -> float:
    began = time.perf_counter()
    for _ in range(count):
        step()
    wait()
    return (time.perf_counter() - began) / count
