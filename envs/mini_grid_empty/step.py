"""The golden step of MiniGridEmpty: an agent walks through a room to the goal in its corner."""

from typing import Any, NamedTuple

from pearl_marl.envs.mini_grid import GOAL, Box, Rules, cell, facing, view, view_class_of, walked
from pearl_marl.golden import Draws, Word
from pearl_marl.layout import Range
from pearl_marl.spec import Golden


def boxes(rules: Rules, state: Any) -> list[Box]:
    """Return the grid: a room with a goal in its last cell."""
    return [rules.floor, cell(rules.width - 2, rules.height - 2, GOAL)]


def make_golden(rules: Rules, start: tuple[int, int, int] | None) -> Golden:
    """Return the golden functions; ``start`` is column, row and direction, or None for any."""
    agent_class, view_class = rules.agent_class, view_class_of()

    class State(NamedTuple):
        agent: agent_class
        steps: Range[0, rules.max_steps]

    def initial(draws: Draws) -> State:
        """Put the agent at its start; or into any cell but the goal's, in any direction."""
        if start is not None:
            return State(agent_class(*start), 0)
        columns, rows = rules.width - 2, rules.height - 2
        place, direction = draws.several(columns * rows - 1, 4)
        return State(agent_class(1 + place % columns, 1 + place // columns, direction), 0)

    def step(state: State, action: Word, draws: Draws) -> tuple[State, Word, Word]:
        """Turn, or go ahead where no wall is."""
        return walked(rules, state, action, facing(boxes(rules, state), state.agent))

    def observe(state: State) -> Any:
        """Return what the agent sees, through walls too."""
        return view_class(view(boxes(rules, state), state.agent, opaque=()))

    return Golden(State, initial, step, observe, view=view_class)
