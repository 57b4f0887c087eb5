"""The spec of CliffWalking: what the platform has to know besides the dynamics in ``step.py``."""

from __future__ import annotations

from typing import Any

import numpy as np
from gymnasium import Env
from gymnasium.spaces import Discrete

from pearl_marl.checks import checked_flag
from pearl_marl.spec import EnvSpec, Golden, Grid

from .step import State, initial, observe, step, step_slippery

ROWS, COLUMNS = 4, 12


def pose(oracle: Env[Any, Any], state: State) -> None:
    """Put Gymnasium's CliffWalking into a state, for rendering."""
    oracle.s = observe(state)  # type: ignore[attr-defined]
    oracle.lastaction = None  # type: ignore[attr-defined]


def configure(is_slippery: bool = False) -> EnvSpec:
    """Return the spec under Gymnasium's keyword arguments.

    Parameters
    ----------
    is_slippery
        Whether an action is turned left or right, with probability 1/3 each.
    """
    checked_flag("is_slippery", is_slippery)
    return EnvSpec(
        name="CliffWalking",
        version=0,
        summary="Walk from start to goal along a cliff; falling off costs 100",
        rewards=(-1.0, -100.0),
        observation_space=Discrete(ROWS * COLUMNS),
        action_space=Discrete(4),
        golden=Golden(State, initial, step_slippery if is_slippery else step, observe),
        options={"is_slippery": is_slippery},
        configure=configure,
        oracle="CliffWalking-v1",
        pose=pose,
        render_modes=("human", "rgb_array", "ansi"),
        grid=Grid(ROWS, COLUMNS, cell=np.asarray),
    )


SPEC = configure()
