"""Pictures of Overcooked: cooks are blue and green, with a black nose on the side that they face."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

from .kitchen import DIRECTIONS, Cell, Kitchen

SIZE = 48
"""Width and height of a cell, in pixels."""
FLOOR, LINE, WHITE, NOSE = (236, 222, 198), (205, 190, 165), (255, 255, 255), (25, 25, 25)
COOKS = (40, 90, 190), (50, 150, 70)
ONION, TOMATO, DISH, POT = (222, 180, 60), (205, 50, 40), (245, 245, 245), (70, 70, 75)
COUNTER, BOX, SERVING = (160, 120, 80), (120, 90, 60), (110, 170, 110)
GROUND = {"X": COUNTER, "P": COUNTER, "O": BOX, "T": BOX, "D": BOX, "S": SERVING}


def make_draw(kitchen: Kitchen) -> Callable[[Any], npt.NDArray[np.uint8]]:
    """Return what draws a state; it needs Pillow."""

    def draw(state: Any) -> npt.NDArray[np.uint8]:
        from PIL import Image, ImageDraw, ImageFont

        image = Image.new("RGB", (kitchen.width * SIZE, kitchen.height * SIZE), FLOOR)
        pen, font = ImageDraw.Draw(image), ImageFont.load_default(SIZE // 3)

        def item(kind: int, middle: tuple[float, float]) -> None:
            """Draw what a cook holds or what lies on a counter."""
            if kind in (kitchen.onion, kitchen.tomato, kitchen.dish):
                colour = {kitchen.onion: ONION, kitchen.tomato: TOMATO, kitchen.dish: DISH}[kind]
                _disc(pen, middle, SIZE // 6, colour)
            elif kind:
                _disc(pen, middle, SIZE // 5, DISH)
                _soup(pen, middle, kind)

        for x in range(kitchen.width):
            for y in range(kitchen.height):
                box = x * SIZE, y * SIZE, (x + 1) * SIZE - 1, (y + 1) * SIZE - 1
                kind = kitchen.at((x, y))
                pen.rectangle(box, GROUND.get(kind, FLOOR), LINE)
                if kind in "OTD":
                    for right, down in (0, -8), (-8, 5), (8, 5):
                        colour = {"O": ONION, "T": TOMATO, "D": DISH}[kind]
                        left, top = _middle((x, y))
                        _disc(pen, (left + right, top + down), SIZE // 6, colour)
        for k, cell in enumerate(kitchen.counters):
            item(sum((plane >> k & 1) << bit for bit, plane in enumerate(state.counters)), _middle(cell))
        for cell in kitchen.cells("P"):
            _disc(pen, _middle(cell), SIZE * 0.42, POT)
        for cell, (soup, clock) in zip(kitchen.pots, state.pots, strict=True):
            _soup(pen, _middle(cell), soup)
            if clock:
                left, top = _middle(cell)
                text = "done" if clock == 1 else str(clock - 1)
                pen.text((left, top + SIZE * 0.26), text, WHITE, font, anchor="mm")
        for colour, (number, facing, holds) in zip(COOKS, state.cooks, strict=True):
            left, top = _middle(kitchen.floor[number])
            right, down = DIRECTIONS[facing]
            _disc(pen, (left, top), SIZE * 0.38, colour)
            _disc(pen, (left + right * SIZE * 0.32, top + down * SIZE * 0.32), SIZE / 9, NOSE)
            item(holds, (left + right * SIZE * 0.12, top + down * SIZE * 0.12))
        return np.asarray(image)

    return draw


def _middle(cell: Cell) -> tuple[float, float]:
    """Return the middle of a cell."""
    return (cell[0] + 0.5) * SIZE, (cell[1] + 0.5) * SIZE


def _disc(pen: Any, middle: tuple[float, float], radius: float, colour: tuple[int, int, int]) -> None:
    left, top = middle
    pen.ellipse((left - radius, top - radius, left + radius, top + radius), colour, LINE)


def _soup(pen: Any, middle: tuple[float, float], soup: int) -> None:
    """Draw the ingredients of a soup, from left to right."""
    left, top = middle
    colours = [ONION] * (soup & 3) + [TOMATO] * (soup >> 2)
    for k, colour in enumerate(colours):
        _disc(pen, (left + (k - (len(colours) - 1) / 2) * SIZE / 6, top - SIZE / 12), SIZE / 12, colour)
