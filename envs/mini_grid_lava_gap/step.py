"""The golden step of MiniGridLavaGap: a strip of lava with one gap is between the agent and the goal."""

from typing import Any, NamedTuple

from pearl_marl.envs import mini_grid
from pearl_marl.envs.mini_grid import (
    EMPTY,
    FORWARD,
    GOAL,
    Box,
    Rules,
    Thing,
    cell,
    facing,
    view,
    view_class_of,
    walked,
)
from pearl_marl.golden import Draws, Word
from pearl_marl.layout import Range
from pearl_marl.spec import Golden

LAVA = 4
"""The code of its cells."""
THINGS = (*mini_grid.THINGS, Thing(mini_grid.LAVA))


def boxes(rules: Rules, state: Any) -> list[Box]:
    """Return the grid: a strip of lava with a gap, and a goal in the last cell."""
    column, last = state.column, rules.height - 2
    return [
        rules.floor,
        Box(column, 1, column, last, LAVA),
        cell(column, state.gap, EMPTY),
        cell(rules.width - 2, last, GOAL),
    ]


def make_golden(rules: Rules) -> Golden:
    """Return the golden functions."""
    width, height = rules.width, rules.height
    agent_class, view_class = rules.agent_class, view_class_of(THINGS)

    class State(NamedTuple):
        agent: agent_class
        steps: Range[0, rules.max_steps]
        column: Range[2, width - 3]
        """That of the lava."""
        gap: Range[1, height - 2]
        """The row without lava."""

    def initial(draws: Draws) -> State:
        """Put the agent into the first cell, and the lava and its gap anywhere."""
        column, gap = draws.several(width - 4, height - 2)
        return State(agent_class(1, 1, 0), 0, 2 + column, 1 + gap)

    def step(state: State, action: Word, draws: Draws) -> tuple[State, Word, Word]:
        """Walk; the lava ends the episode, too."""
        front = facing(boxes(rules, state), state.agent)
        state, reward, arrives = walked(rules, state, action, front, (EMPTY, GOAL, LAVA))
        return state, reward, arrives or (action == FORWARD and front == LAVA)

    def observe(state: State) -> Any:
        """Return what the agent sees."""
        return view_class(view(boxes(rules, state), state.agent))

    return Golden(State, initial, step, observe, view=view_class)
