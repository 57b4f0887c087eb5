"""The golden step of CliffWalking: the whole of its dynamics, written once.

This is the environment to learn from, so the comments say what a golden function has to observe.
Everything else about writing one stands in ``docs/golden_steps.md``.

The grid has 4 rows and 12 columns::

    . . . . . . . . . . . .      row 0
    . . . . . . . . . . . .      row 1
    . . . . . . . . . . . .      row 2
    S C C C C C C C C C C G      row 3: start, ten cells of cliff, goal

Follows https://gymnasium.farama.org/environments/toy_text/cliff_walking/ (CliffWalking-v1),
itself example 6.6 of Sutton and Barto, *Reinforcement Learning: An Introduction*, 2nd edition.
"""

from typing import NamedTuple

from pearl_marl.golden import Draws, Word
from pearl_marl.layout import Bits

UP, RIGHT, DOWN, LEFT = 0, 1, 2, 3
LAST_ROW, LAST_COLUMN = 3, 11
STEP, FELL = 0, 1
"""Categories of reward. What one is worth is the host's business: rewards change without a new bitstream."""


class State(NamedTuple):
    """Where the walker is. Six bits hold it; two fields spare the hardware a division."""

    row: Bits[2]
    column: Bits[4]


def initial(draws: Draws) -> State:
    """Return the state of a new episode: the lower left corner, always."""
    return State(LAST_ROW, 0)


def step(state: State, action: Word, draws: Draws) -> tuple[State, Word, Word]:
    """Move one cell; return the state, the category of the reward and whether the episode terminated."""
    # Plain Python, in which a comparison is 0 or 1, and so can be added. An `if` for each direction would do,
    # too; but hardware does both sides of an `if` at the same time, and then chooses.
    row, column = state
    row += (action == DOWN and row < LAST_ROW) - (action == UP and row > 0)
    column += (action == RIGHT and column < LAST_COLUMN) - (action == LEFT and column > 0)

    if row == LAST_ROW and 0 < column < LAST_COLUMN:
        return State(LAST_ROW, 0), FELL, False
    return State(row, column), STEP, row == LAST_ROW and column == LAST_COLUMN


def step_slippery(state: State, action: Word, draws: Draws) -> tuple[State, Word, Word]:
    """Take :func:`step` after the ice has turned the action: left, not at all or right, 1/3 each."""
    turn = draws.below(3) - 1
    return step(state, (action + turn) % 4, draws)


def observe(state: State) -> Word:
    """Return the observation: the number of the cell, ``12 * row + column``."""
    return 12 * state.row + state.column
