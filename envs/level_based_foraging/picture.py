"""Pictures of Level-Based Foraging: players are blue, food is red, and each has its level written on it.

The package's own renderer needs a screen with OpenGL.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

CELL = 32
"""Width and height of a cell, in pixels."""
GROUND, LINE, WRITING = (255, 255, 255), (200, 200, 200), (255, 255, 255)
PLAYER, FOOD = (40, 90, 190), (200, 40, 40)


def make_draw(size: int) -> Callable[[Any], npt.NDArray[np.uint8]]:
    """Return what draws a state of a grid with so many rows; it needs Pillow."""

    def draw(state: Any) -> npt.NDArray[np.uint8]:
        from PIL import Image, ImageDraw, ImageFont

        side = size * CELL + 1
        image = Image.new("RGB", (side, side), GROUND)
        pen, font = ImageDraw.Draw(image), ImageFont.load_default(CELL // 2)
        for at in range(0, side, CELL):
            pen.line((at, 0, at, side), LINE)
            pen.line((0, at, side, at), LINE)
        players, foods, _ = state
        for row, column, level in foods:
            if level:
                box = _inside(row, column, 4)
                pen.rounded_rectangle(box, CELL // 4, FOOD)
                _write(pen, box, level, font)
        # Two players can be in one cell: later ones are drawn smaller, within the others.
        for k, (row, column, level) in enumerate(players):
            below = sum(player[:2] == (row, column) for player in players[:k])
            box = _inside(row, column, min(2 + 5 * below, CELL // 3))
            pen.ellipse(box, PLAYER, WRITING)
            _write(pen, box, level, font)
        return np.asarray(image)

    return draw


def _inside(row: int, column: int, margin: int) -> tuple[int, int, int, int]:
    """Return the box of a cell, without a margin."""
    left, top = column * CELL + margin, row * CELL + margin
    return left, top, left + CELL - 2 * margin, top + CELL - 2 * margin


def _write(pen: Any, box: tuple[int, int, int, int], level: int, font: Any) -> None:
    """Write a level into the middle of a box."""
    left, top, right, bottom = box
    pen.text(((left + right) / 2, (top + bottom) / 2), str(level), WRITING, font, anchor="mm")
