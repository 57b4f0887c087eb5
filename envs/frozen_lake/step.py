"""The golden step of FrozenLake, for any map of up to 8 x 8 cells.

The map is two 64-bit constants, holes and goals: the cell in row r and column c is bit 8 * r + c.
To see what a cell is, all slots choose their row's byte out of the eight, by masks, and then their
column's bit. That is 50 instructions on bytes, 64 slots at a time; a table would be read slot by
slot, and a shift by ``8 * r + c`` happens in 64-bit words, an eighth as many at a time.

Follows https://gymnasium.farama.org/environments/toy_text/frozen_lake/ (FrozenLake-v1).
"""

from __future__ import annotations

import numpy as np

from pearl_marl.golden import GoldenFunction, Word, u8, u32, u64, uniform_below

SIDE = 8
LEFT, DOWN, RIGHT, UP = 0, 1, 2, 3
TO_GOAL, TO_HOLE, TO_FROZEN = 0, 1, 2


def make_initial(starts: list[tuple[int, int]]) -> GoldenFunction:
    """Return the golden function that starts in one of the cells ``(row, column)``, all alike.

    It takes a draw where there is a choice. A start's probability is off by less than ``2**-26`` of it.
    """
    count = len(starts)
    rows, columns = (np.array(part, np.uint8) for part in zip(*starts, strict=True))

    def initial(draw: Word) -> tuple[Word, Word]:
        k = uniform_below(draw, count)
        return u8(rows[k]), u8(columns[k])

    row, column = starts[0]

    def initial_only() -> tuple[Word, Word]:
        return u8(row), u8(column)

    return initial if count > 1 else initial_only


def make_step(n_rows: int, n_columns: int, holes: int, goals: int) -> GoldenFunction:
    """Return the golden step of a map without ice."""
    last_row, last_column = n_rows - 1, n_columns - 1

    def step(row: Word, column: Word, action: Word) -> tuple[Word, Word, Word, Word]:
        left = u8(u8(action == LEFT) & u8(column > 0))
        right = u8(u8(action == RIGHT) & u8(column < last_column))
        up = u8(u8(action == UP) & u8(row > 0))
        down = u8(u8(action == DOWN) & u8(row < last_row))
        row = u8(u8(row + down) - up)
        column = u8(u8(column + right) - left)

        holes_in_row, goals_in_row, bit = u8(0), u8(0), u8(0)
        for k in range(SIDE):  # the compiler unrolls this, and a byte of the map is a constant then
            in_row = u8(u8(0) - u8(row == k))
            holes_in_row = u8(holes_in_row | u8(in_row & u8(u64(holes) >> u64(SIDE * k))))
            goals_in_row = u8(goals_in_row | u8(in_row & u8(u64(goals) >> u64(SIDE * k))))
            in_column = u8(u8(0) - u8(column == k))
            bit = u8(bit | u8(in_column & u8(1 << k)))
        hole = u8(u8(holes_in_row & bit) != 0)
        goal = u8(u8(goals_in_row & bit) != 0)
        # Goal 0, hole 1, frozen 2: no cell is two of them.
        reward = u8(u8(TO_FROZEN) - u8(u8(goal + goal) + hole))
        return row, column, reward, u8(goal | hole)

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
        turn = u8(u8(draw >= u32(turns_back)) + u8(draw >= u32(turns_on)))
        row, column, reward, terminated = step(row, column, u8(u8(u8(action + turn) + u8(3)) & u8(3)))
        return row, column, reward, terminated

    return step_slippery


def make_observe(n_columns: int) -> GoldenFunction:
    """Return the golden function that observes the number of the cell, ``n_columns * row + column``."""

    def observe(row: Word, column: Word) -> Word:
        return u8(u8(row * u8(n_columns)) + column)

    return observe
