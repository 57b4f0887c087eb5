"""MPE's own games: put into states of ours, and drawn."""

from __future__ import annotations

import functools
import importlib
from typing import Any

import numpy as np
import numpy.typing as npt


def made(name: str, **options: Any) -> Any:
    """Return a game of MPE's by its name there, begun."""
    game = importlib.import_module(f"mpe2.{name}.{name}").raw_env(render_mode="rgb_array", **options)
    game.reset(seed=0)
    return game


def pose(game: Any, state: Any) -> None:
    """Put a game into a state of ours, which has `agents` and `landmarks`."""
    for theirs, ours in zip(game.world.agents, state.agents, strict=True):
        theirs.state.p_pos = np.array([ours.x, ours.y], float)
        theirs.state.p_vel = np.array([ours.vx, ours.vy], float)
    for theirs, ours in zip(game.world.landmarks, state.landmarks, strict=True):
        theirs.state.p_pos = np.array([ours.x, ours.y], float)


@functools.cache
def _canvas(name: str, **options: Any) -> Any:
    return made(name, **options)


def drawn(state: Any, name: str, **options: Any) -> npt.NDArray[np.uint8]:
    """Return MPE's picture of a state."""
    game = _canvas(name, **options)
    pose(game, state)
    picture: npt.NDArray[np.uint8] = game.render()
    return picture
