"""The golden step of ConnectFour, on bitboards.

A player's discs are 42 bits, bit ``7 * row + column`` with row 0 on top, as PettingZoo numbers its board.
Four in a row are found by shifts: the cells that begin four of them in some direction are those that are
set in a board and in its copies moved by one, two and three steps. Rows follow each other without a gap, so
what would run on into the next row is left out by where four may begin.

Follows https://pettingzoo.farama.org/environments/classic/connect_four/ (``connect_four_v3``): J. K. Terry et
al., *PettingZoo: Gym for Multi-Agent Reinforcement Learning*, 2021.
"""

from __future__ import annotations

import numpy as np

from pearl_marl.golden import Word

ROWS, COLUMNS, CELLS = 6, 7, 42
FULL = (1 << CELLS) - 1
TOP_ROW = (1 << COLUMNS) - 1
BOTTOM_ROW = TOP_ROW << COLUMNS * (ROWS - 1)
LEFTMOST = sum(1 << COLUMNS * row for row in range(ROWS))
COLUMN = (*(LEFTMOST << column for column in range(COLUMNS)), 0)
"""The cells of a column, by the action; three bits hold one that is none."""
LEFT_HALF = sum(LEFTMOST << column for column in range(4))
RIGHT_HALF = sum(LEFTMOST << column for column in range(3, 7))
LINES = ((1, LEFT_HALF), (COLUMNS, FULL), (COLUMNS + 1, LEFT_HALF), (COLUMNS - 1, RIGHT_HALF))
"""By direction, how many bits a step is, and in which columns four may begin: the uppermost of them, or the
leftmost of a row."""


def initial() -> tuple[Word, Word, Word]:
    """Return ``(first, second, turn)`` of a new game: an empty board, and the first player's turn."""
    return 0, 0, 0


def step(
    first: Word, second: Word, turn: Word, action_0: Word, action_1: Word
) -> tuple[Word, Word, Word, Word, Word, Word, Word]:
    """Drop a disc of the player on turn; return the state, two rewards, and twice whether the game is over.

    Who chooses a column that is full loses one point and ends the game, and his opponent wins nothing.
    """
    own, other = np.where(turn, second, first), np.where(turn, first, second)
    taken = first | second
    # Where a disc comes to lie, in each column that has room: free, and with a disc or the ground below.
    landing = (taken >> COLUMNS | BOTTOM_ROW) & ~taken
    action: Word = np.where(turn, action_1, action_0)
    disc = landing & COLUMN[action]
    own = own | disc
    illegal = disc == 0
    won = has_four(own)
    over = won | illegal | (taken | disc == FULL)
    gain, loss = won - illegal, -won
    return (
        np.where(turn, other, own),
        np.where(turn, own, other),
        turn ^ 1,
        np.where(turn, loss, gain),
        np.where(turn, gain, loss),
        over,
        over,
    )


def observe(first: Word, second: Word, turn: Word, agent: int) -> tuple[Word, Word]:
    """Return the discs of an agent, and those of the other."""
    return (second, first) if agent else (first, second)


def masks(first: Word, second: Word, turn: Word, agent: int) -> tuple[Word, ...]:
    """Return which columns have room; none for who is not on turn."""
    room = np.where(turn == agent, ~(first | second) & TOP_ROW, 0)
    return tuple(room >> column & 1 for column in range(COLUMNS))


def has_four(board: Word) -> Word:
    """Return whether four discs of a board are in a row."""
    begins = 0
    for by, columns in LINES:
        pair = board & (board >> by)
        begins = begins | (pair & (pair >> 2 * by) & columns)
    return begins != 0
