"""Pictures of the warehouse: shelves are violet, those asked for teal, robots orange and with a shelf red.

A white line shows where a robot faces. The package's own renderer needs a screen with OpenGL.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

from .moves import AHEAD
from .rules import WarehouseRules
from .step import NONE

CELL = 32
"""Width and height of a cell, in pixels."""
GROUND, LINE, FACING = (255, 255, 255), (200, 200, 200), (255, 255, 255)
GOAL, SHELF, ASKED = (60, 60, 60), (110, 90, 200), (0, 150, 140)
ROBOT, LOADED = (240, 150, 0), (200, 40, 40)


def make_draw(rules: WarehouseRules) -> Callable[[Any], npt.NDArray[np.uint8]]:
    """Return what draws a state; it needs Pillow."""

    def draw(state: Any) -> npt.NDArray[np.uint8]:
        from PIL import Image, ImageDraw

        robots, requests = state
        image = Image.new("RGB", (rules.width * CELL + 1, rules.height * CELL + 1), GROUND)
        pen = ImageDraw.Draw(image)

        def box(cell: int, margin: int) -> tuple[int, int, int, int]:
            left, top = cell % rules.stride * CELL + margin, cell // rules.stride * CELL + margin
            return left, top, left + CELL - 2 * margin, top + CELL - 2 * margin

        for at in range(0, image.width, CELL):
            pen.line((at, 0, at, image.height), LINE)
        for at in range(0, image.height, CELL):
            pen.line((0, at, image.width, at), LINE)
        for goal in rules.goals:
            pen.rectangle(box(goal, 1), GOAL)
        empty = {robot.origin for robot in robots}
        carried = {rules.cell(robot.x, robot.y) for robot in robots if robot.origin != NONE}
        for cell in (set(rules.racks) - empty) | carried:
            pen.rectangle(box(cell, 3), ASKED if cell in requests else SHELF)
        for robot in robots:
            left, top, right, bottom = box(rules.cell(robot.x, robot.y), 8)
            pen.ellipse((left, top, right, bottom), ROBOT if robot.origin == NONE else LOADED)
            middle, (x, y) = ((left + right) // 2, (top + bottom) // 2), AHEAD[robot.direction]
            pen.line((*middle, middle[0] + x * 8, middle[1] + y * 8), FACING, 2)
        return np.asarray(image)

    return draw
