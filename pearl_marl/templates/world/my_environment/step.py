"""The golden step of MyEnvironment: the whole of its dynamics, written once.

Replace it, piece by piece, by your own. As it stands, robots pull a cart along a track. It starts somewhere
in the middle, and goes where more of them pull; on a slippery floor it stays where it is now and then::

    P . . . . . . . . . . . . . . G
    0       4             11      15      P: pit, G: goal, 4 to 11: starts

To pull takes strength, of which a robot has 3 at most, and to rest gives some back. So they have to take
turns, but each would rather that the others pull: resting costs nothing.

It is plain Python, and the kernels for CPU and GPU and the hardware are made of it. Five things to know:

- Numbers are integers that never overflow. Whatever the state and the actions, the next state has to fit
  the widths that ``State`` declares; if it may not, building the spec says so, with an example.
- Hardware takes both sides of an ``if`` at the same time, and chooses; it has all rounds of a loop side by
  side. So there are as many as can be known beforehand, and a list keeps its length.
- There are no floats. A field such as ``Signed[16, 8]`` is an integer of which 8 bits are a fraction.
- Random numbers come from ``draws``, and are the world's. Ask for one before an ``if``, not inside it.
- An agent that has ended before its world is out of the game: nothing may depend on its action any more.
  Here all end together.
"""

from typing import NamedTuple

from pearl_marl.golden import Draws, GoldenFunction, Word
from pearl_marl.layout import Array, Range

AGENTS = 2
REST, LEFT, RIGHT = 0, 1, 2
PIT, GOAL = 0, 15
FIRST_START, STARTS = 4, 8
STRONGEST = 3
RESTED, PULLED, REACHED, FELL = 0, 1, 2, 3
"""Categories of reward; the spec says what each is worth."""


class State(NamedTuple):
    """What the world remembers from one step to the next: where the cart is, and how strong each robot."""

    cell: Range[PIT, GOAL]
    strengths: Array[Range[0, STRONGEST], AGENTS]


class View(NamedTuple):
    """What one robot sees: the cart, and its own strength."""

    cell: Range[PIT, GOAL]
    strength: Range[0, STRONGEST]


def initial(draws: Draws) -> State:
    """Return the state of a new episode."""
    return State(FIRST_START + draws.below(STARTS), [STRONGEST] * AGENTS)


def make_step(slip: int) -> GoldenFunction:
    """Return the step for one choice of options, which are constants in it."""

    def step(state: State, actions: list[Word], draws: Draws) -> tuple[State, list[Word], list[Word]]:
        """Return the next state, and for each robot its reward and whether it has ended.

        Who is too tired to pull rests, as the masks say.
        """
        cell, strengths = state.cell, list(state.strengths)
        rewards = [RESTED] * AGENTS
        pull = 0
        for k, action in enumerate(actions):
            if action in (LEFT, RIGHT) and strengths[k] > 0:
                pull += 1 if action == RIGHT else -1
                strengths[k] -= 1
                rewards[k] = PULLED
            else:
                strengths[k] = min(strengths[k] + 1, STRONGEST)

        slips = draws.below(8) < slip
        if pull > 0 and not slips:
            cell = min(cell + 1, GOAL)
        elif pull < 0 and not slips:
            cell = max(cell - 1, PIT)

        if cell == GOAL:
            rewards = [REACHED] * AGENTS
        elif cell == PIT:
            rewards = [FELL] * AGENTS
        ended = cell in (PIT, GOAL)
        return State(cell, strengths), rewards, [ended] * AGENTS

    return step


def observe(state: State, agent: int) -> View:
    """Return what a robot sees."""
    return View(state.cell, state.strengths[agent])


def masks(state: State, agent: int) -> tuple[Word, Word, Word]:
    """Return which actions a robot may take: who is tired may only rest."""
    strong = state.strengths[agent] > 0
    return True, strong, strong
