"""Where pursuers and evaders of Pursuit start: anywhere, but none beside another of its kind."""

from __future__ import annotations

from pearl_marl.envs.free_cells import CellWords, count_of
from pearl_marl.golden import Draws, Word

from .rules import PursuitRules


def scattered(rules: PursuitRules, draws: Draws, count: int) -> list[tuple[Word, Word]]:
    """Return places outside the building, each as likely as any that the ones before leave free."""
    right, bottom = rules.x_size - 1, rules.y_size - 1
    grid, places = CellWords(max(rules.x_size, rules.y_size) + 2), []

    def is_open(word: int, bit: int) -> bool:
        x, y = grid.word_rows * word + bit // grid.row_bits, bit % grid.row_bits - 1
        return x <= right and 0 <= y <= bottom and not rules.blocked(x, y)

    # A row of the grid is a column of the map, whose cells have the same x.
    free: list[Word] = [sum(1 << bit for bit in range(64) if is_open(k, bit)) for k in range(grid.words)]
    for _ in range(count):
        counts = [count_of(word) for word in free]
        row, column = grid.chosen(free, counts, draws.below(sum(counts)))
        places.append((min(row - 1, right), min(max(column - 1, 0), bottom)))
        free = grid.far_from(free, row, column, 1)
    return places
