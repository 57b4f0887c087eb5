"""The golden step of DeepSea: a diver sinks by a row in every step, and moves left or right.

Which of the two actions is the right one differs from cell to cell.

Follows https://github.com/google-deepmind/bsuite (``bsuite`` 0.3.6, ``deep_sea``): I. Osband et al.,
*Behaviour Suite for Reinforcement Learning*, 2020.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

from pearl_marl.golden import Draws, GoldenFunction, Word
from pearl_marl.layout import Range

LEFT, RIGHT, TREASURE = range(3)
"""Categories of the reward: a move to the left, one to the right, and one to the right in the last column."""


def state_of(size: int) -> Any:
    """Return the class of states of a sea of so many rows and columns."""

    class State(NamedTuple):
        """The cell of the diver; the row below the last is the end."""

        row: Range[0, size]
        column: Range[0, size - 1]

    return State


def make_initial(state_class: Any) -> GoldenFunction:
    """Return the golden function that puts the diver into the upper left cell."""

    def initial(draws: Draws) -> Any:
        return state_class(0, 0)

    return initial


def make_step(state_class: Any, size: int, rights: Sequence[int]) -> GoldenFunction:
    """Return the golden step; bit ``column`` of ``rights[row]`` is the action that moves to the right."""

    def step(state: Any, action: Word, draws: Draws) -> tuple[Any, Word, Word]:
        """Move to the left or to the right, and down by a row."""
        row, column = state
        moves_right = action == (rights[row] >> column & 1)
        reward = LEFT
        if moves_right:
            reward = TREASURE if column == size - 1 else RIGHT
        column = min(column + 1, size - 1) if moves_right else max(column - 1, 0)
        row = min(row + 1, size)
        return state_class(row, column), reward, row == size

    return step


def observe(state: Any) -> Any:
    """Return the observation: the state."""
    return state
