"""One pass over a batch where NumPy would make several: arrays of shape ``(n, k)``, a row an agent."""

from __future__ import annotations

from typing import Any

import numpy as np

from pearl_marl.base.machine_code import compiled


@compiled
def appended(obs: Any, numbers: Any, out: Any) -> None:
    """Write each row of ``obs``, shape ``(n, rows, k)``, with an agent's numbers after ``k`` elements."""
    n, rows, width = obs.shape
    for i in range(n):
        for row in range(rows):
            for c in range(width):
                out[i, row, c] = obs[i, row, c]
            for c in range(numbers.shape[1]):
                out[i, row, width + c] = numbers[i, c]


@compiled
def moments(rows: Any, counted: Any, mean: Any, variance: Any) -> int:
    """Write mean and variance of the rows that count; return how many they are."""
    n, width = rows.shape
    count = 0
    mean[:] = 0
    variance[:] = 0
    for i in range(n):
        if counted[i]:
            count += 1
            for c in range(width):
                mean[c] += rows[i, c]
    if count:
        mean /= count
        for i in range(n):
            if counted[i]:
                for c in range(width):
                    difference = rows[i, c] - mean[c]
                    variance[c] += difference * difference
        variance /= count
    return count


@compiled
def standardised(rows: Any, mean: Any, deviation: Any, out: Any) -> None:
    """Write how many deviations each element is from its mean."""
    n, width = rows.shape
    for i in range(n):
        for c in range(width):
            out[i, c] = (rows[i, c] - mean[c]) / deviation[c]


@compiled
def rescaled(rows: Any, low: Any, size: Any, new_size: Any, new_low: Any, out: Any) -> None:
    """Write where each element is between its old bounds, on the scale of the new ones."""
    n, width = rows.shape
    for i in range(n):
        for c in range(width):
            out[i, c] = (rows[i, c] - low[c]) / size[c] * new_size + new_low


@compiled
def discounted(returns: Any, rewards: Any, terminations: Any, counted: Any, gamma: float) -> None:
    """Add a step's rewards to each agent's discounted sum, as :func:`normalize_reward_v0` has it."""
    for i in range(returns.size):
        if counted[i]:
            before = 0.0 if terminations[i] else returns[i] * gamma
            returns[i] = before + np.float64(rewards[i])
