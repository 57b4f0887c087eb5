"""The golden step of TicTacToe, on boards of nine bits.

Cells are numbered as PettingZoo does: 0 to 2 are the first column of its picture, from the top down.

Follows https://pettingzoo.farama.org/environments/classic/tictactoe/ (``tictactoe_v3``): J. K. Terry et al.,
*PettingZoo: Gym for Multi-Agent Reinforcement Learning*, 2021.
"""

from typing import NamedTuple

from pearl_marl.golden import Draws, Word
from pearl_marl.layout import Array, Bits, Flag

CELLS = 9
FULL = (1 << CELLS) - 1
LINES = (0o007, 0o070, 0o700, 0o111, 0o222, 0o444, 0o421, 0o124)
"""Three cells in a row: an octal digit has the bits of three cells."""


class State(NamedTuple):
    """The marks of each player, and whose turn it is."""

    boards: Array[Bits[CELLS], 2]
    turn: Flag


class View(NamedTuple):
    """The marks of an agent, and those of the other."""

    own: Bits[CELLS]
    other: Bits[CELLS]


def initial(draws: Draws) -> State:
    """Return the state of a new game: an empty board, and the first player's turn."""
    return State([0, 0], 0)


def step(state: State, actions: list[Word], draws: Draws) -> tuple[State, list[Word], list[Word]]:
    """Mark a cell for the player on turn.

    A player that chooses a cell with a mark loses one point and ends the game, and the other wins nothing.
    """
    boards, turn = state
    # Of actions that are no cell, nothing is left below bit 9.
    mark = 1 << actions[turn] & FULL & ~(boards[0] | boards[1])
    own = boards[turn] | mark
    boards[turn] = own
    won, illegal = any(own & line == line for line in LINES), mark == 0
    gain, loss = won - illegal, -won
    over = won or illegal or boards[0] | boards[1] == FULL
    return State(boards, 1 - turn), [loss, gain] if turn else [gain, loss], [over, over]


def observe(state: State, agent: int) -> View:
    """Return what an agent sees."""
    return View(state.boards[agent], state.boards[1 - agent])


def masks(state: State, agent: int) -> list[Word]:
    """Return which cells are free; none for an agent that is not on turn."""
    free = FULL & ~(state.boards[0] | state.boards[1]) if state.turn == agent else 0
    return [free >> cell & 1 for cell in range(CELLS)]
