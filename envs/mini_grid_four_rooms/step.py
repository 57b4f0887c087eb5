"""The golden step of MiniGridFourRooms: a goal is somewhere in four rooms, which gaps in their walls join."""

from collections.abc import Sequence
from typing import Any, NamedTuple

from pearl_marl.envs.mini_grid import EMPTY, GOAL, WALL, Box, Rules, cell, facing, view, view_class_of, walked
from pearl_marl.golden import Draws, Word
from pearl_marl.layout import Array, Range
from pearl_marl.spec import Golden

SIZE, ROOM = 19, 8
"""Columns and rows of the grid, and of a room without walls."""
MIDDLE, LAST = ROOM + 1, SIZE - 2
CELLS = 4 * ROOM**2
"""Those of the rooms."""


def places(gaps: Sequence[Word]) -> list[tuple[Word, Word]]:
    """Return columns and rows of the gaps: above, left, right and below the middle."""
    above, left, right, below = gaps
    second = MIDDLE + 1
    return [(MIDDLE, 1 + above), (1 + left, MIDDLE), (second + right, MIDDLE), (MIDDLE, second + below)]


def boxes(rules: Rules, state: Any) -> list[Box]:
    """Return the grid: two walls that cross, their gaps, and the goal."""
    return [
        rules.floor,
        Box(MIDDLE, 1, MIDDLE, LAST, WALL),
        Box(1, MIDDLE, LAST, MIDDLE, WALL),
        *(cell(x, y, EMPTY) for x, y in places(state.gaps)),
        cell(state.goal.x, state.goal.y, GOAL),
    ]


def cell_of(number: Word, gaps: Sequence[tuple[Word, Word]]) -> tuple[Word, Word]:
    """Return column and row of a cell by its number: room after room, then the gaps."""
    room, row, column = number // ROOM**2, number // ROOM % ROOM, number % ROOM
    x, y = 1 + column + MIDDLE * (room % 2), 1 + row + MIDDLE * (room // 2 % 2)
    for k, (gap_x, gap_y) in enumerate(gaps):
        if number == CELLS + k:
            x, y = gap_x, gap_y
    return x, y


def make_golden(rules: Rules) -> Golden:
    """Return the golden functions."""
    agent_class, view_class = rules.agent_class, view_class_of()

    class Goal(NamedTuple):
        x: Range[1, LAST]
        y: Range[1, LAST]

    class State(NamedTuple):
        agent: agent_class
        steps: Range[0, rules.max_steps]
        gaps: Array[Range[0, ROOM - 1], 4]
        goal: Goal

    def initial(draws: Draws) -> State:
        """Put gaps anywhere, and agent and goal into different cells, a gap's included."""
        gaps = draws.several(*[ROOM] * 4)
        first, direction = draws.several(CELLS + 4, 4)
        second = draws.digit(CELLS + 3)
        second += second >= first
        agent = agent_class(*cell_of(first, places(gaps)), direction)
        return State(agent, 0, gaps, Goal(*cell_of(second, places(gaps))))

    def step(state: State, action: Word, draws: Draws) -> tuple[State, Word, Word]:
        """Walk."""
        return walked(rules, state, action, facing(boxes(rules, state), state.agent))

    def observe(state: State) -> Any:
        """Return what the agent sees."""
        return view_class(view(boxes(rules, state), state.agent))

    return Golden(State, initial, step, observe, view=view_class)
