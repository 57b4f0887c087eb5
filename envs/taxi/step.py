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

import numpy as np

from pearl_marl.golden import GoldenFunction, Word, u32, uniform_below

SIDE, LAST = 5, 4
SOUTH, NORTH, EAST, WEST, PICKUP, DROPOFF = 0, 1, 2, 3, 4, 5
ABOARD = 4
"""Where a passenger is who is at none of the four stands."""
THIRD, TWO_THIRDS = 0x55555556, 0xAAAAAAAB
"""The least draws whose products with 3 reach ``2**32`` and ``2 * 2**32``."""
ROUTINE, ILLEGAL, DELIVERED = 0, 1, 2


def make_initial(fickle_below: int) -> GoldenFunction:
    """Return the golden function that puts taxi, passenger and destination into a new town.

    The taxi is anywhere, the passenger at a stand and his destination another one. He is fickle if what is
    left of the draw is below ``fickle_below``. All of it comes from one draw, digit by digit: the upper
    half of a product is a digit, the lower half serves as the next draw. So the 300 starts are those of
    ``uniform_below(draw, 300)``, off by less than ``2**-23`` of their probability, and so is the share
    of the fickle.
    """

    def initial(draw: Word) -> tuple[Word, Word, Word, Word, Word]:
        row, draw = _digit(draw, SIDE)
        column, draw = _digit(draw, SIDE)
        passenger, draw = _digit(draw, 4)
        destination, draw = _digit(draw, 3)
        return row, column, passenger, _other(destination, passenger), draw < fickle_below

    return initial


def step(
    row: Word, column: Word, passenger: Word, destination: Word, fickle: Word, action: Word
) -> tuple[Word, Word, Word, Word, Word, Word, Word]:
    """Drive, fetch or deliver, in dry weather with a steadfast passenger."""
    passenger, reward, terminated = _serve(row, column, passenger, destination, action)
    row, column = _drive(row, column, action, action)
    return row, column, passenger, destination, fickle, reward, terminated


def make_step(is_rainy: bool, forward_below: int, left_below: int) -> GoldenFunction:
    """Return the golden step in rain, or for fickle passengers, or both.

    In rain a taxi that could drive on does so if the draw times 3, modulo ``2**32``, is below
    ``forward_below``; it slips to the left if it is below ``left_below``, and to the right if not. Since
    3 is odd these products are as evenly spread as the draws, and a probability is off by less than
    ``2**-31``. What the product loses at the top is a choice of three, the new destination.
    """

    def step_drawn(
        row: Word, column: Word, passenger: Word, destination: Word, fickle: Word, action: Word, draw: Word
    ) -> tuple[Word, Word, Word, Word, Word, Word, Word]:
        # The halves of draw * 3; two comparisons cost less than the upper half of a product.
        third, rest = (draw >= THIRD) + (draw >= TWO_THIRDS), u32(draw * 3)
        slips = is_rainy & (rest >= forward_below) & (action < PICKUP)
        # Of a direction's two bits the upper one is the axis: a slip changes it. East, north, west and
        # south are to the left of south, east, north and west.
        axis, sign = action >> 1, action & 1
        aside = 2 * (axis == 0) + (sign ^ axis ^ (rest >= left_below))
        direction = np.where(slips, aside, action)

        was_aboard = passenger == ABOARD
        passenger, reward, terminated = _serve(row, column, passenger, destination, action)
        new_row, new_column = _drive(row, column, action, direction)
        moved = (new_row != row) | (new_column != column)
        # At the first move with him a fickle passenger changes his mind, once.
        changes = fickle & was_aboard & moved
        destination = np.where(changes, _other(third, destination), destination)
        return new_row, new_column, passenger, destination, fickle ^ changes, reward, terminated

    return step_drawn


def observe(row: Word, column: Word, passenger: Word, destination: Word, fickle: Word) -> Word:
    """Return the observation, ``((row * 5 + column) * 5 + passenger) * 4 + destination``."""
    # Towns that are larger than this one would need more than its nine bits; no taxi is there.
    return (((row * SIDE + column) * 5 + passenger) * 4 + destination) & 511


def _digit(draw: Word, n: int) -> tuple[Word, Word]:
    """Return a digit of 0 to ``n - 1`` and the next draw, the halves of ``draw * n``."""
    return uniform_below(draw, n), u32(draw * n)


def _other(k: Word, stand: Word) -> Word:
    """Return the ``k``-th of the three stands that are not ``stand``."""
    return k + (k >= stand)


def _drive(row: Word, column: Word, action: Word, direction: Word) -> tuple[Word, Word]:
    """Move in ``direction`` if the way is free there and where ``action`` wanted to go."""
    top, bottom, odd = row < 2, row > 2, column & 1
    # Walls are east of column 1 in the upper two rows, and of columns 0 and 2 in the lower two.
    east_wall = (top & (column == 1)) | (bottom & (odd == 0))
    west_wall = (top & (column == 2)) | (bottom & odd)
    south, north = row < LAST, row > 0
    east = (column < LAST) & (east_wall == 0)
    west = (column > 0) & (west_wall == 0)
    free = (
        ((action == SOUTH) & south)
        | ((action == NORTH) & north)
        | ((action == EAST) & east)
        | ((action == WEST) & west)
    )
    down = free & (direction == SOUTH) & south
    up = free & (direction == NORTH) & north
    right = free & (direction == EAST) & east
    left = free & (direction == WEST) & west
    return row + down - up, column + right - left


def _serve(
    row: Word, column: Word, passenger: Word, destination: Word, action: Word
) -> tuple[Word, Word, Word]:
    """Pick up or drop off; return ``(passenger, reward, terminated)``."""
    at_red, at_green = (row == 0) & (column == 0), (row == 0) & (column == 4)
    at_yellow, at_blue = (row == LAST) & (column == 0), (row == LAST) & (column == 3)
    at_stand = at_red | at_green | at_yellow | at_blue
    stand = at_green + 2 * at_yellow + 3 * at_blue

    picks_up = (action == PICKUP) & at_stand & (passenger == stand)
    drops_off = (action == DROPOFF) & at_stand & (passenger == ABOARD)
    delivered = drops_off & (stand == destination)
    illegal = (action >= PICKUP) & ((picks_up | drops_off) == 0)

    passenger = np.where(picks_up, ABOARD, np.where(drops_off, stand, passenger))
    reward = np.where(delivered, DELIVERED, np.where(illegal, ILLEGAL, ROUTINE))
    return passenger, reward, delivered
