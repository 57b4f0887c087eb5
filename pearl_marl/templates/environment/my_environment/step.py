"""The golden step of MyEnvironment: the whole of its dynamics, written once.

Replace it, piece by piece, by your own. As it stands, a robot walks along a corridor. It starts
somewhere in the middle; on a slippery floor it stays where it is now and then::

    P . . . . . . . . . . . . . . G
    0       4             11      15      P: pit, G: goal, 4 to 11: starts

It is plain Python, and the kernels for CPU and GPU and the hardware are made of it. Four things to know:

- Numbers are integers that never overflow. Whatever the state and the action, the next state has to fit
  the widths that ``State`` declares; if it may not, building the spec says so, with an example.
- Hardware takes both sides of an ``if`` at the same time, and chooses; it has all rounds of a loop side by
  side. So there are as many as can be known beforehand, and a list keeps its length.
- There are no floats. A field such as ``Signed[16, 8]`` is an integer of which 8 bits are a fraction.
- Random numbers come from ``draws``. Ask for one before an ``if``, not inside it.
"""

from typing import NamedTuple

from pearl_marl.golden import Draws, GoldenFunction, Word
from pearl_marl.layout import Range

LEFT, RIGHT = 0, 1
PIT, GOAL = 0, 15
FIRST_START, STARTS = 4, 8
STEP, REACHED, FELL = 0, 1, 2
"""Categories of reward; the spec says what each is worth."""


class State(NamedTuple):
    """What the environment remembers from one step to the next: here where the robot is, in four bits."""

    cell: Range[PIT, GOAL]


def initial(draws: Draws) -> State:
    """Return the state of a new episode."""
    return State(FIRST_START + draws.below(STARTS))


def make_step(slip: int) -> GoldenFunction:
    """Return the step for one choice of options, which are constants in it."""

    def step(state: State, action: Word, draws: Draws) -> tuple[State, Word, Word]:
        """Return the next state, the reward and whether the episode has terminated."""
        move = 1 if action == RIGHT else -1
        if draws.below(8) < slip:
            move = 0
        cell = min(max(state.cell + move, PIT), GOAL)

        if cell == GOAL:
            return State(cell), REACHED, True
        if cell == PIT:
            return State(cell), FELL, True
        return State(cell), STEP, False

    return step


def observe(state: State) -> Word:
    """Return what the agent sees."""
    return state.cell
