"""What MiniGrid's environments have in common: a grid of painted boxes, an agent in it, and what it sees.

A grid is a list of boxes of cells, painted one after the other upon a world that is all wall, as MiniGrid
builds its grids. So a state need not hold cells: it has what was drawn for the grid, and what can change.
Both what is ahead of the agent and what it sees come of the boxes.

Follows https://github.com/Farama-Foundation/Minigrid (``minigrid`` 3.0.0): M. Chevalier-Boisvert et al.,
*Minigrid & Miniworld: Modular & Customizable Reinforcement Learning Environments for Goal-Oriented Tasks*,
2023.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

from pearl_marl.golden import Word
from pearl_marl.layout import Array, Bits, Range

LEFT, RIGHT, FORWARD, PICKUP, DROP, TOGGLE, DONE = range(7)
"""MiniGrid's actions; an eighth, which three bits can hold, does nothing either."""
UNSEEN, EMPTY, WALL, GOAL = range(4)
"""Codes of cells. Those from 4 on are an environment's own."""
SIGHT = 7
"""Rows and columns that an agent sees: its own row is the last of them, its own column the middle one."""
AHEAD, ASIDE = SIGHT - 1, SIGHT // 2


class Thing(NamedTuple):
    """What stands in a cell, in MiniGrid's numbers."""

    kind: int
    colour: int = 0
    state: int = 0


RED, GREEN, BLUE, PURPLE, YELLOW, GREY = range(6)
DOOR, KEY, BALL, LAVA = 4, 5, 6, 9
"""Kinds of things."""
THINGS = (Thing(0), Thing(1), Thing(2, GREY), Thing(8, GREEN))
"""Those of the common codes."""


class Box(NamedTuple):
    """Cells from a corner to the opposite one, both included, and the code that all of them have."""

    left: Word
    top: Word
    right: Word
    bottom: Word
    code: Word


def cell(x: Word, y: Word, code: Word) -> Box:
    """Return the box of one cell."""
    return Box(x, y, x, y, code)


class Rules(NamedTuple):
    """Columns and rows of a grid with its outer walls, and the time limit."""

    width: int
    height: int
    max_steps: int

    @property
    def floor(self) -> Box:
        """The empty cells within the outer walls."""
        return Box(1, 1, self.width - 2, self.height - 2, EMPTY)

    def inside(self, x: Word, y: Word) -> tuple[Word, Word]:
        """Return a cell within the outer walls: what is free is there, though that follows from no range."""
        return min(max(x, 1), self.width - 2), min(max(y, 1), self.height - 2)

    @property
    def agent_class(self) -> Any:
        """The class of agents."""

        class Agent(NamedTuple):
            """Column, row and direction: 0 right, 1 down, 2 left, 3 up."""

            x: Range[1, self.width - 2]
            y: Range[1, self.height - 2]
            direction: Bits[2]

        return Agent


def view_class_of(things: Sequence[Thing] = THINGS) -> Any:
    """Return the class of what an agent sees: a code for each cell, as :func:`view` returns them."""

    class View(NamedTuple):
        codes: Array[Range[0, len(things) - 1], SIGHT * SIGHT]

    return View


def ahead(agent: Any) -> tuple[Word, Word]:
    """Return column and row of the cell in front of the agent."""
    x, y, direction = agent
    return x + (1, 0, -1, 0)[direction], y + (0, 1, 0, -1)[direction]


def code_at(boxes: Sequence[Box], x: Word, y: Word) -> Word:
    """Return what is in a cell: the code of the last box that it is in."""
    code = WALL
    for box in boxes:
        if box.left <= x <= box.right and box.top <= y <= box.bottom:
            code = box.code
    return code


def facing(boxes: Sequence[Box], agent: Any) -> Word:
    """Return what is in front of the agent."""
    return code_at(boxes, *ahead(agent))


def walked(
    rules: Rules, state: Any, action: Word, front: Word, free: Sequence[int] = (EMPTY, GOAL)
) -> tuple[Any, Word, Word]:
    """Turn the agent, or move it ahead where ``front`` is one of the free codes.

    Returns the state, the reward, which is the number of the step that arrives at the goal, and whether it is
    that step.
    """
    x, y, direction = state.agent
    goes = action == FORWARD and front in free
    if action == LEFT:
        direction = direction + 3 & 3
    elif action == RIGHT:
        direction = direction + 1 & 3
    elif goes:
        x, y = rules.inside(*ahead(state.agent))
    steps, arrives = min(state.steps + 1, rules.max_steps), goes and front == GOAL
    agent = state.agent._replace(x=x, y=y, direction=direction)
    return state._replace(agent=agent, steps=steps), steps if arrives else 0, arrives


def view(boxes: Sequence[Box], agent: Any, opaque: Sequence[int] = (WALL,), hand: Word = EMPTY) -> list[Word]:
    """Return the codes of the cells that an agent sees, columns from left to right, the farthest cell first.

    Parameters
    ----------
    boxes
        The grid.
    agent
        Where it stands, and where it looks.
    opaque
        Codes that it does not see through; with none, it sees everything.
    hand
        What it carries, which it sees in its own cell.
    """
    cells = [[WALL] * SIGHT for _ in range(SIGHT)]
    for box in boxes:
        near, far, left, right = turned(box, agent)
        rows = [near <= AHEAD - row <= far for row in range(SIGHT)]
        columns = [left <= column - ASIDE <= right for column in range(SIGHT)]
        for row in range(SIGHT):
            for column in range(SIGHT):
                if rows[row] & columns[column]:
                    cells[row][column] = box.code
    if opaque:
        lit = light([[code not in opaque for code in row] for row in cells])
        for row in range(SIGHT):
            for column in range(SIGHT):
                if not lit[row][column]:
                    cells[row][column] = UNSEEN
    cells[AHEAD][ASIDE] = hand
    return [cells[row][column] for column in range(SIGHT) for row in range(SIGHT)]


def turned(box: Box, agent: Any) -> tuple[Word, Word, Word, Word]:
    """Return a box as the agent has it: from how far to how far ahead, and from how far to how far right."""
    x, y, direction = agent
    left, top, right, bottom = box.left - x, box.top - y, box.right - x, box.bottom - y
    return (
        (left, top, -right, -bottom)[direction],
        (right, bottom, -left, -top)[direction],
        (top, -right, -bottom, left)[direction],
        (bottom, -left, -top, right)[direction],
    )


def light(clear: Sequence[Sequence[Word]]) -> list[list[Word]]:
    """Return which cells an agent sees, by which of them it can see through.

    Light goes from the agent along its row, then from row to row, through clear cells only: straight ahead
    and diagonally, and along each row again.
    """
    lit = [[0] * SIGHT for _ in range(SIGHT)]
    lit[AHEAD][ASIDE] = 1
    for row in reversed(range(SIGHT)):
        for column in range(1, SIGHT):
            lit[row][column] |= lit[row][column - 1] & clear[row][column - 1]
        for column in reversed(range(1, SIGHT)):
            lit[row][column - 1] |= lit[row][column] & clear[row][column]
        if row:
            beam = [0, *(a & b for a, b in zip(lit[row], clear[row], strict=True)), 0]
            lit[row - 1] = [beam[k] | beam[k + 1] | beam[k + 2] for k in range(SIGHT)]
    return lit
