"""Which robots move, of those that want to: no two into one cell, and no two past each other.

The package draws an edge from each robot's cell to the one that it wants to be in, and has networkx find cycles
and longest paths. From a cell leads at most one edge, so it comes to this:

- Who stays is in the way, and so are two that want to change places. Behind them nobody moves.
- Four in a ring move on together, and nobody else who wants into one of their cells.
- Of those that want the same cell, the one goes that has the longest queue behind it, if that cell is free or
  becomes so. Of equally long queues the one goes that has the robot with the least number at its end or its head;
  of two without any, both robots else moving freely, that which comes first in a set.

The last two hold of up to four robots: with more there are other ties.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Sequence
from typing import TypeAlias

import numpy as np

from pearl_marl.golden import Word

from .rules import Rules
from .ties import second_goes_first

MOST = 4
"""Robots whose ties are known."""
AHEAD = (0, -1), (0, 1), (-1, 0), (1, 0)
"""Columns and rows from a cell to the one ahead, by the direction: up, down, left, right."""

Flags: TypeAlias = Sequence[Word]
Ties: TypeAlias = Sequence[Sequence[Sequence[int]]]


def any_of(flags: Iterable[Word]) -> Word:
    """Return a word that is 0 where all of these are."""
    result: Word = 0
    for flag in flags:
        result = result | flag
    return result


def make_ties(rules: Rules) -> Ties:
    """Return whether the second of two robots goes first, by their directions and the cell that they want."""
    cells = [(number % rules.stride, number // rules.stride) for number in range(1 << rules.cell_bits)]

    def goes_first(first: int, target: tuple[int, int], second: int) -> bool:
        (x, y), (a, b), (c, d) = target, AHEAD[first], AHEAD[second]
        # Off the grid nobody comes from.
        inside = min(x - a, y - b, x - c, y - d) >= 0
        return first != second and inside and second_goes_first((x - a, y - b), target, (x - c, y - d))

    every = range(len(AHEAD))
    return [[[int(goes_first(a, cell, b)) for cell in cells] for b in every] for a in every]


def movers(cells: Flags, targets: Flags, directions: Flags, ties: Ties) -> list[Word]:
    """Return which robots move, by their cells, the cells that they want to be in, and their directions."""
    count = len(cells)
    each = range(count)
    moving = [target != cell for cell, target in zip(cells, targets, strict=True)]
    # behind[k][j]: robot k wants into robot j's cell.
    behind = [[0 if j == k else targets[k] == cells[j] for j in each] for k in each]
    free = [any_of(behind[k]) == 0 for k in each]
    # Behind two that want the same cell there are at most all others, one behind the other.
    longer: list[Word] = [1] * count
    queues: list[Word] = [0] * count
    for _ in range(count - 2):
        longer = [any_of(behind[k][j] & longer[k] for k in each) for j in each]
        queues = [queue + more for queue, more in zip(queues, longer, strict=True)]

    beaten: list[Word] = [0] * count
    for a, b in itertools.combinations(each, 2):
        same = targets[a] == targets[b]
        second = queues[b] > queues[a]
        if count > 2:
            earlier = behind[0][b]
            if count == MOST:
                c, d = (k for k in each if k not in (a, b))
                others = (targets[c] != targets[a]) & (targets[d] != targets[a]) & (targets[c] != targets[d])
                alone = free[a] & free[c] & free[d] & moving[c] & moving[d] & others
                earlier = earlier | (alone & tied(ties, directions[a], directions[b], targets[a]))
            second = second | ((queues[a] == queues[b]) & earlier)
        beaten[a] = beaten[a] | (same & second)
        beaten[b] = beaten[b] | (same & (second == 0))
    first = [moves & (lost == 0) for moves, lost in zip(moving, beaten, strict=True)]

    goes = [f & open_ for f, open_ in zip(first, free, strict=True)]
    for _ in range(count - 1):
        goes = [first[k] & (free[k] | any_of(behind[k][j] & goes[j] for j in each)) for k in each]
    if count == MOST:
        rings = itertools.permutations(range(1, count))
        ring = any_of(behind[0][a] & behind[a][b] & behind[b][c] & behind[c][0] for a, b, c in rings)
        goes = [g | ring for g in goes]
    return goes


def tied(ties: Ties, first: Word, second: Word, target: Word) -> Word:
    """Return whether the second of two robots goes first, by their directions and the cell that they want."""
    every = itertools.permutations(range(len(AHEAD)), 2)
    return any_of((first == a) & (second == b) & ties[a][b][target] for a, b in every)
