"""The spec of MiniGridDynamicObstacles: MiniGrid's arguments."""

from __future__ import annotations

from functools import partial
from typing import Any

from pearl_marl.checks import checked_integer
from pearl_marl.envs.mini_grid import FORWARD, Rules
from pearl_marl.envs.mini_grid_spec import checked_max_steps, checked_start, rewards_until, spec_parts
from pearl_marl.spec import EnvSpec

from .step import THINGS, boxes, make_golden

SIZES = (5, 16)
HIT = -1.0


def configure(
    size: int = 8,
    agent_start_pos: tuple[int, int] | None = (1, 1),
    agent_start_dir: int = 0,
    n_obstacles: int = 4,
    max_steps: int | None = None,
) -> EnvSpec:
    """Return the spec under MiniGrid's keyword arguments.

    Parameters
    ----------
    size
        Columns and rows with the outer walls, 5 to 16.
    agent_start_pos, agent_start_dir
        Column and row where the agent starts, and its direction: 0 right, 1 down, 2 left, 3 up. With a
        position of None both are drawn.
    n_obstacles
        How many balls there are, 1 to ``size``; more than ``size / 2 + 1`` are ``size // 2``, as in MiniGrid.
    max_steps
        The time limit; None is ``4 * size**2``.
    """
    size = checked_integer("size", size, *SIZES)
    start = checked_start(size, agent_start_pos, agent_start_dir)
    n_obstacles = checked_integer("n_obstacles", n_obstacles, 1, size)
    count = n_obstacles if n_obstacles <= size / 2 + 1 else size // 2
    rules = Rules(size, size, checked_max_steps(max_steps, 4 * size**2))

    def pose_balls(game: Any, state: Any) -> None:
        """Tell MiniGrid's game which balls roll."""
        game.obstacles = [game.grid.get(ball.x, ball.y) for ball in state.balls]
        for ball, place in zip(game.obstacles, state.balls, strict=True):
            ball.cur_pos = tuple(place)

    return EnvSpec(
        **spec_parts(
            "DynamicObstacles",
            "Dynamic-Obstacles-8x8",
            THINGS,
            partial(boxes, rules),
            {
                "size": size,
                "agent_start_pos": start and start[:2],
                "agent_start_dir": agent_start_dir,
                "n_obstacles": n_obstacles,
                "max_steps": max_steps,
            },
            actions=FORWARD + 1,
            pose_more=pose_balls,
        ),
        summary="Walk to a goal among balls that move",
        rewards=(*rewards_until(rules.max_steps), HIT),
        golden=make_golden(rules, start, count),
        max_cycles=rules.max_steps,
        configure=configure,
    )


SPEC = configure()
