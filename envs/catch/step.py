"""The golden step of Catch: a ball falls through a column of the board, and a paddle moves along the bottom.

Follows https://github.com/google-deepmind/bsuite (``bsuite`` 0.3.6, ``catch``): I. Osband et al., *Behaviour
Suite for Reinforcement Learning*, 2020.
"""

from typing import NamedTuple

from pearl_marl.golden import Draws, Word
from pearl_marl.layout import Range
from pearl_marl.spec import Golden

LEFT, STAY, RIGHT = range(3)
NOTHING, CAUGHT, MISSED = range(3)
"""Categories of the reward."""


def make_golden(rows: int, columns: int) -> Golden:
    """Return the golden functions of Catch on a board."""

    class State(NamedTuple):
        """The column and the row of the ball, and the column of the paddle."""

        ball_x: Range[0, columns - 1]
        ball_y: Range[0, rows - 1]
        paddle_x: Range[0, columns - 1]

    def initial(draws: Draws) -> State:
        """Drop a ball into any column, above a paddle in the middle."""
        return State(draws.below(columns), 0, columns // 2)

    def step(state: State, action: Word, draws: Draws) -> tuple[State, Word, Word]:
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
        return State(state.ball_x, ball_y, paddle_x), reward, landed

    def observe(state: State) -> State:
        """Return the observation: the state."""
        return state

    return Golden(State, initial, step, observe, view=State)
