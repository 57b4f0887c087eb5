"""The golden step of Breakout, as MinAtar's ``breakout`` plays it.

MinAtar's directions of the ball are 0 up and left, 1 up and right, 2 down and right, 3 down and left. Here
two flags say the same: whether the ball flies rightward, and whether it falls.
"""

from typing import NamedTuple

from pearl_marl.envs.minatar import LAST, LEFT, NOTHING, RIGHT, SIDE, action_table, sticky
from pearl_marl.golden import Draws, GoldenFunction, Word
from pearl_marl.layout import Bits, Flag, Range

MINIMAL = (NOTHING, LEFT, RIGHT)
TO_LEFT, TO_RIGHT = 1, 2
"""Places of two actions in the minimal action set."""
TOP, BOTTOM = 1, 3
"""The first and the last row of bricks."""
BRICKS = SIDE * (BOTTOM - TOP + 1)
ALL_BRICKS = (1 << BRICKS) - 1


class State(NamedTuple):
    """The game. Bit ``10 * (y - 1) + x`` of ``bricks`` is the brick in row ``y`` and column ``x``."""

    last_action: Range[0, 2]
    paddle: Range[0, LAST]
    x: Range[0, LAST]
    y: Range[0, LAST]
    last_x: Range[0, LAST]
    last_y: Range[0, LAST]
    rightward: Flag
    falls: Flag
    strike: Flag
    """Whether the ball is inside a brick that the step before left there."""
    bricks: Bits[BRICKS]


class View(NamedTuple):
    """The paddle, the ball, where the ball was the step before (in a start, where it is), and the bricks."""

    paddle: Range[0, LAST]
    x: Range[0, LAST]
    y: Range[0, LAST]
    last_x: Range[0, LAST]
    last_y: Range[0, LAST]
    bricks: Bits[BRICKS]


def initial(draws: Draws) -> State:
    """Return the state of a new episode: the ball falls from the left edge or the right one."""
    from_right = draws.bits(1)
    x = LAST if from_right else 0
    return State(0, 4, x, 3, x, 3, 1 - from_right, True, False, ALL_BRICKS)


def make_step(sticky_action_prob: float, use_minimal_action_set: bool) -> GoldenFunction:
    """Return the golden step under its options."""
    actions = action_table(MINIMAL, use_minimal_action_set)

    def step(state: State, action: Word, draws: Draws) -> tuple[State, Word, Word]:
        """Play one step; return the next state, the reward and whether the episode terminated."""
        action = sticky(actions[action], state.last_action, draws, sticky_action_prob)
        paddle, rightward, falls, bricks = state.paddle, state.rightward, state.falls, state.bricks
        reward, strikes, terminated = 0, False, False
        if action == TO_LEFT:
            paddle = max(paddle - 1, 0)
        elif action == TO_RIGHT:
            paddle = min(paddle + 1, LAST)

        x = state.x + 1 if rightward else state.x - 1
        y = min(state.y + 1, LAST) if falls else state.y - 1
        if x < 0 or x > LAST:
            x, rightward = state.x, not rightward
        brick = 1 << SIDE * (y - TOP) + x if TOP <= y <= BOTTOM else 0
        if y < 0:
            y, falls = 0, not falls
        elif bricks & brick:
            strikes = True
            if not state.strike:
                reward, bricks = 1, bricks ^ brick
                y, falls = state.y, not falls
        elif y == LAST:
            bricks = bricks if bricks else ALL_BRICKS
            if state.x == paddle:
                y, falls = state.y, not falls
            elif x == paddle:
                y, falls, rightward = state.y, not falls, not rightward
            else:
                terminated = True
        after = State(action, paddle, x, y, state.x, state.y, rightward, falls, strikes, bricks)
        return after, reward, terminated

    return step


def observe(state: State) -> View:
    """Return what the agent observes."""
    return View(state.paddle, state.x, state.y, state.last_x, state.last_y, state.bricks)
