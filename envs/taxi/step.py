"""The golden step of Taxi, in sun and rain, with passengers of any temper.

The town, in which ``|`` is a wall and R, G, Y, B are the stands 0 to 3::

    R: | : :G      row 0
     : | : :       row 1
     : : : :       row 2
     | : | :       row 3
    Y| : |B:       row 4

Follows https://gymnasium.farama.org/environments/toy_text/taxi/ (Taxi-v4), itself after Dietterich,
*Hierarchical Reinforcement Learning with the MAXQ Value Function Decomposition*, 2000.
"""

from __future__ import annotations

from typing import NamedTuple

from pearl_marl.golden import Draws, GoldenFunction, Word, u32
from pearl_marl.layout import Bits, Flag

SIDE, LAST = 5, 4
SOUTH, NORTH, EAST, WEST, PICKUP, DROPOFF = 0, 1, 2, 3, 4, 5
LEFT_OF, RIGHT_OF = (EAST, WEST, NORTH, SOUTH), (WEST, EAST, SOUTH, NORTH)
STANDS = (0, 0), (0, 4), (4, 0), (4, 3)
ABOARD, NOWHERE = 4, 5
"""Where a passenger is who is at none of the stands; and what is no stand."""
CELLS = [divmod(cell, 8) for cell in range(64)]  # that three bits for a row and a column can tell
STAND = [STANDS.index(cell) if cell in STANDS else NOWHERE for cell in CELLS]
THIRD, TWO_THIRDS = 0x55555556, 0xAAAAAAAB
"""The least draws whose products with 3 reach ``2**32`` and ``2 * 2**32``."""
ROUTINE, ILLEGAL, DELIVERED = 0, 1, 2


class State(NamedTuple):
    """Where taxi and passenger are; the passenger may yet change the destination, which nobody sees."""

    row: Bits[3]
    column: Bits[3]
    passenger: Bits[3]
    destination: Bits[2]
    fickle: Flag


def other(k: Word, stand: Word) -> Word:
    """Return the ``k``-th of the three stands that are not ``stand``."""
    return k + (k >= stand)


def make_initial(fickle_below: int) -> GoldenFunction:
    """Return the golden function that puts taxi, passenger and destination into a new town.

    The taxi is anywhere, the passenger at a stand and his destination another one. He is fickle if what is
    left of the draw is below ``fickle_below``. All of it comes from one draw, digit by digit: the upper
    half of a product is a digit, the lower half serves as the next draw. So the 300 starts are those of
    ``uniform_below(draw, 300)``, off by less than ``2**-23`` of their probability, and so is the share
    of the fickle.
    """

    def initial(draws: Draws) -> State:
        left, found = draws.bits(), []
        for n in (SIDE, SIDE, 4, 3):
            found.append(left * n >> 32)
            left = u32(left * n)
        row, column, passenger, destination = found
        return State(row, column, passenger, other(destination, passenger), left < fickle_below)

    return initial


def make_step(is_rainy: bool, is_fickle: bool, forward_below: int, left_below: int) -> GoldenFunction:
    """Return the golden step, which takes a draw in rain and for fickle passengers.

    In rain a taxi that could drive on does so if the draw times 3, modulo ``2**32``, is below
    ``forward_below``; it slips to the left if it is below ``left_below``, and to the right if not. Since
    3 is odd these products are as evenly spread as the draws, and a probability is off by less than
    ``2**-31``. What the product loses at the top is a choice of three, the new destination.
    """

    def step(state: State, action: Word, draws: Draws) -> tuple[State, Word, Word]:
        row, column, passenger, destination, fickle = state
        draw = draws.bits() if is_rainy or is_fickle else 0
        # The halves of draw * 3; two comparisons cost less than the upper half of a product.
        third, rest = (draw >= THIRD) + (draw >= TWO_THIRDS), u32(draw * 3)
        # Walls are east of column 1 in the upper two rows, and of columns 0 and 2 in the lower two.
        top, bottom, odd = row < 2, row > 2, column & 1
        east_wall = (top and column == 1) or (bottom and not odd)
        west_wall = (top and column == 2) or (bottom and odd)
        free = row < LAST, row > 0, column < LAST and not east_wall, column > 0 and not west_wall
        # A flag for each direction: to choose one by its number takes longer.
        moves = [action == to and way for to, way in enumerate(free)]
        if is_rainy:
            drives, ahead = any(moves), action & 3
            aside = LEFT_OF[ahead] if rest < left_below else RIGHT_OF[ahead]
            direction = ahead if rest < forward_below else aside
            moves = [drives and direction == to and way for to, way in enumerate(free)]
        down, up, right, left = moves
        # At the first move with him a fickle passenger changes his mind, once.
        if is_fickle and fickle and passenger == ABOARD and any(moves):
            destination, fickle = other(third, destination), False

        stand = STAND[8 * row + column]
        picks_up = action == PICKUP and passenger == stand
        drops_off = action == DROPOFF and passenger == ABOARD and stand != NOWHERE
        delivered, reward = drops_off and stand == destination, ROUTINE
        if delivered:
            reward = DELIVERED
        elif action >= PICKUP and not picks_up and not drops_off:
            reward = ILLEGAL
        if picks_up:
            passenger = ABOARD
        elif drops_off:
            passenger = stand
        row, column = row + down - up, column + right - left
        return State(row, column, passenger, destination, fickle), reward, delivered

    return step


def observe(state: State) -> Word:
    """Return the observation, ``((row * 5 + column) * 5 + passenger) * 4 + destination``."""
    # Towns that are larger than this one would need more than its nine bits; no taxi is there.
    cell = state.row * SIDE + state.column
    return (cell * 5 + state.passenger) * 4 + state.destination & 511
