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

from pearl_marl.golden import GoldenFunction, Word, u8, u16, u32, uniform_below

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
        row = u8(uniform_below(draw, SIDE))
        draw = u32(draw * u32(SIDE))
        column = u8(uniform_below(draw, SIDE))
        draw = u32(draw * u32(SIDE))
        passenger = u8(uniform_below(draw, 4))
        draw = u32(draw * u32(4))
        destination = u8(uniform_below(draw, 3))
        draw = u32(draw * u32(3))
        return row, column, passenger, _other(destination, passenger), u8(draw < u32(fickle_below))

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
    rains = int(is_rainy)

    def step_drawn(
        row: Word, column: Word, passenger: Word, destination: Word, fickle: Word, action: Word, draw: Word
    ) -> tuple[Word, Word, Word, Word, Word, Word, Word]:
        # The halves of draw * 3; two comparisons cost less than the upper half of a product.
        third, rest = u8(u8(draw >= u32(THIRD)) + u8(draw >= u32(TWO_THIRDS))), u32(draw * u32(3))
        slips = u8(u8(rains) & u8(rest >= u32(forward_below)))
        to_right = u8(rest >= u32(left_below))
        # Of a direction's two bits the upper one is the axis: a slip changes it. East, north, west and
        # south are to the left of south, east, north and west.
        axis, sign = u8(action >> u8(1)), u8(action & u8(1))
        aside = u8(u8(u8(axis ^ u8(1)) << u8(1)) | u8(u8(sign ^ axis) ^ to_right))
        slip_mask = u8(u8(0) - u8(slips & u8(action < PICKUP)))
        direction = u8(u8(action & u8(~slip_mask)) | u8(aside & slip_mask))

        was_aboard = u8(passenger == ABOARD)
        passenger, reward, terminated = _serve(row, column, passenger, destination, action)
        new_row, new_column = _drive(row, column, action, direction)
        moved = u8(u8(new_row != row) | u8(new_column != column))
        # At the first move with him a fickle passenger changes his mind, once.
        changes = u8(u8(fickle & was_aboard) & moved)
        change_mask = u8(u8(0) - changes)
        destination = u8(u8(destination & u8(~change_mask)) | u8(_other(third, destination) & change_mask))
        return new_row, new_column, passenger, destination, u8(fickle ^ changes), reward, terminated

    return step_drawn


def observe(row: Word, column: Word, passenger: Word, destination: Word, fickle: Word) -> Word:
    """Return the observation, ``((row * 5 + column) * 5 + passenger) * 4 + destination``."""
    cell = u8(u8(row * u8(SIDE)) + column)
    return u16(u16(u16(u8(u8(cell * u8(5)) + passenger)) << u16(2)) | u16(destination))


def _other(k: Word, stand: Word) -> Word:
    """Return the ``k``-th of the three stands that are not ``stand``."""
    return u8(k + u8(k >= stand))


def _drive(row: Word, column: Word, action: Word, direction: Word) -> tuple[Word, Word]:
    """Move in ``direction`` if the way is free there and where ``action`` wanted to go."""
    top, bottom = u8(row < 2), u8(row > 2)
    odd = u8(column & u8(1))
    south, north = u8(row < LAST), u8(row > 0)
    # Walls are east of column 1 in the upper two rows, and of columns 0 and 2 in the lower two.
    east_wall = u8(u8(top & u8(column == 1)) | u8(bottom & u8(odd ^ u8(1))))
    west_wall = u8(u8(top & u8(column == 2)) | u8(bottom & odd))
    east = u8(u8(column < LAST) & u8(east_wall ^ u8(1)))
    west = u8(u8(column > 0) & u8(west_wall ^ u8(1)))
    free = u8(
        u8(u8(u8(action == SOUTH) & south) | u8(u8(action == NORTH) & north))
        | u8(u8(u8(action == EAST) & east) | u8(u8(action == WEST) & west))
    )
    down = u8(free & u8(u8(direction == SOUTH) & south))
    up = u8(free & u8(u8(direction == NORTH) & north))
    right = u8(free & u8(u8(direction == EAST) & east))
    left = u8(free & u8(u8(direction == WEST) & west))
    return u8(u8(row + down) - up), u8(u8(column + right) - left)


def _serve(
    row: Word, column: Word, passenger: Word, destination: Word, action: Word
) -> tuple[Word, Word, Word]:
    """Pick up or drop off; return ``(passenger, reward, terminated)``."""
    at_west = u8(column == 0)
    at_red, at_green = u8(u8(row == 0) & at_west), u8(u8(row == 0) & u8(column == 4))
    at_yellow, at_blue = u8(u8(row == LAST) & at_west), u8(u8(row == LAST) & u8(column == 3))
    at_stand = u8(u8(at_red | at_green) | u8(at_yellow | at_blue))
    stand = u8(u8(at_green | at_blue) | u8(u8(at_yellow | at_blue) << u8(1)))

    picks_up = u8(u8(action == PICKUP) & u8(at_stand & u8(passenger == stand)))
    drops_off = u8(u8(action == DROPOFF) & u8(at_stand & u8(passenger == ABOARD)))
    delivered = u8(drops_off & u8(stand == destination))
    served = u8(picks_up | drops_off)
    illegal = u8(u8(action >= PICKUP) & u8(served ^ u8(1)))

    place = u8(u8(stand & u8(u8(0) - drops_off)) | u8(picks_up << u8(2)))  # ABOARD is 4
    passenger = u8(u8(passenger & u8(served - u8(1))) | place)
    return passenger, u8(illegal | u8(delivered << u8(1))), delivered
