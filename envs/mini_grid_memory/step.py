"""The golden step of MiniGridMemory: of two things at the end of a hall, one is as the one at its start."""

from typing import Any, NamedTuple

from pearl_marl.envs import mini_grid
from pearl_marl.envs.mini_grid import WALL, Box, Rules, Thing, cell, facing, view, view_class_of, walked
from pearl_marl.golden import Draws, Word
from pearl_marl.layout import Flag, Range
from pearl_marl.spec import Golden

KEY, BALL = 4, 5
"""Codes of cells."""
THINGS = (*mini_grid.THINGS, Thing(mini_grid.KEY, mini_grid.GREEN), Thing(mini_grid.BALL, mini_grid.GREEN))
ROOM = 4
"""The last column of the room at the start, which is closed but for its middle row."""


def boxes(rules: Rules, state: Any) -> list[Box]:
    """Return the grid: a room, a hall from its door, a corridor across the hall's end, and three things."""
    middle, end, last = rules.height // 2, state.hall, rules.height - 2
    above, below = (KEY, BALL) if state.key_above else (BALL, KEY)
    return [
        rules.floor,
        Box(1, middle - 2, ROOM, middle - 2, WALL),
        Box(1, middle + 2, ROOM, middle + 2, WALL),
        Box(ROOM, middle - 1, end, middle - 1, WALL),
        Box(ROOM, middle + 1, end, middle + 1, WALL),
        Box(end, 1, end, middle - 1, WALL),
        Box(end, middle + 1, end, last, WALL),
        Box(end + 2, 1, end + 2, last, WALL),
        cell(1, middle - 1, KEY if state.shows_key else BALL),
        cell(end + 1, middle - 2, above),
        cell(end + 1, middle + 2, below),
    ]


def make_golden(rules: Rules, random_length: bool) -> Golden:
    """Return the golden functions."""
    middle, longest = rules.height // 2, rules.width - 3
    agent_class, view_class = rules.agent_class, view_class_of(THINGS)

    class State(NamedTuple):
        agent: agent_class
        steps: Range[0, rules.max_steps]
        hall: Range[ROOM, longest]
        """Its last column."""
        shows_key: Flag
        """Whether the thing at the start is a key; if not, it is a ball."""
        key_above: Flag
        """Whether the key at the hall's end is above; the ball is below then."""

    def initial(draws: Draws) -> State:
        """Put the agent anywhere on the way to the hall's end, and decide which things there are."""
        hall = ROOM + draws.digit(longest - ROOM + 1) if random_length else longest
        x = 1 + draws.digit(hall, longest)
        return State(agent_class(x, middle, 0), 0, hall, draws.digit(2), draws.digit(2))

    def step(state: State, action: Word, draws: Draws) -> tuple[State, Word, Word]:
        """Walk; beside either thing at the hall's end the episode is over."""
        state, _, _ = walked(rules, state, action, facing(boxes(rules, state), state.agent))
        agent: Any = state.agent
        arrives = agent.x == state.hall + 1 and agent.y in (middle - 1, middle + 1)
        is_like = (agent.y < middle) == (state.shows_key == state.key_above)
        return state, state.steps if arrives and is_like else 0, arrives

    def observe(state: State) -> Any:
        """Return what the agent sees."""
        return view_class(view(boxes(rules, state), state.agent))

    return Golden(State, initial, step, observe, view=view_class)
