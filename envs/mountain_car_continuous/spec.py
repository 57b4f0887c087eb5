"""The spec of MountainCarContinuous: what the platform has to know besides the dynamics in ``step.py``."""

from __future__ import annotations

from typing import Any

import numpy as np
from gymnasium import Env
from gymnasium.spaces import Box

from pearl_marl.checks import checked_number
from pearl_marl.layout import Real
from pearl_marl.spec import EnvSpec, Golden, Peer

from .presets import PRESETS
from .step import (
    MAX_ACTION,
    MAX_POSITION,
    MAX_SPEED,
    MIN_ACTION,
    MIN_POSITION,
    State,
    initial,
    make_step,
    observe,
)

LOW = np.array([MIN_POSITION, -MAX_SPEED], np.float32)
HIGH = np.array([MAX_POSITION, MAX_SPEED], np.float32)


def pose(oracle: Env[Any, Any], state: State) -> None:
    """Put Gymnasium's environment into a state, for rendering."""
    oracle.state = np.array(state)  # type: ignore[attr-defined]


def configure(goal_velocity: float = 0) -> EnvSpec:
    """Return the spec under Gymnasium's keyword arguments.

    Parameters
    ----------
    goal_velocity
        The least velocity, per step, with which the goal counts as reached, -1 to 1. The car never
        exceeds 0.07.
    """
    goal_velocity = checked_number("goal_velocity", goal_velocity, -1, 1)
    return EnvSpec(
        name="MountainCarContinuous",
        version=0,
        summary="Drive an underpowered car up a hill with as little force as possible",
        rewards=None,
        reward=Real[-0.1, 100.0],
        observation_space=Box(LOW, HIGH, dtype=np.float32),
        action_space=Box(MIN_ACTION, MAX_ACTION, (1,), np.float32),
        golden=Golden(State, initial, make_step(goal_velocity), observe, view=State),
        max_cycles=999,
        options={"goal_velocity": goal_velocity},
        configure=configure,
        peers={"gymnax": Peer("MountainCarContinuous-v0", parameters=("goal_velocity",))},
        presets=PRESETS,
        oracle="MountainCarContinuous-v0",
        pose=pose,
        render_modes=("human", "rgb_array"),
        render_fps=30,
    )


SPEC = configure()
