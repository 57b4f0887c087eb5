"""The golden step of FrozenLake, for any map of up to 8 x 8 cells.

The map is two 64-bit constants, holes and goals: the cell in row r and column c is bit 8 * r + c.

Follows https://gymnasium.farama.org/environments/toy_text/frozen_lake/ (FrozenLake-v1).
"""

from __future__ import annotations

import numpy as np

from pearl_marl.golden import GoldenFunction, Word, uniform_below

SIDE = 8
LEFT, DOWN, RIGHT, UP = 0, 1, 2, 3
TO_GOAL, TO_HOLE, TO_FROZEN = 0, 1, 2


def make_initial(starts: list[tuple[int, int]]) -> GoldenFunction:
    """Return the golden function that starts in one of the cells ``(row, column)``, all alike.

    It takes a draw where there is a choice. A start's probability is off by less than ``2**-26`` of it.
    """
    count = len(starts)
    rows, columns = zip(*starts, strict=True)

    def initial(draw: Word) -> tuple[Word, Word]:
        k = uniform_below(draw, count)
        return rows[k], columns[k]

    row, column = starts[0]

    def initial_only() -> tuple[Word, Word]:
        return row, column

    return initial if count > 1 else initial_only


def make_step(n_rows: int, n_columns: int, holes: int, goals: int) -> GoldenFunction:
    """Return the golden step of a map without ice."""
    last_row, last_column = n_rows - 1, n_columns - 1
    hole_rows, goal_rows = (
        tuple(cells >> SIDE * k & (1 << SIDE) - 1 for k in range(SIDE)) for cells in (holes, goals)
    )

    def step(row: Word, column: Word, action: Word) -> tuple[Word, Word, Word, Word]:
        left = (action == LEFT) & (column > 0)
        right = (action == RIGHT) & (column < last_column)
        up = (action == UP) & (row > 0)
        down = (action == DOWN) & (row < last_row)
        row = row + down - up
        column = column + right - left
        hole, goal = hole_rows[row] >> column & 1, goal_rows[row] >> column & 1
        reward = np.where(goal, TO_GOAL, np.where(hole, TO_HOLE, TO_FROZEN))
        return row, column, reward, hole | goal

    return step


def make_step_slippery(
    n_rows: int, n_columns: int, holes: int, goals: int, turns_back: int, turns_on: int
) -> GoldenFunction:
    """Return the golden step of a map with ice.

    The ice turns the action to ``action - 1`` where the draw is below ``turns_back``, and to
    ``action + 1`` where it is ``turns_on`` or above. Either probability is off by less than ``2**-32``.
    """
    step = make_step(n_rows, n_columns, holes, goals)

    def step_slippery(row: Word, column: Word, action: Word, draw: Word) -> tuple[Word, Word, Word, Word]:
        turn = (draw >= turns_on) - (draw < turns_back)
        row, column, reward, terminated = step(row, column, (action + turn) % 4)
        return row, column, reward, terminated

    return step_slippery


def make_observe(n_columns: int) -> GoldenFunction:
    """Return the golden function that observes the number of the cell, ``n_columns * row + column``."""

    def observe(row: Word, column: Word) -> Word:
        return n_columns * row + column

    return observe
