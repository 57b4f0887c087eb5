"""The golden step of MyEnvironment: the whole of its dynamics, written once.

Replace it, piece by piece, by your own. As it stands, a robot walks along a corridor. It starts
somewhere in the middle; on a slippery floor it stays where it is now and then::

    P . . . . . . . . . . . . . . G
    0       4             11      15      P: pit, G: goal, 4 to 11: starts

It is plain Python, and the kernels for CPU and GPU and the hardware are made of it. Four things to know:

- A word is an integer, which never overflows. Whatever the state and the action, the next state has to fit
  the fields of the spec; if it may not, building the spec says so, with an example.
- There is no ``if`` on a word. A comparison is 0 or 1: combine such flags by ``&`` and ``|`` (with
  parentheses around each), and choose by ``np.where``.
- There are no floats. Numbers with a fraction are integers whose field in the spec has ``fraction`` bits.
- Random numbers come as arguments, uniform in 32 bits; the spec says how many.
"""

import numpy as np
from pearl_marl.golden import GoldenFunction, Word, uniform_below

LEFT, RIGHT = 0, 1
PIT, GOAL = 0, 15
FIRST_START, STARTS = 4, 8


def initial(draw: Word) -> Word:
    """Return the state of a new episode; takes as many draws as ``reset_draws`` in the spec."""
    return FIRST_START + uniform_below(draw, STARTS)


def make_step(slip: int) -> GoldenFunction:
    """Return the step for one choice of options, which are constants of the enclosing scope."""

    def step(cell: Word, action: Word, draw: Word) -> tuple[Word, Word, Word]:
        """Take the state, the action and ``step_draws`` draws; return state, reward and terminated."""
        slips = uniform_below(draw, 8) < slip
        move = np.where(slips, 0, np.where(action == RIGHT, 1, -1))
        cell = np.clip(cell + move, PIT, GOAL)

        goal, pit = cell == GOAL, cell == PIT
        # A category of the spec's table of rewards: 0 for a step, 1 for the goal, 2 for the pit.
        reward = goal + 2 * pit
        return cell, reward, goal | pit

    return step


def observe(cell: Word) -> Word:
    """Return the observation: a word for each field that the spec lists."""
    return cell
