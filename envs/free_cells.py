"""The cells of a grid that are free, while things are put there one by one: bits of a few long words.

Rows and columns at the edges are never free. Of the rows from 1 on, a word of 64 bits holds as many as fit,
one above the other; within a row, a column's number is that of its bit. So a few operations count many cells,
and the grid of 32 rows has 15 words.
"""

from collections.abc import Sequence
from typing import NamedTuple

from pearl_marl.golden import Word

HALVES = 0x5555555555555555, 0x3333333333333333
"""The lower half of each 2 and 4 bits of a word."""
BYTES = 0x0F0F0F0F0F0F0F0F


class CellWords(NamedTuple):
    """How the cells of a grid lie in words."""

    size: int

    @property
    def row_bits(self) -> int:
        """The bits of a row: a power of two, and enough for the columns before the last."""
        return 1 << (self.size - 2).bit_length()

    @property
    def word_rows(self) -> int:
        """The rows of a word."""
        return 64 // self.row_bits

    @property
    def words(self) -> int:
        """How many words there are."""
        return -(-self.row_bits * (self.size - 2) // 64)

    @property
    def columns(self) -> int:
        """The bits of a row that are not at an edge."""
        return (1 << self.size - 1) - 2

    def all_free(self) -> list[Word]:
        """Return the words of an empty grid."""
        rows = [self.columns << self.row_bits * row for row in range(self.size - 2)]
        whole = sum(rows)
        return [whole >> 64 * k & (1 << 64) - 1 for k in range(self.words)]

    def without(self, free: Sequence[Word], row: Word, column: Word) -> list[Word]:
        """Return the cells without one, which may be at an edge."""
        place = self.row_bits * (row - 1) + column
        bit = 1 << (place & 63)
        return [word ^ (word & bit) if place >> 6 == k else word for k, word in enumerate(free)]

    def far_from(self, free: Sequence[Word], row: Word, column: Word, reach: int) -> list[Word]:
        """Return the cells that are more than so many steps away from a cell that is not at an edge."""
        by_distance = [
            ((1 << 2 * side + 1) - 1 << column >> side) & self.columns for side in range(reach, -1, -1)
        ]
        # What is near a cell in row r of a word, or in a row so many above it.
        near = [0] * (self.word_rows + 2 * reach)
        for r in range(-reach, self.word_rows + reach):
            for other in range(max(0, r - reach), min(self.word_rows, r + reach + 1)):
                near[r + reach] |= by_distance[abs(r - other)] << self.row_bits * other
        result = []
        for k, word in enumerate(free):
            taken = 0
            for r, cells in enumerate(near, -reach):
                if row == 1 + self.word_rows * k + r:
                    taken = cells
            result.append(word ^ (word & taken))
        return result

    def chosen(self, free: Sequence[Word], counts: Sequence[Word], rank: Word) -> tuple[Word, Word]:
        """Return row and column of the free cell of a rank, from the top left: of as many as are counted."""
        before, start, first, word = 0, 0, 1, free[0]
        for k, count in enumerate(counts[:-1]):
            before += count
            if before <= rank:
                start, first, word = before, self.word_rows * (k + 1) + 1, free[k + 1]
        place, within = 0, rank - start
        # In the lower half of the word or in the upper one, and so on down to a bit.
        levels = [word, *halves(word)[:-1]]
        while levels:
            *rest, several = levels
            half = 1 << len(rest)
            count = several & min(2 * half - 1, 127)
            if within >= count:
                place, within, rest = place + half, within - count, [level >> half for level in rest]
            levels = rest
        return min(first + place // self.row_bits, self.size - 2), place % self.row_bits


def count_of(word: Word) -> Word:
    """Return how many ones a word has."""
    return halves(word)[-1] & 127


def halves(word: Word) -> list[Word]:
    """Return how many ones there are in each 2, 4, 8, 16, 32 and 64 bits, side by side in a word each.

    Of 16 bits and more, each count is in the lowest 8 of them; there is something else above it.
    """
    result = []
    for level, kept in enumerate(HALVES):
        word = (word & kept) + (word >> (1 << level) & kept)
        result.append(word)
    for width in (4, 8, 16, 32):
        word += word >> width
        if width == 4:
            word &= BYTES
        result.append(word)
    return result
