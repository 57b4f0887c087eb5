"""Boards of bits shown as planes of bytes, for an environment's ``unpack``."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

from pearl_marl.golden import Word


def interleave(first: Word, second: Word, count: int, row: Any) -> None:
    """Write the bits of two boards into a row by turns.

    Parameters
    ----------
    first, second
        Words, of which bit ``k`` becomes ``row[2 * k]`` and ``row[2 * k + 1]``.
    count
        How many bits of each, 1 to 64; a constant.
    row
        A flat array of bytes, 0 or 1 each. CPU kernels write 16 to 64 of them at a time.
    """
    for bit in range(count):
        row[2 * bit] = int(first) >> bit & 1
        row[2 * bit + 1] = int(second) >> bit & 1


class BoardCells(NamedTuple):
    """Where a board's cells are in a flat row of elements; constants."""

    lines: int
    columns: int
    first: int
    """The first element of line 0, column 0."""
    channels: int
    """Elements of a cell."""


def mark(
    places: Word,
    line: Sequence[Word],
    column: Sequence[Word],
    beside: int,
    cells: BoardCells,
    channel: int,
    row: Any,
) -> None:
    """Set an element of a picture for each of many things; nothing where its cell is not on the board.

    Parameters
    ----------
    places
        A word of up to 63 bits, of which bit ``k`` is set if there is a thing in place ``k``.
    line, column
        Where things are: words, from the lowest bit of the numbers on, in which bit ``k`` is of the number in
        place ``k``.
    beside
        How many columns to the right of a thing the element is; a constant.
    cells, channel
        Which element of each cell it is; constants.
    row
        A flat array of bytes, 0 or 1 each.
    """
    for y in range(min(cells.lines, 1 << len(line))):
        here = places
        for k in range(len(line)):
            here = here & (line[k] if y >> k & 1 else ~line[k])
        for x in range(max(0, beside), min(cells.columns, (1 << len(column)) + beside)):
            there = here
            for k in range(len(column)):
                there = there & (column[k] if x - beside >> k & 1 else ~column[k])
            element = cells.first + (y * cells.columns + x) * cells.channels + channel
            row[element] = row[element] | (there != 0)


def mark_moving(
    places: Word,
    second: Word,
    rightward: Word,
    line: Sequence[Word],
    column: Sequence[Word],
    cells: BoardCells,
    channels: tuple[int, int, int],
    row: Any,
) -> None:
    """Set elements of a picture for each of many things of two kinds, and for the cells that they came from.

    Parameters
    ----------
    places, line, column, cells, row
        As :func:`mark` takes them.
    second, rightward
        Words, of which bit ``k`` tells whether the thing in place ``k`` is of the second kind, and whether it
        moves to the right.
    channels
        Which element of its cell the first kind sets, which one the second, and which one of the cell behind
        it either; constants.
    """
    mark(places & ~second, line, column, 0, cells, channels[0], row)
    mark(places & second, line, column, 0, cells, channels[1], row)
    mark(places & rightward, line, column, -1, cells, channels[2], row)
    mark(places & ~rightward, line, column, 1, cells, channels[2], row)
