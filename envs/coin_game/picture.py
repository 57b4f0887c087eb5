"""Pictures of CoinGame: players are discs and coins are rings, in their colours."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from .step import SIZE

CELL = 64
"""Width and height of a cell, in pixels."""
GROUND, LINE = (250, 250, 250), (190, 190, 190)
RED_COLOUR, BLUE_COLOUR = (205, 45, 45), (40, 85, 200)


def draw(state: Any) -> npt.NDArray[np.uint8]:
    """Draw a state, row 0 at the bottom as in the package's pictures; it needs Pillow."""
    from PIL import Image, ImageDraw

    side = SIZE * CELL + 1
    image = Image.new("RGB", (side, side), GROUND)
    pen = ImageDraw.Draw(image)
    for at in range(0, side, CELL):
        pen.line((at, 0, at, side), LINE)
        pen.line((0, at, side, at), LINE)
    # Each has a corner of its cell to itself, since all four may be in one.
    for down, places in ((0.73, state.coins), (0.27, state.players)):
        for right, colour, place in zip((0.27, 0.73), (RED_COLOUR, BLUE_COLOUR), places, strict=True):
            row, column = place
            left, top = (column + right) * CELL, (SIZE - 1 - row + down) * CELL
            _disc(pen, left, top, CELL * 0.2, colour)
            if places is state.coins:
                _disc(pen, left, top, CELL * 0.11, GROUND)
    return np.asarray(image)


def _disc(pen: Any, left: float, top: float, radius: float, colour: tuple[int, int, int]) -> None:
    pen.ellipse((left - radius, top - radius, left + radius, top + radius), colour)
