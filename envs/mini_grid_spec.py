"""What the specs of MiniGrid's environments have in common: spaces, rewards, and MiniGrid's own renderer."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from gymnasium.spaces import Box as BoxSpace
from gymnasium.spaces import Discrete

from pearl_marl.checks import checked_integer
from pearl_marl.envs.mini_grid import DONE, SIGHT, Box, Thing
from pearl_marl.errors import ArgumentError

MOST_STEPS = (1 << 16) - 2
"""The longest time limit: a reward's category is the number of its step."""

PRESET: dict[str, Any] = {
    "n_agents": 512,
    "minibatch": 2048,
    "learning_rate": 1e-3,
    "discount": 0.99,
    "entropy": 0.01,
}
"""Settings of PPO for grids of cells, and rewards that are rare at first."""


def checked_max_steps(max_steps: int | None, default: int) -> int:
    """Return the time limit, or the default for None."""
    return default if max_steps is None else checked_integer("max_steps", max_steps, 1, MOST_STEPS)


def checked_start(size: int, place: Any, direction: Any) -> tuple[int, int, int] | None:
    """Return where the agent starts, column, row and direction; None for anywhere."""
    direction = checked_integer("agent_start_dir", direction, 0, 3)
    if place is None:
        return None
    if not isinstance(place, (tuple, list)) or len(place) != 2:
        raise ArgumentError(f"agent_start_pos is {place!r}; it must be (column, row), or None for anywhere")
    x, y = (checked_integer("agent_start_pos", number, 1, size - 2) for number in place)
    return x, y, direction


def rewards_until(max_steps: int) -> tuple[float, ...]:
    """Return the rewards of arriving in each step; that of no arrival is in place 0."""
    return (0.0, *(1 - 0.9 * (step / max_steps) for step in range(1, max_steps + 1)))


def spec_parts(
    name: str,
    registered: str,
    things: Sequence[Thing],
    boxes: Callable[[Any], list[Box]],
    options: Mapping[str, Any],
    *,
    actions: int = DONE + 1,
    carried: Callable[[Any], Thing | None] = lambda state: None,
    pose_more: Callable[[Any, Any], None] = lambda game, state: None,
) -> dict[str, Any]:
    """Return what the specs have in common.

    Parameters
    ----------
    name
        The environment's, without ``MiniGrid``.
    registered
        MiniGrid's name of it with its default options.
    things
        What each code stands for.
    boxes
        Paints the grid of a state.
    options
        The arguments, MiniGrid's own.
    actions
        How many actions there are.
    carried
        Returns what the agent of a state carries.
    pose_more
        Puts the rest of a state into MiniGrid's game, if there is any.
    """
    kinds, colours, states = (tuple(numbers) for numbers in zip(*things, strict=True))

    def unpack(seen: Any, row: Any) -> None:
        """Write kind, colour and state of each cell, MiniGrid's ``(7, 7, 3)`` of column, row and number."""
        for k in range(SIGHT * SIGHT):
            code = seen.codes[k]
            row[3 * k], row[3 * k + 1], row[3 * k + 2] = kinds[code], colours[code], states[code]

    def pose(oracle: Any, state: Any) -> None:
        """Put MiniGrid's game into a slot's state."""
        from pearl_marl.envs import mini_grid_oracle

        mini_grid_oracle.pose(oracle, boxes(state), things, state, carried(state))
        pose_more(oracle, state)

    return {
        "name": f"MiniGrid{name}",
        "version": 0,
        "observation_space": BoxSpace(0, 255, (SIGHT, SIGHT, 3), np.uint8),
        "action_space": Discrete(actions),
        "unpack": unpack,
        "options": options,
        "oracle": f"pearl_marl.envs.mini_grid_oracle:MiniGridImage/{name}",
        "follows": f"minigrid MiniGrid-{registered}-v0",
        "peers": {"EnvPool": f"MiniGrid-{registered}-v0"},
        "pose": pose,
        "render_modes": ("human", "rgb_array"),
        "render_fps": 10,
    }
