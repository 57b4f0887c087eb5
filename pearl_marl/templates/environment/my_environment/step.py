"""The golden step of MyEnvironment: the whole of its dynamics, written once.

Replace it, piece by piece, by your own. As it stands, a robot walks along a corridor. It starts
somewhere in the middle; on a slippery floor it stays where it is now and then::

    P . . . . . . . . . . . . . . G
    0       4             11      15      P: pit, G: goal, 4 to 11: starts

The same functions run as plain Python (that is the reference), compiled by Numba (the CPU device),
and as hardware that is generated from them. For that:

- Cast after every operation: ``u8(a + b)``. NumPy and Numba widen a sum in different ways.
- No ``if`` on data. A comparison is 0 or 1: add it, or make a mask of it. All slots then run the
  same instructions, which is what lets a CPU do 64 at a time and hardware one in a cycle.
- No floats. Numbers with a fraction are integers whose field in the spec has ``fraction`` bits.
"""

from pearl_marl.golden import GoldenFunction, Word, u8, uniform_below

LEFT, RIGHT = 0, 1
PIT, GOAL = 0, 15
FIRST_START, STARTS = 4, 8


def initial(draw: Word) -> Word:
    """Return the state of a new episode; takes as many draws as ``reset_draws`` in the spec."""
    # A draw is a uniform u32. uniform_below(draw, n) makes 0 .. n - 1 of it.
    return u8(u8(uniform_below(draw, STARTS)) + u8(FIRST_START))


def make_step(slip: int) -> GoldenFunction:
    """Return the step for one choice of options, which are constants of the enclosing scope."""

    def step(cell: Word, action: Word, draw: Word) -> tuple[Word, Word, Word]:
        """Take the state, the action and ``step_draws`` draws; return state, reward and terminated."""
        moves = u8(uniform_below(draw, 8) >= slip)
        # Steps from an ended state are computed too, though nobody sees them. Whatever the state,
        # the next one has to fit its field.
        left = u8(u8(moves & u8(action == LEFT)) & u8(cell > PIT))
        right = u8(u8(moves & u8(action == RIGHT)) & u8(cell < GOAL))
        cell = u8(u8(cell + right) - left)

        goal, pit = u8(cell == GOAL), u8(cell == PIT)
        # A category of the spec's table of rewards: 0 for a step, 1 for the goal, 2 for the pit.
        reward = u8(goal + u8(pit << u8(1)))
        return cell, reward, u8(goal | pit)

    return step


def observe(cell: Word) -> Word:
    """Return the observation: a word for each field that the spec lists."""
    return cell
