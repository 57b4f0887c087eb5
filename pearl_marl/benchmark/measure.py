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
"""Steps every slot once. A step with processes of its own also has a method ``close``, which ends them."""


@dataclass
class Game:
    """A step where legal actions differ from one step to the next.

    ``choose``, which is not timed, returns the actions that ``step`` takes.
    """

    choose: Callable[[], Any]
    step: Callable[[Any], Any]

    def __call__(self) -> None:
        """Do both."""
        self.step(self.choose())


class UnavailableError(Exception):
    """A contender cannot run here; the message says why, for the table."""


@dataclass
class Contender:
    """Something to time: ``make`` returns a step of all ``n`` slots, or agents of worlds.

    ``counts`` says what one step includes. ``wait`` returns when all steps that were started are done.
    """

    name: str
    counts: str
    n: int
    make: Callable[[], Step | Game]
    ours: bool = False
    wait: Callable[[], Any] = lambda: None
    unavailable: str | None = None
    seconds: list[float] = field(default_factory=list)
    processor_seconds: list[float] = field(default_factory=list)

    @property
    def seconds_per_step(self) -> float:
        """Median seconds of a step of all slots."""
        return statistics.median(self.seconds)

    @property
    def rate(self) -> float:
        """Agent-steps per second."""
        return self.n / self.seconds_per_step

    @property
    def rate_of_a_core(self) -> float:
        """Agent-steps per second of this process's processor time, all threads together."""
        return self.n / statistics.median(self.processor_seconds)

    def row(self) -> dict[str, Any]:
        """Return the figures by name, for JSON."""
        result: dict[str, Any] = {"name": self.name, "counts": self.counts, "n": self.n, "ours": self.ours}
        if self.unavailable is not None:
            return {**result, "unavailable": self.unavailable}
        return {
            **result,
            "steps_per_second": self.rate,
            "microseconds_per_step": self.seconds_per_step * 1e6,
            "rounds_microseconds": [s * 1e6 for s in self.seconds],
        }


def measure(contenders: list[Contender], rounds: int, seconds: float) -> Iterator[str]:
    """Time contenders ``rounds`` times, each for about ``seconds``; yield the name of the next.

    Fills their ``seconds`` and ``processor_seconds``; a contender that cannot run gets ``unavailable``
    instead.
    """
    running: list[tuple[Contender, Step | Game, int]] = []
    for contender in contenders:
        yield contender.name
        try:
            step = contender.make()
        except UnavailableError as error:
            contender.unavailable = str(error)
            continue
        _time(step, 1, contender.wait)  # compilation and first use of memory
        running.append((contender, step, max(1, round(seconds / _time(step, 1, contender.wait)[0]))))
    for _ in range(rounds):
        for contender, step, count in running:
            yield contender.name
            of_clock, of_processor = _time(step, count, contender.wait)
            contender.seconds.append(of_clock)
            contender.processor_seconds.append(of_processor)
    for _, step, _ in running:
        if hasattr(step, "close"):
            step.close()


def _time(step: Step | Game, count: int, wait: Callable[[], Any]) -> tuple[float, float]:
    """Return the seconds that a step takes, and those of the processor in all of this process's threads."""
    if isinstance(step, Game):
        times = [_time_chosen(step, wait) for _ in range(count)]
        return sum(of_clock for of_clock, _ in times) / count, sum(own for _, own in times) / count
    began = _now()
    for _ in range(count):
        step()
    wait()
    return _since(began, count)


def _time_chosen(game: Game, wait: Callable[[], Any]) -> tuple[float, float]:
    actions = game.choose()
    wait()
    began = _now()
    game.step(actions)
    wait()
    return _since(began, 1)


def _now() -> tuple[float, float]:
    return time.perf_counter(), time.process_time()


def _since(began: tuple[float, float], count: int) -> tuple[float, float]:
    of_clock, of_processor = (now - then for now, then in zip(_now(), began, strict=True))
    return of_clock / count, of_processor / count
