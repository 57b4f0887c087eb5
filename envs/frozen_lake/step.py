"""The golden step of FrozenLake, for any map of up to 8 x 8 cells.

Follows https://gymnasium.farama.org/environments/toy_text/frozen_lake/ (FrozenLake-v1).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from pearl_marl.golden import Draws, Word
from pearl_marl.layout import Bits
from pearl_marl.spec import Golden

SIDE = 8
LEFT, DOWN, RIGHT, UP = 0, 1, 2, 3
TO_GOAL, TO_HOLE, TO_FROZEN = 0, 1, 2


class State(NamedTuple):
    """The cell that the walker is in."""

    row: Bits[3]
    column: Bits[3]


def make_golden(lake: Sequence[str], slips: float) -> Golden:
    """Return the golden functions of a map.

    With probability ``slips`` the ice turns the action to ``action - 1``, and as often to ``action + 1``.
    Either probability is off by less than ``2**-32``.
    """
    starts = [State(r, c) for r, line in enumerate(lake) for c, letter in enumerate(line) if letter == "S"]
    columns = len(lake[0])
    last_row, last_column = len(lake) - 1, columns - 1
    letters = "".join(line.ljust(SIDE) for line in lake).ljust(SIDE * SIDE)
    ground = [{"G": TO_GOAL, "H": TO_HOLE}.get(letter, TO_FROZEN) for letter in letters]
    slips_below = round(slips * 2**32)

    def initial(draws: Draws) -> State:
        """Start in one of the cells ``S``, all alike.

        It takes a draw where there is a choice. A start's probability is off by less than ``2**-26`` of it.
        """
        return draws.choice(starts) if len(starts) > 1 else starts[0]

    def step(state: State, action: Word, draws: Draws) -> tuple[State, Word, Word]:
        """Go left (0), down (1), right (2) or up (3), unless the ice turns the action."""
        row, column = state
        if slips_below:
            draw = draws.bits()
            action = (action + (draw >= 2**32 - slips_below) - (draw < slips_below)) % 4
        row += (action == DOWN and row < last_row) - (action == UP and row > 0)
        column += (action == RIGHT and column < last_column) - (action == LEFT and column > 0)
        arrived = ground[SIDE * row + column]
        return State(row, column), arrived, arrived != TO_FROZEN

    def observe(state: State) -> Word:
        """Return the number of the cell."""
        return columns * state.row + state.column

    return Golden(State, initial, step, observe)
