"""The spec of Game2048: its boards, and how they are drawn."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from gymnasium.spaces import Box, Discrete

from pearl_marl.checks import checked_integer
from pearl_marl.spec import EnvSpec, Field

from .step import greatest, make_golden

SIZES = (2, 4)
EMPTY, LIGHT, DARK, CELL = (205, 193, 180), (238, 228, 218), (160, 40, 20), 48
"""Colours of a picture, from the least tile to the greatest, and the width of a cell in pixels."""


def configure(board_size: int = 4) -> EnvSpec:
    """Return the spec under jumanji's keyword arguments.

    Parameters
    ----------
    board_size
        The rows and columns of the board, 2 to 4.
    """
    size = checked_integer("board_size", board_size, *SIZES)
    most = greatest(size)

    def unpack(state: Any, row: Any) -> None:
        """Write the exponents of the tiles."""
        for k in range(size):
            for j in range(size):
                row[k * size + j] = state.board[k][j]

    def draw(state: Any) -> npt.NDArray[np.uint8]:
        """Draw the board: the greater a tile, the darker."""
        board = np.array(state.board)
        picture = LIGHT + (np.array(DARK) - LIGHT) * ((board - 1) / (most - 1))[..., None]
        picture[board == 0] = EMPTY
        cells = picture.round().astype(np.uint8).repeat(CELL, 0).repeat(CELL, 1)
        cells[::CELL] = cells[:, ::CELL] = 255
        return cells

    return EnvSpec(
        name="Game2048",
        version=0,
        summary="Slide tiles over a board, and merge those that are equal",
        rewards=None,
        # At most half of the cells merge, each into the greatest tile.
        reward=Field("reward", most + (size * size // 2).bit_length()),
        observation_space=Box(0, most, (size, size), np.int32),
        action_space=Discrete(4),
        golden=make_golden(size),
        unpack=unpack,
        options={"board_size": size},
        configure=configure,
        peers={"EnvPool": "Jumanji/Game2048-v1", "jumanji": "jumanji.environments:Game2048"},
        draw=draw,
        follows="jumanji Game2048-v1",
        render_modes=("rgb_array",),
    )


SPEC = configure()
