"""The warehouse that options come to: where racks, highways and goals are, and how cells are numbered."""

from __future__ import annotations

from typing import NamedTuple

from pearl_marl.golden import Word

SIZES = {"tiny": (1, 3), "small": (2, 3), "medium": (2, 5), "large": (3, 5)}
"""Rows and columns of blocks of racks, by the package's names."""


class WarehouseRules(NamedTuple):
    """What the options come to.

    A cell's number is ``y * stride + x``. A stride is as much longer than a row as robots see to the side, so
    that beyond an edge there are numbers that no cell has, and what is near is near by its number too.
    """

    shelf_rows: int
    shelf_columns: int
    column_height: int
    robots: int
    requests: int
    sight: int
    reward: str

    @property
    def width(self) -> int:
        """Columns of the grid."""
        return 3 * self.shelf_columns + 1

    @property
    def height(self) -> int:
        """Rows of the grid."""
        return (self.column_height + 1) * self.shelf_rows + 2

    @property
    def stride(self) -> int:
        """How much greater a cell's number is than that of the cell above."""
        return self.width + self.sight

    @property
    def cell_bits(self) -> int:
        """The width of a cell's number."""
        return self.cell(self.width - 1, self.height - 1).bit_length()  # type: ignore[no-any-return]

    @property
    def goals(self) -> tuple[Word, Word]:
        """The cells of the two goals, in the middle of the lowest row."""
        middle = self.cell(self.width // 2, self.height - 1)
        return middle - 1, middle

    @property
    def rack_columns(self) -> tuple[tuple[int, ...], tuple[int, ...]]:
        """The columns of racks: in upper rows, and in the lowest, where robots queue in the middle."""
        every = tuple(x for x in range(self.width) if x % 3)
        middle = self.width // 2
        return every, tuple(x for x in every if x not in (middle - 1, middle))

    @property
    def rack_rows(self) -> tuple[tuple[int, ...], tuple[int, ...]]:
        """The rows of racks: those of all blocks of rows but the lowest, and those of that."""
        rows = [y for y in range(self.height - 2) if y % (self.column_height + 1)]
        return tuple(rows[: -self.column_height]), tuple(rows[-self.column_height :])

    @property
    def racks(self) -> list[int]:
        """The cells of racks, from the top left to the bottom right; each holds a shelf at the start."""
        blocks = zip(self.rack_columns, self.rack_rows, strict=True)
        return [self.cell(x, y) for columns, rows in blocks for y in rows for x in columns]

    @property
    def two_stage(self) -> bool:
        """Whether half of a reward is for putting a shelf down again that was brought."""
        return self.reward == "two_stage"

    def cell(self, x: Word, y: Word) -> Word:
        """Return the number of a cell."""
        return y * self.stride + x
