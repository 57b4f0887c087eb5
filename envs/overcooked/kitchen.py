"""Kitchens of Overcooked: the package's layouts, and what a golden step has to know about them.

In a grid ``X`` is a counter, ``O`` a box of onions, ``T`` a box of tomatoes, ``D`` a stack of dishes, ``P``
a pot and ``S`` a place to serve soup. ``1`` and ``2`` are the cooks, who walk on the blanks. A recipe has a
letter for each ingredient: ``oot`` has two onions and a tomato.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TypeAlias

Cell: TypeAlias = tuple[int, int]
"""Column and row."""

DIRECTIONS = (0, -1), (0, 1), (1, 0), (-1, 0)
"""North, south, east and west, as the package numbers them."""
STATIONS = "OTDS"
"""What a cook can use but not change."""
PRICE, TIME = 20, 20
"""What a soup is worth, and how long it cooks, where a layout does not say."""
MOST = 3
"""Ingredients that a pot holds."""
MORE = {"o": 1, "t": 4}
"""What an ingredient adds to a soup's number: soup ``n`` has ``n % 4`` onions and ``n // 4`` tomatoes."""


@dataclass(frozen=True)
class Kitchen:
    """A layout, and what follows from it."""

    rows: tuple[str, ...]
    orders: tuple[str, ...] = ("ooo",)
    """The soups that somebody pays for."""
    bonus: tuple[str, ...] = ()
    """Those that pay double."""
    recipes: Mapping[str, tuple[int, int]] = field(default_factory=dict)
    """Price and cooking time of single soups."""
    ingredients: Mapping[str, tuple[int, int]] = field(default_factory=dict)
    """What each ingredient adds to price and cooking time of the other soups."""
    cook_time: int | None = None
    """The cooking time of all soups, if it is not the layout's."""

    @property
    def width(self) -> int:
        """How many columns there are."""
        return len(self.rows[0])

    @property
    def height(self) -> int:
        """How many rows there are."""
        return len(self.rows)

    def at(self, cell: Cell) -> str:
        """Return what is in a cell."""
        return self.rows[cell[1]][cell[0]]

    def cells(self, kinds: str) -> list[Cell]:
        """Return the cells of some kinds, row by row."""
        every = ((x, y) for y in range(self.height) for x in range(self.width))
        return [cell for cell in every if self.at(cell) in kinds]

    @cached_property
    def floor(self) -> list[Cell]:
        """The cells that a cook can walk to, row by row."""
        left = self.cells("12")
        seen = set(left)
        while left:
            x, y = left.pop()
            near = {(x + right, y + down) for right, down in DIRECTIONS}
            new = [cell for cell in near - seen if self.at(cell) in " 12"]
            seen.update(new)
            left += new
        return [cell for cell in self.cells(" 12") if cell in seen]

    @cached_property
    def starts(self) -> list[int]:
        """Where the cooks start, as numbers of the floor's cells."""
        return [self.floor.index(self.cells(player)[0]) for player in "12"]

    def _in_reach(self, kind: str) -> list[Cell]:
        near = {(x + right, y + down) for x, y in self.floor for right, down in DIRECTIONS}
        return [cell for cell in self.cells(kind) if cell in near]

    @cached_property
    def counters(self) -> list[Cell]:
        """The counters within reach; nothing ever lies on the others."""
        return self._in_reach("X")

    @cached_property
    def pots(self) -> list[Cell]:
        """The pots within reach."""
        return self._in_reach("P")

    @cached_property
    def things(self) -> list[int]:
        """What a cook faces, at ``4 * cell + direction``: counters, pots, stations, cells of the floor.

        They are numbered in this order. The list has an entry for each number that the bits of a cell can
        hold.
        """
        pots = len(self.counters)
        stations = pots + len(self.pots)
        floor = self.first_floor
        result = [floor] * (4 << self.cell_bits)
        for k, (x, y) in enumerate(self.floor):
            for direction, (right, down) in enumerate(DIRECTIONS):
                cell = x + right, y + down
                kind = self.at(cell)
                if kind == "X":
                    thing = self.counters.index(cell)
                elif kind == "P":
                    thing = pots + self.pots.index(cell)
                elif kind in STATIONS:
                    thing = stations + STATIONS.index(kind)
                else:
                    thing = floor + self.floor.index(cell)
                result[4 * k + direction] = thing
        return result

    @property
    def first_floor(self) -> int:
        """The number of the floor's first cell among all things."""
        return len(self.counters) + len(self.pots) + len(STATIONS)

    @property
    def cell_bits(self) -> int:
        """How many bits the number of a cell of the floor takes."""
        return (len(self.floor) - 1).bit_length()

    @property
    def has_tomatoes(self) -> bool:
        """Whether there are any."""
        return bool(self.cells("T"))

    @property
    def soup_bits(self) -> int:
        """How many bits the number of a soup takes."""
        return 4 if self.has_tomatoes else 2

    @property
    def item_bits(self) -> int:
        """How many bits an item takes: 0 is none, a soup is its number, the others are numbers of no soup."""
        return 4 if self.has_tomatoes else 3

    @property
    def onion(self) -> int:
        """The item that is an onion."""
        return 7 if self.has_tomatoes else 4

    @property
    def dish(self) -> int:
        """The item that is a dish."""
        return 10 if self.has_tomatoes else 5

    @property
    def tomato(self) -> int:
        """The item that is a tomato; none where there are none."""
        return 11 if self.has_tomatoes else -1

    @cached_property
    def soups(self) -> dict[int, str]:
        """The recipe of each soup that the kitchen can cook, by its number."""
        counts = [(o, t) for t in range(MOST + 1) for o in range(MOST + 1 - t)]
        recipes = {o + 4 * t: "o" * o + "t" * t for o, t in counts}
        return {soup: recipe for soup, recipe in recipes.items() if 0 < soup < 1 << self.soup_bits}

    def price(self, recipe: str) -> int:
        """Return what is paid for a soup."""
        if recipe not in self.orders:
            return 0
        return self._of(recipe, 0, PRICE) * (2 if recipe in self.bonus else 1)

    def time(self, recipe: str) -> int:
        """Return how long a soup cooks."""
        return self.cook_time or self._of(recipe, 1, TIME)

    def _of(self, recipe: str, which: int, usual: int) -> int:
        if recipe in self.recipes:
            return self.recipes[recipe][which]
        return sum(self.ingredients[one][which] for one in recipe) if self.ingredients else usual

    @cached_property
    def times(self) -> list[int]:
        """How long each soup cooks, by its number; 0 for what is no soup."""
        return [self.time(self.soups[k]) if k in self.soups else 0 for k in range(1 << self.soup_bits)]

    @cached_property
    def prices(self) -> list[int]:
        """All prices, 0 among them, the lowest first."""
        return sorted({0, *(self.price(recipe) for recipe in self.soups.values())})

    @cached_property
    def classes(self) -> list[int]:
        """The place of each item's price among the prices."""
        prices = [self.price(self.soups[k]) if k in self.soups else 0 for k in range(1 << self.item_bits)]
        return [self.prices.index(price) for price in prices]

    def cooking(self, time: int) -> Kitchen:
        """Return the kitchen with another cooking time."""
        return replace(self, cook_time=time)


