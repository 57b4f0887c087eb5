"""The golden step of MemoryChain: a context is shown at the start, and one bit of it is asked for at the end.

What looks arbitrary is bsuite's: an observation is made before time goes on, so the first one is seen twice;
and what is asked for is seen in the step before the last one.

Follows https://github.com/google-deepmind/bsuite (``bsuite`` 0.3.6, ``memory_chain``): I. Osband et al.,
*Behaviour Suite for Reinforcement Learning*, 2020.
"""

from typing import NamedTuple

from pearl_marl.golden import Draws, Word
from pearl_marl.layout import Bits, Flag, Range
from pearl_marl.spec import Golden

NOTHING, RIGHT, WRONG = range(3)
"""Categories of the reward."""
DRAW_BITS = 32


def make_golden(length: int, bits: int) -> Golden:
    """Return the golden functions of so many steps before the answer, and a context of so many bits."""

    class State(NamedTuple):
        """The steps so far, the context, and which bit of it is asked for."""

        time: Range[0, length + 1]
        context: Bits[bits]
        query: Range[0, max(bits - 1, 1)]

    class View(NamedTuple):
        """The time, the question, whether the context is shown, and the context: 0 where none is shown."""

        time: Range[0, length]
        query: Range[0, max(bits - 1, 1)]
        visible: Flag
        context: Bits[bits]

    def initial(draws: Draws) -> State:
        """Draw a context and a question."""
        context = draws.bits(min(bits, DRAW_BITS))
        if bits > DRAW_BITS:
            context |= draws.bits(bits - DRAW_BITS) << DRAW_BITS
        return State(0, context, draws.below(bits) if bits > 1 else 0)

    def step(state: State, action: Word, draws: Draws) -> tuple[State, Word, Word]:
        """Let time go on; the last action is the answer."""
        time, context, query = state
        last = time >= length
        reward = NOTHING
        if last:
            reward = RIGHT if action == (context >> query & 1) else WRONG
        return State(min(time + 1, length + 1), context, query), reward, last

    def observe(state: State) -> View:
        """Return the observation, made before time went on."""
        time = max(state.time - 1, 0)
        first, asked = time == 0, time == length - 1
        return View(time, state.query if asked else 0, first, state.context if first else 0)

    return Golden(State, initial, step, observe, view=View)
