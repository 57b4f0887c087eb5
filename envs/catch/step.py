"""The golden step of Catch: a ball falls through a column of the board, and a paddle moves along the bottom.

Follows https://github.com/google-deepmind/bsuite (``bsuite`` 0.3.6, ``catch``): I. Osband et al., *Behaviour
Suite for Reinforcement Learning*, 2020.
"""

from typing import Any, NamedTuple

from pearl_marl.golden import Draws, GoldenFunction, Word
from pearl_marl.layout import Range

LEFT, STAY, RIGHT = range(3)
NOTHING, CAUGHT, MISSED = range(3)
"""Categories of the reward."""


def state_of(rows: int, columns: int) -> Any:
    """Return the class of states of a board."""

    class State(NamedTuple):
        """The column and the row of the ball, and the column of the paddle."""

        ball_x: Range[0, columns - 1]
        ball_y: Range[0, rows - 1]
        paddle_x: Range[0, columns - 1]

    return State


def make_initial(state_class: Any, columns: int) -> GoldenFunction:
    """Return the golden function that drops a ball into any column, above a paddle in the middle."""

    def initial(draws: Draws) -> Any:
        return state_class(draws.below(columns), 0, columns // 2)

    return initial


def make_step(state_class: Any, rows: int, columns: int) -> GoldenFunction:
    """Return the golden step of a board."""

    def step(state: Any, action: Word, draws: Draws) -> tuple[Any, Word, Word]:
        """Move the paddle left (0), not at all (1) or right (2), and let the ball fall by a row."""
        paddle_x = state.paddle_x
        if action == LEFT:
            paddle_x = max(paddle_x - 1, 0)
        elif action == RIGHT:
            paddle_x = min(paddle_x + 1, columns - 1)
        ball_y = min(state.ball_y + 1, rows - 1)
        landed = ball_y == rows - 1
        reward = NOTHING
        if landed:
            reward = CAUGHT if paddle_x == state.ball_x else MISSED
        return state_class(state.ball_x, ball_y, paddle_x), reward, landed

    return step


def observe(state: Any) -> Any:
    """Return the observation: the state."""
    return state
