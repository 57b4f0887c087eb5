"""The spec of Catch: its boards, and bsuite's observations of them."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from gymnasium.spaces import Box, Discrete

from pearl_marl.checks import checked_integer
from pearl_marl.spec import EnvSpec, Peer

from .step import make_golden

ROWS, COLUMNS, MOST = 10, 5, 64
BALL, PADDLE, CELL = (205, 45, 45), (40, 85, 200), 24
"""Colours of a picture, and the width of a cell in pixels."""


def configure(rows: int = ROWS, columns: int = COLUMNS) -> EnvSpec:
    """Return the spec under bsuite's keyword arguments.

    Parameters
    ----------
    rows
        The rows of the board, 2 to 64: a ball falls for one step fewer.
    columns
        The columns of the board, 2 to 64.
    """
    rows = checked_integer("rows", rows, 2, MOST)
    columns = checked_integer("columns", columns, 2, MOST)

    def unpack(state: Any, row: Any) -> None:
        """Write a board with ones where ball and paddle are."""
        for cell in range(rows * columns):
            row[cell] = 0
        row[state.ball_y * columns + state.ball_x] = 1
        row[(rows - 1) * columns + state.paddle_x] = 1

    def draw(state: Any) -> npt.NDArray[np.uint8]:
        """Draw the board; the ball is red, the paddle blue."""
        picture = np.full((rows, columns, 3), 255, np.uint8)
        picture[rows - 1, state.paddle_x] = PADDLE
        picture[state.ball_y, state.ball_x] = BALL
        return picture.repeat(CELL, 0).repeat(CELL, 1)

    return EnvSpec(
        name="Catch",
        version=0,
        summary="Move a paddle under a ball that falls",
        rewards=(0.0, 1.0, -1.0),
        observation_space=Box(0, 1, (rows, columns), np.float32),
        action_space=Discrete(3),
        golden=make_golden(rows, columns),
        unpack=unpack,
        options={"rows": rows, "columns": columns},
        configure=configure,
        peers={
            "EnvPool": "Catch-v0",
            "gymnax": Peer("Catch-bsuite", options=("rows", "columns")),
            "bsuite": "bsuite.environments.catch:Catch",
        },
        draw=draw,
        follows="bsuite catch",
        render_modes=("rgb_array",),
    )


SPEC = configure()
