"""The golden step of MyEnvironment: a look into the tables of all that its original does.

The tables are in @files@, written by

    pearl new MyEnvironment --from @original@@option@

which ran it in every state.
"""

from typing import NamedTuple

from pearl_marl.golden import Draws, Word
from pearl_marl.layout import @kinds@

from .tables import @names@

STATES, ACTIONS, OUTCOMES = @states@, @actions@, @outcomes@


class State(NamedTuple):
    """Which of the states it is@which@."""

    number: Range[0, STATES - 1]
@view@

def initial(draws: Draws) -> State:
    """Return the state of a new episode."""
@initial@


def step(state: State, action: Word, draws: Draws) -> tuple[State, Word, Word]:
    """Look up what the action does; a random draw chooses among its outcomes, if there are several."""
@step@


def observe(state: State) -> @observed@:
    """Return the observation."""
    @observe@
@helpers@