"""The golden step of Minesweeper: an explored cell tells how many of its neighbours have a mine.

Follows https://github.com/instadeepai/jumanji (``jumanji`` 1.1.2, ``Minesweeper-v0``).
"""

from functools import reduce
from operator import or_
from typing import NamedTuple

from pearl_marl.golden import Draws, Word
from pearl_marl.layout import Array, Bits
from pearl_marl.spec import Golden


def make_golden(rows: int, columns: int, mines: int) -> Golden:
    """Return the golden functions of Minesweeper on a board with so many mines."""
    cells, full = rows * columns, (1 << columns) - 1

    class State(NamedTuple):
        """Which cells have a mine, and which have been explored: a bit for each, in a word for each row."""

        mines: Array[Bits[columns], rows]
        explored: Array[Bits[columns], rows]

    class View(NamedTuple):
        """Planes of four bits a cell: how many neighbours have a mine, or 15 where it is unexplored."""

        numbers: Array[Bits[columns], rows, 4]

    def initial(draws: Draws) -> State:
        """Return a board of mines, every choice of cells equally likely, as R. W. Floyd samples."""
        chosen: list[Word] = []
        for last, cell in enumerate(draws.several(*range(cells - mines + 1, cells + 1)), cells - mines):
            chosen.append(last if cell in chosen else cell)
        return State([reduce(or_, lines) for lines in zip(*map(board_of, chosen), strict=True)], [0] * rows)

    def step(state: State, action: Word, draws: Draws) -> tuple[State, Word, Word]:
        """Explore a cell; one that has been explored ends the game, as a mine does."""
        cell = board_of(action)
        ending = [mined | explored for mined, explored in zip(state.mines, state.explored, strict=True)]
        safe = any(line & ~before for line, before in zip(cell, ending, strict=True))
        solved = all(line | before == full for line, before in zip(cell, ending, strict=True))
        explored = [line | before for line, before in zip(cell, state.explored, strict=True)]
        return State(state.mines, explored), safe, solved or not safe

    def board_of(cell: Word) -> list[Word]:
        """Return a board with one cell; without any if there is no such cell."""
        return [(cell // columns == row) << cell % columns for row in range(rows)]

    def observe(state: State) -> View:
        """Return what the explored cells tell."""
        lines = zip(near(state.mines), state.explored, strict=True)
        return View([[plane | full & ~explored for plane in planes] for planes, explored in lines])

    def near(mines: list[Word]) -> list[list[Word]]:
        """Return for each row four planes of how many of the eight neighbours have a mine."""
        counts: list[list[Word]] = []
        for above, line, below in zip([0, *mines[:-1]], mines, [*mines[1:], 0], strict=True):
            sides = [side for own in (above, line, below) for side in (own << 1 & full, own >> 1)]
            sums = [[flags] for flags in (above, below, *sides)]
            while len(sums) > 1:
                sums = [added(one, other) for one, other in zip(sums[::2], sums[1::2], strict=True)]
            counts += sums
        return counts

    def masks(state: State) -> list[Word]:
        """Return which cells are unexplored."""
        return [1 - (line >> column & 1) for line in state.explored for column in range(columns)]

    return Golden(State, initial, step, observe, masks, view=View)


def added(one: list[Word], other: list[Word]) -> list[Word]:
    """Return the planes of the sums of two numbers a cell, with a plane more."""
    total: list[Word] = []
    carry: Word = 0
    for a, b in zip(one, other, strict=True):
        total.append(a ^ b ^ carry)
        carry = a & b | carry & (a ^ b)
    return [*total, carry]
