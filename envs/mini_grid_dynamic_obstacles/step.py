"""The golden step of MiniGridDynamicObstacles: balls roll about between the agent and the goal."""

from collections.abc import Sequence
from itertools import product
from typing import Any, NamedTuple

from pearl_marl.envs import mini_grid
from pearl_marl.envs.mini_grid import GOAL, WALL, Box, Rules, Thing, cell, facing, view, view_class_of, walked
from pearl_marl.golden import Draws, Word, another
from pearl_marl.layout import Array, Range
from pearl_marl.spec import Golden

BALL = 4
"""The code of its cell."""
THINGS = (*mini_grid.THINGS, Thing(mini_grid.BALL, mini_grid.BLUE))
AROUND = [step for step in product((-1, 0, 1), repeat=2) if step != (0, 0)]
"""Steps to the cells around one."""


def boxes(rules: Rules, state: Any) -> list[Box]:
    """Return the grid: a room with a goal in its last cell, and balls."""
    balls = [cell(ball.x, ball.y, BALL) for ball in state.balls]
    return [rules.floor, cell(rules.width - 2, rules.height - 2, GOAL), *balls]


def make_golden(rules: Rules, start: tuple[int, int, int] | None, count: int) -> Golden:
    """Return the golden functions; ``start`` is column, row and direction, or None for any."""
    columns, rows = rules.width - 2, rules.height - 2
    agent_class, view_class = rules.agent_class, view_class_of(THINGS)

    class Ball(NamedTuple):
        x: Range[1, columns]
        y: Range[1, rows]

    class State(NamedTuple):
        agent: agent_class
        steps: Range[0, rules.max_steps]
        balls: Array[Ball, count]

    def initial(draws: Draws) -> State:
        """Put the agent at its start, and balls into any other cells but the goal's."""
        if start is None:
            place, taken = another(draws, columns * rows - 1, [])
            agent = agent_class(1 + place % columns, 1 + place // columns, draws.digit(4))
        else:
            agent, taken = agent_class(*start), [start[0] - 1 + columns * (start[1] - 1)]
        balls = []
        for _ in range(count):
            place, taken = another(draws, columns * rows - 1, taken)
            balls.append(Ball(1 + place % columns, 1 + place // columns))
        return State(agent, 0, balls)

    def step(state: State, action: Word, draws: Draws) -> tuple[State, Word, Word]:
        """Let balls roll, then walk; an agent that goes where a ball or a wall was before is hit."""
        hit = action == mini_grid.FORWARD and facing(boxes(rules, state), state.agent) in (WALL, BALL)
        balls = list(state.balls)
        for k in range(count):
            balls[k] = rolled(state.agent, balls, k, draws)
        state = state._replace(balls=balls)
        state, reward, arrives = walked(rules, state, action, facing(boxes(rules, state), state.agent))
        return state, rules.max_steps + 1 if hit else reward, arrives or hit

    def rolled(agent: Any, balls: Sequence[Any], k: int, draws: Draws) -> Any:
        """Return a ball in any free cell around it; where there is none, it stays."""
        x, y = balls[k]
        near = [(x + right, y + down) for right, down in AROUND]
        taken = [(agent.x, agent.y), (columns, rows), *balls]
        free = [place == rules.inside(*place) and place not in taken for place in near]
        rank = draws.digit(max(sum(free), 1), len(AROUND))
        for place, is_free in zip(near, free, strict=True):
            if is_free and rank == 0:
                x, y = rules.inside(*place)
            rank -= is_free
        return Ball(x, y)

    def observe(state: State) -> Any:
        """Return what the agent sees, through walls too."""
        return view_class(view(boxes(rules, state), state.agent, opaque=()))

    return Golden(State, initial, step, observe, view=view_class)
