"""Importing this registers MiniGrid's environments with Gymnasium, with the image as their only observation.

Gymnasium imports it for ids such as ``"pearl_marl.envs.mini_grid_oracle:MiniGridImage/DoorKey"``.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any

import gymnasium
import minigrid.envs
from minigrid.core.grid import Grid
from minigrid.core.world_object import WorldObj
from minigrid.minigrid_env import MiniGridEnv
from minigrid.wrappers import ImgObsWrapper

from pearl_marl.envs.mini_grid import Box, Thing

DEFAULTS: dict[str, dict[str, Any]] = {
    "Empty": {},
    "DoorKey": {},
    "KeyCorridor": {"num_rows": 1, "room_size": 3},
    "LavaGap": {"size": 7},
    "FourRooms": {},
    "DynamicObstacles": {},
    "Memory": {"size": 13},
}
"""Our names, and the arguments whose default is another one than MiniGrid's, which may have none."""


def made(name: str, **options: Any) -> gymnasium.Env[Any, Any]:
    """Return one of MiniGrid's environments, which shows the image only."""
    return ImgObsWrapper(getattr(minigrid.envs, f"{name}Env")(**options))  # type: ignore[no-untyped-call]


def pose(
    game: MiniGridEnv, boxes: Sequence[Box], things: Sequence[Thing], state: Any, carried: Thing | None
) -> None:
    """Put MiniGrid's game into a state: paint its grid, and put the agent there."""
    game.grid = Grid(game.width, game.height)
    wall = Box(0, 0, game.width - 1, game.height - 1, 2)
    for box in (wall, *boxes):
        for x in range(box.left, box.right + 1):
            for y in range(box.top, box.bottom + 1):
                game.grid.set(x, y, WorldObj.decode(*things[box.code]))
    game.agent_pos, game.agent_dir = (state.agent.x, state.agent.y), state.agent.direction
    game.carrying = None if carried is None else WorldObj.decode(*carried)  # type: ignore[assignment]
    game.step_count = state.steps


for name, defaults in DEFAULTS.items():
    if f"MiniGridImage/{name}" not in gymnasium.registry:
        gymnasium.register(f"MiniGridImage/{name}", partial(made, name), kwargs=defaults)
