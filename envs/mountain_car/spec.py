"""The spec of MountainCar: what the platform has to know besides the dynamics in ``step.py``."""

from __future__ import annotations

from typing import Any

import numpy as np
from gymnasium import Env
from gymnasium.spaces import Box, Discrete

from pearl_marl.checks import checked_number
from pearl_marl.spec import EnvSpec, Golden

from .presets import PRESETS
from .step import State, goal_word, initial, make_step, observe

LOW, HIGH = np.array([-1.2, -0.07], np.float32), np.array([0.6, 0.07], np.float32)


def pose(oracle: Env[Any, Any], state: State) -> None:
    """Put Gymnasium's MountainCar into a state, for rendering."""
    oracle.state = state  # type: ignore[attr-defined]


def configure(goal_velocity: float = 0) -> EnvSpec:
    """Return the spec under Gymnasium's keyword arguments.

    Parameters
    ----------
    goal_velocity
        The least velocity, per step, with which the goal counts as reached, -1 to 1. The car
        never exceeds 0.07.
    """
    goal_velocity = checked_number("goal_velocity", goal_velocity, -1, 1)
    return EnvSpec(
        name="MountainCar",
        version=0,
        summary="Drive an underpowered car up a hill by rocking",
        rewards=(-1.0,),
        observation_space=Box(LOW, HIGH, dtype=np.float32),
        action_space=Discrete(3),
        golden=Golden(State, initial, make_step(goal_word(goal_velocity)), observe, view=State),
        max_cycles=200,
        options={"goal_velocity": goal_velocity},
        configure=configure,
        peers={"gymnax": "MountainCar-v0"},
        presets=PRESETS,
        oracle="MountainCar-v0",
        pose=pose,
        render_modes=("human", "rgb_array"),
        render_fps=30,
    )


SPEC = configure()
