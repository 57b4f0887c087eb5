"""The golden step of MyEnvironment: the whole of its dynamics, written once.

Replace it, piece by piece, by your own. As it stands, robots pull a cart along a track. It starts somewhere
in the middle, and goes where more of them pull; on a slippery floor it stays where it is now and then::

    P . . . . . . . . . . . . . . G
    0       4             11      15      P: pit, G: goal, 4 to 11: starts

To pull takes strength, of which a robot has 3 at most, and to rest gives some back. So they have to take
turns, but each would rather that the others pull: resting costs nothing.

It is plain Python, and the kernels for CPU and GPU and the hardware are made of it. Five things to know:

- A word is an integer, which never overflows. Whatever the state and the actions, the next state has to fit
  the fields of the spec; if it may not, building the spec says so, with an example.
- There is no ``if`` on a word. A comparison is 0 or 1: combine such flags by ``&`` and ``|`` (with
  parentheses around each), and choose by ``np.where``. An ``if`` on ``agent`` is fine: it is a number.
- There are no floats. Numbers with a fraction are integers whose field in the spec has ``fraction`` bits.
- Random numbers come as arguments, uniform in 32 bits; the spec says how many. They are the world's.
- An agent that has ended before its world is out of the game: nothing may depend on its action any more.
  Here all end together.
"""

import numpy as np
from pearl_marl.golden import GoldenFunction, Word, uniform_below

AGENTS = 2
REST, LEFT, RIGHT = 0, 1, 2
PIT, GOAL = 0, 15
FIRST_START, STARTS = 4, 8
STRONGEST = 3


def initial(draw: Word) -> tuple[Word, ...]:
    """Return the state of a new episode: the cart's cell, and each robot's strength."""
    return FIRST_START + uniform_below(draw, STARTS), *(STRONGEST for _ in range(AGENTS))


def make_step(slip: int) -> GoldenFunction:
    """Return the step for one choice of options, which are constants of the enclosing scope."""

    def step(*words: Word) -> tuple[Word, ...]:
        """Take the state, the actions and ``step_draws`` draws.

        Return the state, all rewards, and for each agent whether it has ended. Who is too tired to pull
        rests, as the masks say.
        """
        cell, strengths = words[0], words[1 : 1 + AGENTS]
        actions, draw = words[1 + AGENTS : 1 + 2 * AGENTS], words[-1]
        pull: Word = 0
        after, pulling = [], []
        for strength, action in zip(strengths, actions, strict=True):  # unrolls: the robots side by side
            left = (action == LEFT) & (strength > 0)
            right = (action == RIGHT) & (strength > 0)
            pull = pull + right - left
            pulling.append(left | right)
            after.append(np.where(left | right, strength - 1, np.minimum(strength + 1, STRONGEST)))
        moves = (pull > 0) - (pull < 0)
        slips = uniform_below(draw, 8) < slip
        cell = np.clip(cell + np.where(slips, 0, moves), PIT, GOAL)

        goal, pit = cell == GOAL, cell == PIT
        # Categories of the spec's table of rewards: 0 to rest, 1 to pull, 2 for the goal, 3 for the pit.
        rewards = [np.where(goal, 2, np.where(pit, 3, pulls)) for pulls in pulling]
        return cell, *after, *rewards, *[goal | pit] * AGENTS

    return step


def observe(*words: Word) -> tuple[Word, Word]:
    """Return what an agent, the last of the words, observes: the cart's cell and its own strength."""
    *state, agent = words
    return state[0], state[1 + agent]


def masks(*words: Word) -> tuple[Word, Word, Word]:
    """Return which actions an agent, the last of the words, may take: who is tired may only rest."""
    *state, agent = words
    strong = state[1 + agent] > 0
    return 1, strong, strong
