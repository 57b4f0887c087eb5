"""The golden step of MiniGridKeyCorridor: behind a locked door lies a ball, and in another room a key.

There are three columns of rooms. Those of the middle one are a hallway.
"""

from typing import Any, NamedTuple

from pearl_marl.envs import mini_grid
from pearl_marl.envs.mini_grid import (
    DROP,
    EMPTY,
    PICKUP,
    TOGGLE,
    WALL,
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
from pearl_marl.layout import Array, Flag, Range
from pearl_marl.spec import Golden

COLOURS = 6
NO_DOOR, OPEN, CLOSED, LOCKED = range(4)
KEY, BALL, DOOR = (len(mini_grid.THINGS) + COLOURS * k for k in range(3))
"""Codes of the first colour; doors have a code for each state of a colour, beginning with open ones."""
OPEN_DOORS, SHUT_DOORS = range(DOOR, DOOR + COLOURS), range(DOOR + COLOURS, DOOR + 3 * COLOURS)
KINDS = ((mini_grid.KEY, 0), (mini_grid.BALL, 0), *((mini_grid.DOOR, state) for state in range(3)))
THINGS = (
    *mini_grid.THINGS,
    *(Thing(kind, colour, state) for kind, state in KINDS for colour in range(COLOURS)),
)
RANK = 24
NEVER = 1 << RANK
"""The bits of a door's rank, and the rank of a door that is not made."""


class Rooms(NamedTuple):
    """How many rows of rooms there are, and columns from one wall to the next."""

    rows: int
    size: int
    max_steps: int

    @property
    def rules(self) -> Rules:
        """The grid of all of them."""
        return Rules(3 * self.size + 1, self.rows * self.size + 1, self.max_steps)

    def boxes(self, state: Any) -> list[Box]:
        """Return the grid: walls of all rooms, doors in them, the key and the ball."""
        size, rules, key, ball = self.size, self.rules, state.key, state.ball
        walls = [Box(x, 1, x, rules.height - 2, WALL) for x in (size, 2 * size)]
        for y in range(size, rules.height - 1, size):
            walls += [Box(x + 1, y, x + size - 1, y, WALL) for x in (0, 2 * size)]
        doors = [
            cell(*place, DOOR + COLOURS * (max(door.state, 1) - 1) + door.colour if door.state else WALL)
            for place, door in zip(self.places(state.doors), state.doors, strict=True)
        ]
        things = [
            cell(key.x, key.y, EMPTY if key.carried else KEY + key.colour),
            cell(ball.x, ball.y, EMPTY if ball.carried else BALL + ball.colour),
        ]
        return [rules.floor, *walls, *doors, *things]

    def places(self, doors: Any) -> list[tuple[Word, Word]]:
        """Return column and row of each door: those into the hallway, then those between rows."""
        beside = [(x, y) for x in (1, 2) for y in range(self.rows)]
        below = [(x, y) for x in (0, 2) for y in range(1, self.rows)]
        places = [(x * self.size, y * self.size + 1 + doors[k].offset) for k, (x, y) in enumerate(beside)]
        for k, (x, y) in enumerate(below, len(beside)):
            places.append((x * self.size + 1 + doors[k].offset, y * self.size))
        return places


def entered(beside: list[Word], below: list[Word]) -> list[Word]:
    """Return the rank of the door with which each room of a side can be entered.

    Parameters
    ----------
    beside, below
        The ranks, in which order doors are made, of those into the hallway and of those between rows.
    """
    ranks = list(beside)
    for k, rank in enumerate(below):
        ranks[k + 1] = min(ranks[k + 1], max(ranks[k], rank))
    for k in reversed(range(len(below))):
        ranks[k] = min(ranks[k], max(ranks[k + 1], below[k]))
    return ranks


def make_golden(rooms: Rooms) -> Golden:
    """Return the golden functions."""
    rules, rows, size, inner = rooms.rules, rooms.rows, rooms.size, rooms.size - 1
    agent_class, view_class = rules.agent_class, view_class_of(THINGS)
    middle, above, below = rows // 2, rows > 1, rows > 2
    starts = 4 * inner * (inner + above + below)

    class Door(NamedTuple):
        offset: Range[0, inner - 1]
        colour: Range[0, COLOURS - 1]
        state: Range[NO_DOOR, LOCKED]

    class Found(NamedTuple):
        """A thing, where it lies or was taken."""

        x: Range[1, rules.width - 2]
        y: Range[1, rules.height - 2]
        colour: Range[0, COLOURS - 1]
        carried: Flag

    class State(NamedTuple):
        agent: agent_class
        steps: Range[0, rooms.max_steps]
        doors: Array[Door, 4 * rows - 2]
        key: Found
        ball: Found

    def initial(draws: Draws) -> State:
        """Lock a room on the right, and make doors in any order until all other rooms can be entered."""
        locked = draws.digit(rows)
        offsets, colours = ([draws.digit(n) for _ in range(4 * rows - 2)] for n in (inner, COLOURS))
        ranks = [draws.bits(RANK) for _ in offsets]
        into, between = ranks[rows : 2 * rows], ranks[3 * rows - 1 :]
        into = [NEVER if row == locked else rank for row, rank in enumerate(into)]
        between = [NEVER if locked in (row, row + 1) else rank for row, rank in enumerate(between)]
        ranks = [*ranks[:rows], *into, *ranks[2 * rows : 3 * rows - 1], *between]
        left, right = entered(ranks[:rows], ranks[2 * rows : 3 * rows - 1]), entered(into, between)
        last = max([*left, *(0 if row == locked else rank for row, rank in enumerate(right))])
        states = [CLOSED if rank <= last else NO_DOOR for rank in ranks]
        states[rows + locked] = LOCKED

        start = draws.digit(starts - (locked == middle), starts)
        top = middle * size + 1 - above
        # No agent starts before the locked door.
        before = 4 * inner * (middle * size + 1 + offsets[rows + middle] - top + 1) - 4
        start += (locked == middle) & (start >= before)
        direction, x, y = start % 4, start // 4 % inner, start // (4 * inner)
        key = Found(1 + draws.digit(inner), 0, colours[rows + locked], 0)
        key = key._replace(y=draws.digit(rows) * size + 1 + draws.digit(inner))
        ball = Found(2 * size + 1 + draws.digit(inner), locked * size + 1 + draws.digit(inner), 0, 0)
        ball = ball._replace(colour=draws.digit(COLOURS))
        doors = [Door(*parts) for parts in zip(offsets, colours, states, strict=True)]
        return State(agent_class(size + 1 + x, top + y, direction), 0, doors, key, ball)

    def step(state: State, action: Word, draws: Draws) -> tuple[State, Word, Word]:
        """Walk, or do something with what is ahead; who takes the ball has reached the end."""
        x, y = ahead(state.agent)
        front, key, ball, doors = code_at(rooms.boxes(state), x, y), state.key, state.ball, state.doors
        takes = action == PICKUP and not key.carried
        if takes and KEY <= front < BALL:
            key = key._replace(carried=1)
        elif action == DROP and front == EMPTY and key.carried:
            key = Found(*rules.inside(x, y), key.colour, 0)
        takes = takes and BALL <= front < DOOR
        if takes:
            ball = ball._replace(carried=1)
        for k, place in enumerate(rooms.places(doors)):
            if action == TOGGLE and place == (x, y):
                doors[k] = doors[k]._replace(state=toggled(doors[k].state, key.carried))
        state = state._replace(key=key, ball=ball, doors=doors)
        state, _, _ = walked(rules, state, action, front, (EMPTY, *OPEN_DOORS))
        return state, state.steps if takes else 0, takes

    def observe(state: State) -> Any:
        """Return what the agent sees: no more than walls and shut doors let through."""
        hand = KEY + state.key.colour if state.key.carried else EMPTY
        hand = BALL + state.ball.colour if state.ball.carried else hand
        return view_class(view(rooms.boxes(state), state.agent, (WALL, *SHUT_DOORS), hand))

    return Golden(State, initial, step, observe, view=view_class)


def toggled(door: Word, has_key: Word) -> Word:
    """Return the state of a door that is toggled."""
    if door == OPEN:
        return CLOSED
    if door == CLOSED or (door == LOCKED and has_key):
        return OPEN
    return door
