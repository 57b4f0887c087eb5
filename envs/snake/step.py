"""The golden step of Snake, which goes a cell at a time and grows by one with each fruit.

A board has a bit for each cell of the snake. The order of these cells follows from its head and the head's
moves: the newest one led to the head, the one before it to the cell behind, and so on to the tail.

Follows https://github.com/instadeepai/jumanji (``jumanji`` 1.1.2, ``Snake-v1``).
"""

from typing import Any, NamedTuple

from pearl_marl.golden import Draws, Word, u32
from pearl_marl.layout import Array, Bits, Range
from pearl_marl.spec import Golden

MOVES = ((-1, 0), (0, 1), (1, 0), (0, -1))
"""Rows and columns that a move goes: up, right, down, left."""


def make_golden(rows: int, columns: int) -> Golden:
    """Return the golden functions of Snake on a grid."""
    cells, full = rows * columns, (1 << columns) - 1

    class Cell(NamedTuple):
        """A cell of the grid."""

        row: Range[0, rows - 1]
        column: Range[0, columns - 1]

    class State(NamedTuple):
        """The snake and the fruit."""

        head: Cell
        tail: Cell
        fruit: Cell
        length: Range[1, cells]
        moves: Array[Bits[32], -(-cells // 16)]
        """The head's, two bits each, the newest first."""
        body: Array[Bits[columns], rows]

    def initial(draws: Draws) -> State:
        """Return a snake of one cell, and a fruit in another."""
        row, column, place = draws.several(rows, columns, cells - 1)
        place += place >= columns * row + column
        head, fruit = Cell(row, column), Cell(place // columns, place % columns)
        return State(head, head, fruit, 1, [0] * -(-cells // 16), mask_of(head))

    def step(state: State, action: Word, draws: Draws) -> tuple[State, Word, Word]:
        """Go up (0), right (1), down (2) or left (3); a move that the mask forbids only ends the episode."""
        crashes = not masks(state)[action]
        head = neighbour(state.head, action)
        eats = head == state.fruit
        moves = with_move(state.moves, action)
        body, tail, fruit, length = state.body, state.tail, state.fruit, state.length
        if not eats:
            body = [line & ~tail_bit for line, tail_bit in zip(body, mask_of(tail), strict=True)]
            tail = neighbour(tail, move_of(moves, length - 1))
        body = [line | head_bit for line, head_bit in zip(body, mask_of(head), strict=True)]
        free = free_cell(body, draws)
        if eats:
            fruit, length = free, min(length + 1, cells)
        if crashes:
            return state, False, True
        return State(head, tail, fruit, length, moves, body), eats, all(line == full for line in body)

    def neighbour(cell: Cell, action: Word) -> Cell:
        """Return the cell that a move leads to; at the edge of the grid it is the same one."""
        down, right = MOVES[action]
        return Cell(min(max(cell.row + down, 0), rows - 1), min(max(cell.column + right, 0), columns - 1))

    def mask_of(cell: Cell) -> list[Word]:
        """Return a board that has this cell only."""
        return [(cell.row == row) << cell.column for row in range(rows)]

    def free_cell(body: list[Word], draws: Draws) -> Cell:
        """Return any cell that the snake is not in, all equally likely; the first one if there is none."""
        counts = [sum(1 - (line >> k & 1) for k in range(columns)) for line in body]
        left, free, row, column = draws.below(sum(counts)), 0, 0, 0
        for k in range(rows):
            if left < counts[k]:
                row, free = k, ~body[k]
                break
            left -= counts[k]
        for k in range(columns):
            if free >> k & 1:
                if left == 0:
                    column = k
                    break
                left -= 1
        return Cell(row, column)

    def observe(state: State) -> State:
        """Return the observation: the state."""
        return state

    def masks(state: State) -> list[Word]:
        """Return which moves stay on the grid and off the snake, whose tail moves on in time."""
        cells = [neighbour(state.head, action) for action in range(4)]
        return [
            cell != state.head and (cell == state.tail or not state.body[cell.row] >> cell.column & 1)
            for cell in cells
        ]

    return Golden(State, initial, step, observe, masks, view=State)


def with_move(moves: list[Word], action: Word) -> list[Word]:
    """Return the head's moves with a new one."""
    carried = [action, *[word >> 30 for word in moves[:-1]]]
    return [u32(word << 2) | last for word, last in zip(moves, carried, strict=True)]


def move_of(moves: Any, k: Word) -> Word:
    """Return the head's last move but ``k``."""
    return moves[k >> 4] >> 2 * (k & 15) & 3
