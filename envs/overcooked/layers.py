"""The package's ``lossless_state_encoding``: 26 layers, made from the words of an observation."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from pearl_marl.golden import GoldenFunction

from .kitchen import Kitchen
from .step import clock_bits

COUNT = 26
OWN_PLACE, OTHER_PLACE, OWN_NORTH, OTHER_NORTH, FIRST_STATION = 0, 1, 2, 6, 10
"""Where the layers of the cooks begin, and those of the kitchen itself."""
ONIONS_IN_POT, TOMATOES_IN_POT, ONIONS_IN_SOUP, TOMATOES_IN_SOUP, TIME_LEFT = range(16, 21)
DONE, DISH, ONION, TOMATO, URGENT = range(21, COUNT)
STATIONS = "PXOTDS"
"""What the layers of the kitchen show, in their order."""


def background(kitchen: Kitchen) -> npt.NDArray[np.uint8]:
    """Return the layers of an empty kitchen, flat."""
    layers = np.zeros((kitchen.width, kitchen.height, COUNT), np.uint8)
    for k, kind in enumerate(STATIONS):
        for x, y in kitchen.cells(kind):
            layers[x, y, FIRST_STATION + k] = 1
    return layers.ravel()


def make_unpack(kitchen: Kitchen) -> GoldenFunction:
    """Return the function that writes an observation of shape ``(width, height, 26)``."""
    empty = background(kitchen)
    size = len(empty)

    def places(cells: list[tuple[int, int]]) -> tuple[int, ...]:
        return tuple((x * kitchen.height + y) * COUNT for x, y in cells)

    # For all numbers that the bits of a cell can hold.
    floor = (places(kitchen.floor) * 2)[: 1 << kitchen.cell_bits]
    counters, pots = places(kitchen.counters), places(kitchen.pots)
    onion, dish, tomato = kitchen.onion, kitchen.dish, kitchen.tomato
    n_counters, n_pots, n_planes = len(counters), len(pots), kitchen.item_bits
    soup_bits, time_bits = kitchen.soup_bits, clock_bits(kitchen)
    any_soup, any_time = (1 << soup_bits) - 1, (1 << time_bits) - 1

    def show_item(item: int, place: int, row: Any) -> None:
        if item == onion:
            row[place + ONION] = 1
        elif item == dish:
            row[place + DISH] = 1
        elif item == tomato:
            row[place + TOMATO] = 1
        elif item:
            row[place + ONIONS_IN_SOUP] = item & 3
            row[place + TOMATOES_IN_SOUP] = item >> 2
            row[place + DONE] = 1

    def unpack(view: Any, row: Any) -> None:
        for k in range(size):
            row[k] = empty[k]
        place = floor[view.own.cell]
        row[place + OWN_PLACE] = 1
        row[place + OWN_NORTH + int(view.own.facing)] = 1
        show_item(int(view.own.holds), place, row)
        place = floor[view.other.cell]
        row[place + OTHER_PLACE] = 1
        row[place + OTHER_NORTH + int(view.other.facing)] = 1
        show_item(int(view.other.holds), place, row)
        for k in range(n_counters):
            item = 0
            for bit in range(n_planes):
                item |= (int(view.counters[bit]) >> k & 1) << bit
            show_item(item, counters[k], row)
        left = int(view.pots)
        for k in range(n_pots):
            place, soup, clock = pots[k], left & any_soup, left >> soup_bits & any_time
            left >>= soup_bits + time_bits
            if clock:
                row[place + ONIONS_IN_SOUP] = soup & 3
                row[place + TOMATOES_IN_SOUP] = soup >> 2
                row[place + TIME_LEFT] = clock - 1
                row[place + DONE] = clock == 1
            else:
                row[place + ONIONS_IN_POT] = soup & 3
                row[place + TOMATOES_IN_POT] = soup >> 2
        if view.urgent:
            for k in range(URGENT, size, COUNT):
                row[k] = 1

    return unpack
