"""Statistics of the episodes that a batch finishes, without a Python loop over its slots."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from pearl_marl.batch.step import BatchStep


class Ended(NamedTuple):
    """The episodes that ended in one step, an element each: rows of their agents in order, returns, lengths.

    ``truncated`` is whether only the time limit ended them.
    """

    slots: npt.NDArray[np.intp]
    returns: npt.NDArray[np.float64]
    lengths: npt.NDArray[np.int64]
    truncated: npt.NDArray[np.bool_]


NONE = Ended(np.zeros(0, np.intp), np.zeros(0), np.zeros(0, np.int64), np.zeros(0, np.bool_))
"""No episodes, as in most steps of few slots."""


class RunningEpisodes:
    """Return and length of the episode so far, of each of ``n`` agents."""

    def __init__(self, n: int) -> None:
        self._returns = np.zeros(n, np.float64)
        self._starts = np.zeros(n, np.int64)
        self._steps = 0
        self._absent = NONE.slots

    def clear(self) -> None:
        """Begin an episode in every slot."""
        self._returns[:] = self._starts[:] = self._steps = 0
        self._absent = NONE.slots

    def add(self, step: BatchStep) -> Ended:
        """Count one step of every slot; return the episodes that it ended."""
        self._steps += 1
        self._returns += step.rewards
        self._starts[self._absent] = self._steps  # their next episode begins with that of their world
        self._absent = np.flatnonzero(~step.in_episode)
        slots = np.flatnonzero(step.ended)
        if not slots.size:
            return NONE
        returns, lengths = self._returns[slots], self._steps - self._starts[slots]
        self._returns[slots], self._starts[slots] = 0, self._steps
        return Ended(slots, returns, lengths, ~step.terminations[slots])


class EpisodeStatistics:
    """Adds up returns and lengths of the episodes that ``n`` slots finish.

    ``finished`` is how many ended, ``truncated`` how many of those in truncation alone.
    """

    def __init__(self, n: int) -> None:
        self._running = RunningEpisodes(n)
        self.clear()

    def clear(self) -> None:
        """Forget the finished episodes; those under way go on."""
        self.finished = 0
        self.truncated = 0
        self._sums = np.zeros(4)  # of returns, their squares, lengths, their squares
        self._extremes = [math.inf, -math.inf]

    def add(self, step: BatchStep) -> None:
        """Count one step of every slot."""
        ended = self._running.add(step)
        if not ended.slots.size:
            return
        returns, lengths = ended.returns, ended.lengths
        self.finished += ended.slots.size
        self.truncated += int(np.count_nonzero(ended.truncated))
        for i, values in enumerate((returns, returns**2, lengths, lengths.astype(np.float64) ** 2)):
            self._sums[i] += values.sum()
        self._extremes = [min(self._extremes[0], returns.min()), max(self._extremes[1], returns.max())]

    def summary(self) -> dict[str, Any]:
        """Return counts, means and standard deviations by name; means are ``None`` without episodes."""
        result: dict[str, Any] = {"episodes": self.finished, "truncated": self.truncated}
        for name, total, squares in (("return", *self._sums[:2]), ("length", *self._sums[2:])):
            mean = total / self.finished if self.finished else None
            result[f"{name}_mean"] = mean
            result[f"{name}_std"] = (
                None if mean is None else math.sqrt(max(squares / self.finished - mean**2, 0))
            )
        low, high = self._extremes if self.finished else (None, None)
        return {**result, "return_min": low, "return_max": high}
