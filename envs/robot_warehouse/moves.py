"""Which robots move, of those that want to: no two into one cell, and no two past each other.

The package draws an edge from each robot's cell to the one that it wants to be in; networkx finds cycles and
longest paths. At most one edge leaves a cell, so it comes to this:

- Who stays is in the way, and so are two that want to change places. Nobody behind them moves.
- Four in a ring move on together, and nobody else moves into one of their cells.
- Of those that want the same cell, the one with the longest queue behind it goes, if the cell is free or
  becomes so. Of equally long queues, that goes which has the lowest number among its first two robots. But
  where two without a queue meet, and two others move freely elsewhere, it goes by :mod:`.ties`.

The last holds for up to four robots. With more, queues of any kind meet as ties of sets.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import TypeAlias

from pearl_marl.golden import Word

from .rules import WarehouseRules
from .ties import second_goes_first

MOST = 4
"""Robots whose ties are known."""
AHEAD = (0, -1), (0, 1), (-1, 0), (1, 0)
"""Columns and rows from a cell to the one ahead, by the direction: up, down, left, right."""

Flags: TypeAlias = Sequence[Word]
Ties: TypeAlias = Sequence[Sequence[Sequence[int]]]


def make_ties(rules: WarehouseRules) -> Ties:
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
    free = [not any(behind[k]) for k in each]
    # Of four robots two are left for the queues behind those that want the same cell. So one is longer than
    # another only where that has none; and of equally long ones robot 0 may stand at the end.
    queued = [any(behind[k][j] for k in each) for j in each]
    beaten = [0] * count
    for a, b in itertools.combinations(each, 2):
        same = targets[a] == targets[b]
        second = (queued[b] & (queued[a] == 0)) | behind[0][b]
        if count == MOST:
            c, d = (k for k in each if k not in (a, b))
            apart = (targets[c] != targets[a]) & (targets[d] != targets[a]) & (targets[c] != targets[d])
            alone = free[a] & free[c] & free[d] & moving[c] & moving[d] & apart
            second = second | (alone & tied(ties, directions[a], directions[b], targets[a]))
        beaten[a] = beaten[a] | (same & second)
        beaten[b] = beaten[b] | (same & (second == 0))
    first = [moves & (lost == 0) for moves, lost in zip(moving, beaten, strict=True)]

    goes = [f & open_ for f, open_ in zip(first, free, strict=True)]
    for _ in range(count - 1):
        goes = [first[k] & (free[k] | any(behind[k][j] & goes[j] for j in each)) for k in each]
    if count == MOST:
        rings = itertools.permutations(range(1, count))
        ring = any(behind[0][a] & behind[a][b] & behind[b][c] & behind[c][0] for a, b, c in rings)
        goes = [g | ring for g in goes]
    return goes


def tied(ties: Ties, first: Word, second: Word, target: Word) -> Word:
    """Return whether the second of two robots goes first, by their directions and the cell that they want."""
    every = itertools.permutations(range(len(AHEAD)), 2)
    return any((first == a) & (second == b) & ties[a][b][target] for a, b in every)
