"""The golden step of MyEnvironment, to be filled in as PORTING.md says.

What @original@ does, in plain Python.
"""

from typing import NamedTuple

from pearl_marl.golden import Draws, Word
from pearl_marl.layout import @kinds@

REWARDS = @rewards@
"""@rewards_note@"""


class State(NamedTuple):
    """What the original changes from step to step, with what was seen in @steps@ steps of it.

    Widen each range to all that there can be; leave out what only pictures need.
    """

@fields@
@view@

def initial(draws: Draws) -> State:
    """Return the state of a new episode."""
    raise NotImplementedError("initial() is still to be written: see PORTING.md, part 2")


@def_step@
    """Return the state after @an_action@, @what_rewards@ and @what_ends@."""
    raise NotImplementedError("step() is still to be written: see PORTING.md, part 4")


@def_observe@
    """Return what @an_agent@ sees."""
    raise NotImplementedError("observe() is still to be written: see PORTING.md, part 3")
