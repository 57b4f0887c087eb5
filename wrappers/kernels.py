"""One pass over a batch where NumPy would make several: arrays of shape ``(n, k)``, a row a slot."""

from __future__ import annotations

from typing import Any

import numpy as np

from pearl_marl.cache import compiled

# The window of the last frames has shape (frames, n, k); (frames, n, rows, k) for stacks, and (frames, n) for
# stacks of numbers. The newest is at `turn`; `age` tells how many each slot's episode has had so far, up to
# the number of frames. `slots` says for which slots to write the rows of `out`.


@compiled
def delayed(window: Any, age: Any, turn: int, slots: Any, out: Any) -> None:
    """Write each slot's oldest frame; zeros where it is not that old."""
    frames = window.shape[0]
    oldest = window[(turn + 1) % frames]
    for j in range(slots.size):
        i = slots[j]
        for c in range(out.shape[1]):
            out[j, c] = oldest[i, c] if age[i] == frames else out.dtype.type(0)


@compiled
def largest(window: Any, age: Any, turn: int, slots: Any, out: Any) -> None:
    """Write the largest value of each element in each slot's frames."""
    frames = window.shape[0]
    for back in range(frames):
        frame = window[(turn - back) % frames]
        for j in range(slots.size):
            i = slots[j]
            if back == 0:
                for c in range(out.shape[1]):
                    out[j, c] = frame[i, c]
            elif back < age[i]:
                for c in range(out.shape[1]):
                    out[j, c] = max(out[j, c], frame[i, c])


@compiled
def stacked(window: Any, age: Any, turn: int, slots: Any, repeat: bool, out: Any) -> None:
    """Write slots' frames side by side, oldest first; ``out`` has shape ``(slots, rows, frames * k)``."""
    frames, _, rows, width = window.shape
    for place in range(frames):
        back = frames - 1 - place
        start = place * width
        frame = window[(turn - back) % frames]
        for j in range(slots.size):
            i = slots[j]
            if back < age[i]:
                for row in range(rows):
                    for c in range(width):
                        out[j, row, start + c] = frame[i, row, c]
            elif repeat:
                first = window[(turn - age[i] + 1) % frames]
                for row in range(rows):
                    for c in range(width):
                        out[j, row, start + c] = first[i, row, c]
            else:
                for row in range(rows):
                    for c in range(width):
                        out[j, row, start + c] = out.dtype.type(0)


@compiled
def numbered(window: Any, age: Any, turn: int, slots: Any, repeat: bool, n: int, out: Any) -> None:
    """Write each slot's frames, which are numbers below ``n``, as the digits of one number."""
    frames = window.shape[0]
    out[:] = 0
    for back in range(frames - 1, -1, -1):
        frame = window[(turn - back) % frames]
        for j in range(slots.size):
            i = slots[j]
            digit = 0
            if back < age[i]:
                digit = frame[i]
            elif repeat:
                digit = window[(turn - age[i] + 1) % frames, i]
            out[j] = out[j] * n + digit


@compiled
def appended(obs: Any, numbers: Any, out: Any) -> None:
    """Write each row of ``obs``, shape ``(n, rows, k)``, with its slot's number after the ``k`` elements."""
    n, rows, width = obs.shape
    for i in range(n):
        for row in range(rows):
            for c in range(width):
                out[i, row, c] = obs[i, row, c]
            out[i, row, width] = numbers[i]


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
                    apart = rows[i, c] - mean[c]
                    variance[c] += apart * apart
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
    """Add a step's rewards to each slot's discounted sum, as :func:`normalize_reward_v0` has it."""
    for i in range(returns.size):
        if counted[i]:
            before = 0.0 if terminations[i] else returns[i] * gamma
            returns[i] = before + np.float64(rewards[i])
