"""A perfect player of ConnectFour, which judges the moves of others.

It searches to the end of the game: alpha-beta, a table of positions, the most threatening moves first, none
that lets the other win at once. After Pascal Pons, http://blog.gamesolver.org. From 14 discs on it takes some
milliseconds for a position.

A column has seven bits, its lowest cell first and the last one free, so that lines do not run on into the
next column. A position is two words: the discs of who is on turn, and those of both.
"""

from __future__ import annotations

from typing import Any

import numba
import numpy as np

from pearl_marl.base.arrays import Array
from pearl_marl.envs.connect_four.step import COLUMNS, ROWS

# None of the functions is kept on the disk: Numba 0.68 loads one that calls itself, and crashes in it.

HEIGHT = ROWS + 1
CELLS = ROWS * COLUMNS
BOTTOM = sum(1 << HEIGHT * column for column in range(COLUMNS))
BOARD = BOTTOM * ((1 << ROWS) - 1)
COLUMN = np.array([((1 << ROWS) - 1) << HEIGHT * column for column in range(COLUMNS)])
FROM_THE_MIDDLE = np.array([3, 2, 4, 1, 5, 0, 6])

LOSS, DRAW, WIN = -1, 0, 1
ILLEGAL = -2

SIZE = (1 << 22) + 15
"""Entries of the table of positions: a prime, so that keys spread."""


class Judge:
    """Knows what every move is worth; remembers positions from one call to the next."""

    def __init__(self) -> None:
        self._keys, self._bounds = np.zeros(SIZE, np.int64), np.zeros(SIZE, np.int8)

    def values(self, observations: Array) -> Array:
        """Return what each column leads to, if both play on perfectly, for those on turn.

        Parameters
        ----------
        observations
            As agents who are on turn have them, shape ``(n, 6, 7, 2)``.

        Returns
        -------
        ``int8`` of shape ``(n, 7)``: :data:`WIN`, :data:`DRAW` or :data:`LOSS`; :data:`ILLEGAL` where a
        column is full.
        """
        boards = words(observations[..., 0]), words(observations[..., 1])
        result = np.empty((len(observations), COLUMNS), np.int8)
        for k, (own, other) in enumerate(zip(*boards, strict=True)):
            _values(own, own | other, self._keys, self._bounds, result[k])
        return result

    def optimal(self, observations: Array, actions: Array) -> Array:
        """Return which actions are as good as any other, ``bool`` of shape ``(n,)``."""
        values = self.values(observations)
        return np.asarray(values[np.arange(len(values)), actions] == values.max(1))


def words(discs: Array) -> Array:
    """Return pictures of discs, shape ``(n, 6, 7)`` with the top row first, as words."""
    place = 1 << (np.arange(ROWS - 1, -1, -1)[:, None] + HEIGHT * np.arange(COLUMNS))
    return np.asarray((discs.astype(np.int64) * place).sum((1, 2)))


@numba.njit(cache=False)
def _values(own: int, taken: int, keys: Any, bounds: Any, result: Any) -> None:
    wins = _threats(own, taken)
    for column in range(COLUMNS):
        move = (taken + BOTTOM) & COLUMN[column]
        if move == 0:
            result[column] = ILLEGAL
        elif move & wins:
            result[column] = WIN
        else:
            result[column] = -_outcome(own ^ taken, taken | move, LOSS, WIN, keys, bounds)


@numba.njit(cache=False)
def _outcome(own: int, taken: int, alpha: int, beta: int, keys: Any, bounds: Any) -> int:
    """Return what the position is worth to who is on turn, if that lies between ``alpha`` and ``beta``."""
    possible = (taken + BOTTOM) & BOARD
    if possible == 0:
        return DRAW
    if _threats(own, taken) & possible:
        return WIN
    other = own ^ taken
    threats = _threats(other, taken)
    forced = possible & threats
    if forced:
        if forced & (forced - 1):
            return LOSS  # two at once
        possible = forced
    possible &= ~(threats >> 1)  # nor below a cell with which the other would win
    if possible == 0:
        return LOSS
    key = own + taken + BOTTOM
    place = key % SIZE
    if keys[place] == key:
        low, high = bounds[place] // 3 - 1, bounds[place] % 3 - 1
        alpha, beta = max(alpha, low), min(beta, high)
        if alpha >= beta:
            bound: int = alpha if low >= beta else beta
            return bound
    else:
        low, high = LOSS, WIN
    first = alpha
    best: int = LOSS
    moves, scores, count = np.zeros(COLUMNS, np.int64), np.zeros(COLUMNS, np.int64), 0
    for k in range(COLUMNS):
        move = possible & COLUMN[FROM_THE_MIDDLE[k]]
        if move:
            score, at = _ones(_threats(own | move, taken | move)), count
            while at > 0 and scores[at - 1] < score:
                moves[at], scores[at] = moves[at - 1], scores[at - 1]
                at -= 1
            moves[at], scores[at] = move, score
            count += 1
    for k in range(count):
        value: int = -_outcome(other, taken | moves[k], -beta, -alpha, keys, bounds)
        best = max(best, value)
        alpha = max(alpha, value)
        if alpha >= beta:
            break
    if best >= beta:
        low = max(low, best)
    elif best <= first:
        high = min(high, best)
    else:
        low = high = best
    keys[place], bounds[place] = key, 3 * (low + 1) + high + 1
    return int(best)


@numba.njit(cache=False)
def _threats(own: int, taken: int) -> int:
    """Return the free cells with which four would be in a line."""
    result: int = (own << 1) & (own << 2) & (own << 3)
    for by in (HEIGHT, HEIGHT - 1, HEIGHT + 1):
        pair = (own << by) & (own << 2 * by)
        result |= pair & (own << 3 * by) | pair & (own >> by)
        pair = (own >> by) & (own >> 2 * by)
        result |= pair & (own << by) | pair & (own >> 3 * by)
    result &= BOARD ^ taken
    return result


@numba.njit(cache=False)
def _ones(word: int) -> int:
    count = 0
    while word:
        word &= word - 1
        count += 1
    return count
