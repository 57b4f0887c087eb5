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

import numpy as np

from pearl_marl.golden import Word, uniform_below

UP, RIGHT, DOWN, LEFT = 0, 1, 2, 3
LAST_ROW, LAST_COLUMN = 3, 11


def initial() -> tuple[Word, Word]:
    """Return the state of a new episode, ``(row, column)``: the lower left corner, always."""
    # An environment with random starts takes draws as arguments and says how many in its spec.
    return LAST_ROW, 0


def step(row: Word, column: Word, action: Word) -> tuple[Word, Word, Word, Word]:
    """Move one cell; return ``(row, column, reward, terminated)``.

    ``reward`` is a category: 0 for a step, 1 for a fall off the cliff. What a category is worth
    is the host's business, so rewards can change without rebuilding anything.
    """
    # No `if`: all slots run the same instructions, and hardware does them in one cycle. A comparison
    # is 0 or 1, so it can be combined by `&` and added.
    up = (action == UP) & (row > 0)
    down = (action == DOWN) & (row < LAST_ROW)
    left = (action == LEFT) & (column > 0)
    right = (action == RIGHT) & (column < LAST_COLUMN)
    row = row + down - up
    column = column + right - left

    bottom = row == LAST_ROW
    terminated = bottom & (column == LAST_COLUMN)
    fell = bottom & (column > 0) & (column < LAST_COLUMN)
    # Where Python would say `if fell: column = 0`:
    column = np.where(fell, 0, column)
    return row, column, fell, terminated


def step_slippery(row: Word, column: Word, action: Word, draw: Word) -> tuple[Word, Word, Word, Word]:
    """Take :func:`step` after the ice has turned the action: left, not at all or right, 1/3 each."""
    turn = uniform_below(draw, 3) - 1
    return step(row, column, (action + turn) % 4)


def observe(row: Word, column: Word) -> Word:
    """Return the observation: the number of the cell, ``12 * row + column``."""
    return 12 * row + column
