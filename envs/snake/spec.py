"""The spec of Snake: jumanji's planes of it, and how it is drawn."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from gymnasium.spaces import Box, Discrete

from pearl_marl.checks import checked_integer
from pearl_marl.spec import EnvSpec

from .presets import PRESETS
from .step import MOVES, make_golden, move_of

SIZES = (2, 16)
BODY, HEAD, TAIL, FRUIT, ORDER, CHANNELS = range(6)
GROUND, LIGHT, DARK, RED, CELL = (238, 238, 228), (170, 215, 120), (35, 95, 40), (205, 45, 45), 24
"""Colours of a picture, the snake's from its tail to its head, and the width of a cell in pixels."""


def configure(num_rows: int = 12, num_cols: int = 12) -> EnvSpec:
    """Return the spec under jumanji's keyword arguments.

    Parameters
    ----------
    num_rows, num_cols
        The rows and columns of the grid, 2 to 16.
    """
    rows = checked_integer("num_rows", num_rows, *SIZES)
    columns = checked_integer("num_cols", num_cols, *SIZES)

    def unpack(state: Any, row: Any) -> None:
        """Write jumanji's ``(rows, columns, 5)``: body, head, tail, fruit, and the order of the body."""
        for k in range(rows * columns * CHANNELS):
            row[k] = 0
        y, x = state.head.row, state.head.column
        row[(columns * y + x) * CHANNELS + HEAD] = 1
        row[(columns * state.tail.row + state.tail.column) * CHANNELS + TAIL] = 1
        row[(columns * state.fruit.row + state.fruit.column) * CHANNELS + FRUIT] = 1
        for k in range(rows * columns):
            row[k * CHANNELS + BODY] = state.body[k // columns] >> k % columns & 1
        for k in range(state.length):
            row[(columns * y + x) * CHANNELS + ORDER] = (state.length - k) / state.length
            move = move_of(state.moves, k)
            y = min(max(y - (move == 2) + (move == 0), 0), rows - 1)
            x = min(max(x - (move == 1) + (move == 3), 0), columns - 1)

    def draw(state: Any) -> npt.NDArray[np.uint8]:
        """Draw the snake, the darker the nearer its head, and the fruit in red."""
        picture = np.full((rows, columns, 3), GROUND, np.uint8)
        picture[tuple(state.fruit)] = RED
        row, column = state.head
        for k in range(state.length):
            share = k / state.length
            picture[row, column] = (1 - share) * np.array(DARK) + share * np.array(LIGHT)
            if k + 1 < state.length:
                down, right = MOVES[move_of(state.moves, k)]
                row, column = row - down, column - right
        return picture.repeat(CELL, 0).repeat(CELL, 1)

    return EnvSpec(
        name="Snake",
        version=0,
        summary="Eat fruit, grow longer with each, and run into nothing",
        rewards=(0.0, 1.0),
        observation_space=Box(0, 1, (rows, columns, CHANNELS), np.float32),
        action_space=Discrete(4),
        golden=make_golden(rows, columns),
        unpack=unpack,
        max_cycles=4000,
        options={"num_rows": rows, "num_cols": columns},
        configure=configure,
        peers={"EnvPool": "Jumanji/Snake-v1", "jumanji": "jumanji.environments:Snake"},
        presets=PRESETS,
        draw=draw,
        follows="jumanji Snake-v1",
        render_modes=("rgb_array",),
    )


SPEC = configure()
