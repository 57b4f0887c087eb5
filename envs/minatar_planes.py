"""Numbers of many things at once, in planes: bit ``k`` of a plane is a bit of the number in place ``k``.

One instruction then does the same to all of them, which is fast on a CPU and nearly free in hardware.
MinAtar's Seaquest, Asterix and Freeway keep what moves like this.
"""

from __future__ import annotations

from collections.abc import Sequence

from pearl_marl.golden import Word


def bits(number: Word, count: int) -> list[Word]:
    """Return the bits of a number, the lowest first."""
    return [number >> k & 1 for k in range(count)]


def spread(bit: Word) -> Word:
    """Return a plane of this bit in every place."""
    return -1 if bit else 0


def lowest(plane: Word) -> Word:
    """Keep the lowest set bit only: the first of the list."""
    return plane & -plane


def places_of(planes: list[Word], number: Word) -> Word:
    """Return the places where a number stands."""
    differ = 0
    for k, plane in enumerate(planes):
        differ = differ | (plane ^ spread(number >> k & 1))
    return ~differ


def moved(column: list[Word], rightward: Word, moves: Word) -> list[Word]:
    """Move the places of ``moves`` a column on. From 0 to the left is 15, from 9 to the right is 10."""
    result = []
    for plane in column:
        result.append(plane ^ moves)
        # A carry goes on through ones to the right, a borrow through zeros to the left.
        moves = moves & ~(plane ^ rightward)
    return result


def off_board(column: list[Word]) -> Word:
    """Return the places whose column is 10 or more."""
    return column[3] & (column[1] | column[2])


def counted_down(timer: list[Word], ends: Word) -> tuple[list[Word], Word]:
    """Count a timer down in the places of ``ends``; return it, all ones where it was 0, and these places."""
    result = []
    for plane in timer:
        result.append(plane ^ ends)
        ends = ends & ~plane
    return result, ends


def number_in(planes: Sequence[Word], place: int) -> Word:
    """Return the number that stands in a place."""
    return sum((plane >> place & 1) << k for k, plane in enumerate(planes))


def number(planes: Sequence[Word], bit: int) -> int:
    """Return the number that stands in the place of a bit; for ``unpack``."""
    result = 0
    for k, plane in enumerate(planes):
        result += 1 << k if plane & bit else 0
    return result
