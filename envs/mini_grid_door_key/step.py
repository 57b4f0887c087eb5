"""The golden step of MiniGridDoorKey: a locked door leads to the goal, and there is a key for it."""

from typing import Any, NamedTuple

from pearl_marl.envs import mini_grid
from pearl_marl.envs.mini_grid import (
    DROP,
    EMPTY,
    GOAL,
    PICKUP,
    TOGGLE,
    WALL,
    YELLOW,
    Box,
    Rules,
    Thing,
    ahead,
    cell,
    code_at,
    view,
    view_class_of,
    walked,
)
from pearl_marl.golden import Draws, Word
from pearl_marl.layout import Flag, Range
from pearl_marl.spec import Golden

KEY, OPEN, CLOSED, LOCKED = range(4, 8)
"""Codes of cells."""
THINGS = (
    *mini_grid.THINGS,
    Thing(mini_grid.KEY, YELLOW),
    *(Thing(mini_grid.DOOR, YELLOW, state) for state in range(3)),
)


def boxes(rules: Rules, state: Any) -> list[Box]:
    """Return the grid: the key unless it is carried, a wall with a door, and a goal in the last cell."""
    key, column = state.key, state.wall
    return [
        rules.floor,
        cell(key.x, key.y, EMPTY if key.carried else KEY),
        Box(column, 1, column, rules.height - 2, WALL),
        cell(column, state.door_row, OPEN + state.door),
        cell(rules.width - 2, rules.height - 2, GOAL),
    ]


def make_golden(rules: Rules) -> Golden:
    """Return the golden functions."""
    width, height = rules.width, rules.height
    agent_class, view_class = rules.agent_class, view_class_of(THINGS)

    class Key(NamedTuple):
        """Where it lies, or was taken."""

        x: Range[1, width - 2]
        y: Range[1, height - 2]
        carried: Flag

    class State(NamedTuple):
        agent: agent_class
        steps: Range[0, rules.max_steps]
        wall: Range[2, width - 3]
        """Its column."""
        door_row: Range[1, height - 3]
        door: Range[0, 2]
        """Open, closed or locked."""
        key: Key

    def initial(draws: Draws) -> State:
        """Put agent and key into different cells to the left of a wall that is anywhere."""
        rows = height - 2
        most = (width - 4) * rows
        wall = 2 + draws.digit(width - 4)
        cells = (wall - 1) * rows
        place, direction = draws.digit(cells, most), draws.digit(4)
        door_row = 1 + draws.digit(height - 3)
        other = draws.digit(cells - 1, most - 1)
        other += other >= place
        agent = agent_class(1 + place // rows, 1 + place % rows, direction)
        return State(agent, 0, wall, door_row, LOCKED - OPEN, Key(1 + other // rows, 1 + other % rows, 0))

    def step(state: State, action: Word, draws: Draws) -> tuple[State, Word, Word]:
        """Walk, or do something with the key or the door ahead; the key opens a locked door."""
        x, y = ahead(state.agent)
        front, key, door = code_at(boxes(rules, state), x, y), state.key, state.door
        if action == PICKUP and front == KEY:
            key = key._replace(carried=1)
        elif action == DROP and front == EMPTY and key.carried:
            key = Key(*rules.inside(x, y), 0)
        elif action == TOGGLE and front >= OPEN and (front != LOCKED or key.carried):
            door = CLOSED - OPEN if front == OPEN else 0
        return walked(rules, state._replace(key=key, door=door), action, front, (EMPTY, GOAL, OPEN))

    def observe(state: State) -> Any:
        """Return what the agent sees: no more than walls and a shut door let through."""
        hand = KEY if state.key.carried else EMPTY
        return view_class(view(boxes(rules, state), state.agent, (WALL, CLOSED, LOCKED), hand))

    return Golden(State, initial, step, observe, view=view_class)
