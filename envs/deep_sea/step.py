"""The golden step of DeepSea: a diver sinks by a row in every step, and moves left or right.

Which of the two actions is the right one differs from cell to cell.

Follows https://github.com/google-deepmind/bsuite (``bsuite`` 0.3.6, ``deep_sea``): I. Osband et al.,
*Behaviour Suite for Reinforcement Learning*, 2020.
"""

from collections.abc import Sequence
from typing import NamedTuple

from pearl_marl.golden import Draws, Word
from pearl_marl.layout import Range
from pearl_marl.spec import Golden

LEFT, RIGHT, TREASURE = range(3)
"""Categories of the reward: a move to the left, one to the right, and one to the right in the last column."""


def make_golden(size: int, rights: Sequence[int]) -> Golden:
    """Return the golden functions of a sea of so many rows and columns.

    Bit ``column`` of ``rights[row]`` is the action that moves to the right.
    """

    class State(NamedTuple):
        """The cell of the diver; the row below the last is the end."""

        row: Range[0, size]
        column: Range[0, size - 1]

    def initial(draws: Draws) -> State:
        """Put the diver into the upper left cell."""
        return State(0, 0)

    def step(state: State, action: Word, draws: Draws) -> tuple[State, Word, Word]:
        """Move to the left or to the right, and down by a row."""
        row, column = state
        moves_right = action == (rights[row] >> column & 1)
        reward = LEFT
        if moves_right:
            reward = TREASURE if column == size - 1 else RIGHT
        column = min(column + 1, size - 1) if moves_right else max(column - 1, 0)
        row = min(row + 1, size)
        return State(row, column), reward, row == size

    def observe(state: State) -> State:
        """Return the observation: the state."""
        return state

    return Golden(State, initial, step, observe, view=State)
