"""The spec of Othello: two bitboards, pgx's planes of them, and how they are drawn."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from gymnasium.spaces import Box, Discrete

from pearl_marl.planes import interleave
from pearl_marl.spec import EnvSpec, Field, Golden

from .step import CELLS, SIDE, State, View, initial, masks, observe, step

GREEN, LINE, BLACK, WHITE, CELL = (40, 120, 60), (25, 80, 40), (15, 15, 15), (245, 245, 245), 32
"""Colours of a picture, and the width of a cell in pixels."""


def unpack(view: View, row: Any) -> None:
    """Write pgx's ``(8, 8, 2)`` of row, column and whose disc it is, into ``row``."""
    interleave(view.own, view.other, CELLS, row)


def draw(state: State) -> npt.NDArray[np.uint8]:
    """Draw the board; agent 0 has the black discs."""
    picture = np.full((SIDE, SIDE, CELL, CELL, 3), GREEN, np.uint8)
    distance = abs(np.arange(CELL) - CELL // 2)
    disc = np.add.outer(distance**2, distance**2) < (CELL // 2 - 4) ** 2
    for board, colour in zip(state.boards, (BLACK, WHITE), strict=True):
        for cell in range(CELLS):
            if board >> cell & 1:
                picture[cell // SIDE, cell % SIDE, disc] = colour
    picture[:, :, 0] = picture[:, :, :, 0] = LINE
    return picture.swapaxes(1, 2).reshape(SIDE * CELL, SIDE * CELL, 3)


def configure() -> EnvSpec:
    """Return the spec; there are no options."""
    return EnvSpec(
        name="Othello",
        version=0,
        summary="Two players place discs that turn the other's, and the one with more wins",
        reward=Field("reward", 2, signed=True),
        rewards=None,
        observation_space=Box(0, 1, (SIDE, SIDE, 2), np.bool_),
        action_space=Discrete(CELLS + 1),
        golden=Golden(State, initial, step, observe, masks, view=View),
        agents=2,
        turns=True,
        masked="refused",
        unpack=unpack,
        configure=configure,
        peers={"EnvPool": "Othello-v1", "pgx": "othello"},
        draw=draw,
        follows="pgx othello",
        render_modes=("rgb_array",),
    )


SPEC = configure()
