"""The spec of Minesweeper: jumanji's board, and how it is drawn."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from gymnasium.spaces import Box, Discrete

from pearl_marl.checks import checked_integer
from pearl_marl.errors import ArgumentError
from pearl_marl.spec import EnvSpec, Peer

from .step import make_golden

SIZES, MINES = (2, 16), (1, 40)
COVER, GROUND, BLACK, CELL = (150, 150, 150), (238, 238, 228), (20, 20, 20), 24
"""Colours of a picture, and the width of a cell in pixels."""
INK = np.array([GROUND, (0, 0, 255), (0, 128, 0), (255, 0, 0), (128, 0, 128), *[(128, 0, 0)] * 4], np.uint8)
"""Of a cell's dots, by their number."""


def configure(num_rows: int = 10, num_cols: int = 10, num_mines: int = 10) -> EnvSpec:
    """Return the spec under the keyword arguments of jumanji's generator of boards.

    Parameters
    ----------
    num_rows, num_cols
        The rows and columns of the board, 2 to 16.
    num_mines
        How many cells have a mine, 1 to 40, and fewer than there are cells.
    """
    rows = checked_integer("num_rows", num_rows, *SIZES)
    columns = checked_integer("num_cols", num_cols, *SIZES)
    mines = checked_integer("num_mines", num_mines, *MINES)
    if mines >= rows * columns:
        raise ArgumentError(
            f"num_mines is {mines}; a board of {rows} x {columns} cells takes up to {rows * columns - 1}"
        )

    def unpack(view: Any, row: Any) -> None:
        """Write the board, -1 where a cell is unexplored."""
        for y in range(rows):
            ones, twos, fours, eights = view.numbers[y]
            for x in range(columns):
                number = (ones >> x & 1) + 2 * (twos >> x & 1) + 4 * (fours >> x & 1) + 8 * (eights >> x & 1)
                row[y * columns + x] = number if number <= 8 else -1

    def draw(state: Any) -> npt.NDArray[np.uint8]:
        """Draw explored cells with a dot for each mine around them, or black where they have a mine."""
        bits = np.arange(columns)
        mined, explored = (np.array(lines)[:, None] >> bits & 1 for lines in (state.mines, state.explored))
        around = np.pad(mined, 1)
        counts = sum(around[y : y + rows, x : x + columns] for y in range(3) for x in range(3)) - mined
        tiles = np.full((rows, columns, CELL, CELL, 3), COVER, np.uint8)
        tiles[explored == 1] = GROUND
        for dot in range(8):
            y, x = (5 + 5 * (dot // 3), 5 + 5 * (dot % 3))
            shown = (explored == 1) & (counts > dot)
            tiles[shown, y : y + 3, x : x + 3] = INK[counts[shown], None, None]
        tiles[(explored & mined) == 1] = BLACK
        tiles[:, :, 0] = tiles[:, :, :, 0] = 255
        return tiles.swapaxes(1, 2).reshape(rows * CELL, columns * CELL, 3)

    return EnvSpec(
        name="Minesweeper",
        version=0,
        summary="Explore every cell of a board that hides no mine",
        rewards=(0.0, 1.0),
        observation_space=Box(-1, 8, (rows, columns), np.int32),
        action_space=Discrete(rows * columns),
        golden=make_golden(rows, columns, mines),
        unpack=unpack,
        options={"num_rows": rows, "num_cols": columns, "num_mines": mines},
        configure=configure,
        peers={
            "EnvPool": Peer("Jumanji/Minesweeper-v0", actions=_cells),
            "jumanji": Peer(_jumanjis, actions=_cells),
        },
        draw=draw,
        follows="jumanji Minesweeper-v0",
        render_modes=("rgb_array",),
    )


def _jumanjis(spec: EnvSpec) -> Any:
    """Return jumanji's environment."""
    from jumanji.environments import Minesweeper
    from jumanji.environments.logic.minesweeper.generator import UniformSamplingGenerator

    return Minesweeper(UniformSamplingGenerator(**spec.options))


def _cells(spec: EnvSpec, actions: npt.NDArray[np.integer[Any]]) -> npt.NDArray[np.integer[Any]]:
    """Return the row and the column of each action."""
    return np.stack(np.divmod(actions, spec.options["num_cols"]), 1)


SPEC = configure()
