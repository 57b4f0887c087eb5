"""Who goes first of two robots that want the same cell, where the package leaves it to Python's sets.

The package puts robots' moves into a networkx graph, and of equally long queues that want the same cell the one goes
whose node comes first in a copy of the component. Nodes come in the order in which robots were added, as long as
the component is at least half of the graph. Of a smaller one networkx takes them from a set: that of the component,
which was filled from the first robot on, filled into another set.

Here is what CPython's sets do, so that a core does not depend on the Python that made it: a hash of xxHash's
kind, and a table of 8 places in which a node that meets another tries the next one.
"""

from __future__ import annotations

from collections.abc import Sequence

PLACES, SHIFT = 8, 5
"""Places of a set of up to four, and the bits of a hash that each further try takes in."""
PRIME_1, PRIME_2, PRIME_5 = 11400714785074694791, 14029467366897019727, 2870177450012600261
WORD = (1 << 64) - 1

Cell = tuple[int, int]


def hash_of(cell: Cell) -> int:
    """Return CPython's hash of a pair of small numbers, without a sign."""
    mixed = PRIME_5
    for lane in cell:
        mixed = (mixed + lane * PRIME_2) & WORD
        mixed = (mixed << 31 | mixed >> 33) & WORD
        mixed = mixed * PRIME_1 & WORD
    return (mixed + (len(cell) ^ PRIME_5 ^ 3527539)) & WORD


def in_a_set(cells: Sequence[Cell]) -> list[Cell]:
    """Return up to four cells in the order in which a set has them that they are put into one by one."""
    table: dict[int, Cell] = {}
    for cell in cells:
        rest = hash_of(cell)
        place = rest % PLACES
        while place in table:
            rest >>= SHIFT
            place = (place * 5 + 1 + rest) % PLACES
        table[place] = cell
    return [table[place] for place in sorted(table)]


def second_goes_first(first: Cell, target: Cell, second: Cell) -> bool:
    """Return whether of two that want to move to a target the one with the greater number comes first."""
    order = in_a_set(in_a_set((first, target, second)))
    return order.index(second) < order.index(first)
