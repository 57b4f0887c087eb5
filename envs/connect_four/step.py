"""The golden step of ConnectFour, on bitboards.

A player's discs are 42 bits, bit ``7 * row + column`` with row 0 on top, as PettingZoo numbers its board.
Four in a row are found by shifts: the cells that begin four of them in some direction are those that are
set in a board and in its copies moved by one, two and three steps. Rows follow each other without a gap, so
what would run on into the next row is left out by where four may begin.

Follows https://pettingzoo.farama.org/environments/classic/connect_four/ (``connect_four_v3``): J. K. Terry et
al., *PettingZoo: Gym for Multi-Agent Reinforcement Learning*, 2021.
"""

from __future__ import annotations

from typing import NamedTuple

from pearl_marl.golden import Draws, Word
from pearl_marl.layout import Array, Bits, Flag

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


class State(NamedTuple):
    """The discs of each player, and whose turn it is."""

    boards: Array[Bits[CELLS], 2]
    turn: Flag


class View(NamedTuple):
    """The discs of an agent, and those of the other."""

    own: Bits[CELLS]
    other: Bits[CELLS]


def initial(draws: Draws) -> State:
    """Return the state of a new game: an empty board, and the first player's turn."""
    return State([0, 0], 0)


def step(state: State, actions: list[Word], draws: Draws) -> tuple[State, list[Word], list[Word]]:
    """Drop a disc of the player on turn.

    Who chooses a column that is full loses one point and ends the game, and his opponent wins nothing.
    """
    boards, turn = state
    taken = boards[0] | boards[1]
    # Where a disc comes to lie, in each column that has room: free, and with a disc or the ground below.
    landing = (taken >> COLUMNS | BOTTOM_ROW) & ~taken
    disc = landing & COLUMN[actions[turn]]
    own = boards[turn] | disc
    boards[turn] = own
    won, illegal = has_four(own), disc == 0
    gain, loss = won - illegal, -won
    over = won or illegal or taken | disc == FULL
    return State(boards, 1 - turn), [loss, gain] if turn else [gain, loss], [over, over]


def observe(state: State, agent: int) -> View:
    """Return what an agent sees."""
    return View(state.boards[agent], state.boards[1 - agent])


def masks(state: State, agent: int) -> list[Word]:
    """Return which columns have room; none for who is not on turn."""
    room = ~(state.boards[0] | state.boards[1]) & TOP_ROW if state.turn == agent else 0
    return [room >> column & 1 for column in range(COLUMNS)]


def has_four(board: Word) -> Word:
    """Return whether four discs of a board are in a row."""
    begins = 0
    for by, columns in LINES:
        pair = board & board >> by
        begins |= pair & pair >> 2 * by & columns
    return begins != 0
