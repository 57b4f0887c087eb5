"""Statistics of the episodes that a batch finishes, without a Python loop over its slots."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from pearl_marl.batch.step import BatchStep


class EpisodeStatistics:
    """Adds up returns and lengths of finished episodes.

    Parameters
    ----------
    n
        How many slots.

    Attributes
    ----------
    finished, truncated
        How many episodes ended, and how many of those in truncation alone.
    """

    def __init__(self, n: int) -> None:
        self._returns = np.zeros(n, np.float64)
        self._starts = np.zeros(n, np.int64)
        self._steps = 0
        self.clear()

    def clear(self) -> None:
        """Forget the finished episodes; those under way go on."""
        self.finished = 0
        self.truncated = 0
        self._sums = np.zeros(4)  # of returns, their squares, lengths, their squares
        self._extremes = [math.inf, -math.inf]

    def add(self, step: BatchStep) -> None:
        """Count one step of every slot."""
        self._steps += 1
        self._returns += step.rewards
        ended = np.flatnonzero(step.ended)
        if not ended.size:
            return
        returns, lengths = self._returns[ended], self._steps - self._starts[ended]
        self.finished += ended.size
        self.truncated += int(np.count_nonzero(~step.terminations[ended]))
        for i, values in enumerate((returns, returns**2, lengths, lengths.astype(np.float64) ** 2)):
            self._sums[i] += values.sum()
        self._extremes = [min(self._extremes[0], returns.min()), max(self._extremes[1], returns.max())]
        self._returns[ended] = 0
        self._starts[ended] = self._steps

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
