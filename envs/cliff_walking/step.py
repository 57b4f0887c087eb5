"""The golden step of CliffWalking: the whole of its dynamics, written once.

This is the environment to learn from, so the comments say what a golden step has to observe.
Everything else about writing one that is fast stands in ``docs/golden_steps.md``.

The grid has 4 rows and 12 columns::

    . . . . . . . . . . . .      row 0
    . . . . . . . . . . . .      row 1
    . . . . . . . . . . . .      row 2
    S C C C C C C C C C C G      row 3: start, ten cells of cliff, goal

Follows https://gymnasium.farama.org/environments/toy_text/cliff_walking/ (CliffWalking-v1),
itself example 6.6 of Sutton and Barto, *Reinforcement Learning: An Introduction*, 2nd edition.
"""

from pearl_marl.golden import Word, u8, uniform_below

# Names of constants are free: both NumPy and Numba see plain integers.
UP, RIGHT, DOWN, LEFT = 0, 1, 2, 3
LAST_ROW, LAST_COLUMN = 3, 11


def initial() -> tuple[Word, Word]:
    """Return the state of a new episode, ``(row, column)``: the lower left corner, always."""
    # An environment with random starts takes draws as arguments and says how many in its spec.
    return u8(LAST_ROW), u8(0)


def step(row: Word, column: Word, action: Word) -> tuple[Word, Word, Word, Word]:
    """Move one cell; return ``(row, column, reward, terminated)``.

    ``reward`` is a category: 0 for a step, 1 for a fall off the cliff. What a category is worth
    is the host's business, so rewards can change without rebuilding anything.
    """
    # No `if`: a comparison is 0 or 1, and is added. All slots then run the same instructions,
    # which is what lets a CPU do 64 of them at a time and hardware do one in a cycle.
    up = u8(u8(action == UP) & u8(row > 0))
    down = u8(u8(action == DOWN) & u8(row < LAST_ROW))
    left = u8(u8(action == LEFT) & u8(column > 0))
    right = u8(u8(action == RIGHT) & u8(column < LAST_COLUMN))
    # Every sum is cast back to its width, because Numba widens and NumPy does not.
    row = u8(u8(row + down) - up)
    column = u8(u8(column + right) - left)

    bottom = u8(row == LAST_ROW)
    terminated = u8(bottom & u8(column == LAST_COLUMN))
    fell = u8(bottom & u8(u8(column > 0) & u8(column < LAST_COLUMN)))
    # A fall sends the agent back to column 0. `fell - 1` is 0 or 255: a mask, not a branch.
    column = u8(column & u8(fell - u8(1)))
    return row, column, fell, terminated


def step_slippery(row: Word, column: Word, action: Word, draw: Word) -> tuple[Word, Word, Word, Word]:
    """Take :func:`step` after the ice has turned the action: left, not at all or right, 1/3 each."""
    turn = u8(uniform_below(draw, 3))  # 0, 1, 2 stand for -1, 0, +1; 4 directions, so -1 is +3
    return step(row, column, u8(u8(u8(action + turn) + u8(3)) & u8(3)))


def observe(row: Word, column: Word) -> Word:
    """Return the observation: the number of the cell, ``12 * row + column``."""
    return u8(u8(row * u8(12)) + column)