DEAR = {"o": (21, 15), "t": (13, 7)}

LAYOUTS = {
    "cramped_room": Kitchen(("XXPXX", "O  2O", "X1  X", "XDXSX")),
    "asymmetric_advantages": Kitchen(("XXXXXXXXX", "O XSXOX S", "X   P 1 X", "X2  P   X", "XXXDXDXXX")),
    "coordination_ring": Kitchen(("XXXPX", "X 1 P", "D2X X", "O   X", "XOSXX")),
    "forced_coordination": Kitchen(("XXXPX", "O X1P", "O2X X", "D X X", "XXXSX")),
    "counter_circuit_o_1order": Kitchen(("XXXPPXXX", "X  2   X", "D XXXX S", "X  1   X", "XXXOOXXX")),
    "counter_circuit": Kitchen(
        ("XXXPDPXXX", "X   2   X", "X XXXXX X", "X   1   X", "XXXOSTXXX"),
        orders=("ott", "oot", "ot"),
        bonus=("ot",),
        ingredients=DEAR,
    ),
    "asymmetric_advantages_tomato": Kitchen(
        ("XTXXXXXOX", "D XOXTX S", "X   P 1 X", "X2  X   X", "XXXSXDXXX"),
        orders=("ooo", "oot", "ttt", "t"),
        bonus=("ttt", "oot"),
        ingredients=DEAR,
    ),
    "cramped_room_o_3orders": Kitchen(
        ("XXPXX", "O  2X", "X1  X", "XDXSX"),
        orders=("ooo", "oo", "o"),
        recipes={"ooo": (20, 20), "oo": (9, 20), "o": (4, 20)},
    ),
    "cramped_room_tomato": Kitchen(
        ("XXPXX", "O  2T", "X1  X", "XDXSX"),
        orders=("ooo", "ttt", "ot"),
        bonus=("ot",),
        ingredients={"o": (15, 10), "t": (10, 10)},
    ),
    "forced_coordination_tomato": Kitchen(
        ("XXXPX", "T X1P", "O2X X", "S X X", "XXXDX"),
        orders=("ooo", "ott", "oot", "ttt"),
        recipes={"ooo": (10, 10), "ott": (10, 10), "oot": (10, 10), "ttt": (15, 10)},
    ),
    "bottleneck": Kitchen(("XXOXDXX", "X 1X2 X", "X  X  X", "X     X", "XSXXPPX")),
    "centre_pots": Kitchen(("XXXOSSX", "X  1  X", "X P P X", "X  2  X", "XDDOXXX")),
    "five_by_five": Kitchen(("XDPXX", "X   S", "O 2 X", "X1  D", "XOXPX")),
    "large_room": Kitchen(("XXXPXXX", "O    2O", "X     X", "X     X", "X     X", "X1    X", "XDXXXSX")),
    "schelling": Kitchen(("XXSPDXX", "X  1  X", "X  X  X", "O     O", "X  X  X", "X  2  X", "XXDPSXX")),
    "simple_o": Kitchen(("XXPXX", "X  2X", "X1  O", "XXDSX"), recipes={"ooo": (20, 5)}),
    "soup_coordination": Kitchen(
        ("XXXDTXOXXXX", "X    X    X", "S 2  P  1 S", "X    X    X", "XXXXOXTDXXX"),
        orders=("oot", "ttt", "ot", "t", "o"),
        bonus=("t", "oot", "ttt", "o"),
        ingredients=DEAR,
    ),
}
"""The package's layouts of these names."""
