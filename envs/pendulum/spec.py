"""The spec of Pendulum: what the platform has to know besides the dynamics in ``step.py``."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from gymnasium import Env
from gymnasium.spaces import Box

from pearl_marl.checks import checked_number
from pearl_marl.spec import EnvSpec, Field, Golden

from .presets import PRESETS
from .step import REWARD_FRACTION, TORQUE_FRACTION, State, View, fall, initial, make_step, observe

MAX_GRAVITY = 200
HIGH = np.array([1, 1, 8], np.float32)


def pose(oracle: Env[Any, Any], state: State) -> None:
    """Put Gymnasium's Pendulum into a state, for rendering; a slot's last torque is not known."""
    turns, speed = state
    oracle.state = np.array([2 * math.pi * turns, speed])  # type: ignore[attr-defined]
    oracle.last_u = None  # type: ignore[attr-defined]


def configure(g: float = 10.0) -> EnvSpec:
    """Return the spec under Gymnasium's keyword arguments.

    Parameters
    ----------
    g
        Gravity in m/s**2, -200 to 200.
    """
    g = checked_number("g", g, -MAX_GRAVITY, MAX_GRAVITY)
    return EnvSpec(
        name="Pendulum",
        version=0,
        summary="Swing a pendulum up and hold it there",
        action=Field("torque", 32, signed=True, fraction=TORQUE_FRACTION),
        reward=Field("reward", 32, signed=True, fraction=REWARD_FRACTION),
        rewards=None,
        observation_space=Box(-HIGH, HIGH, dtype=np.float32),
        action_space=Box(-2, 2, (1,), np.float32),
        golden=Golden(State, initial, make_step(fall(g)), observe, view=View),
        max_cycles=200,
        options={"g": g},
        configure=configure,
        presets=PRESETS,
        oracle="Pendulum-v1",
        pose=pose,
        render_modes=("human", "rgb_array"),
        render_fps=30,
    )


SPEC = configure()
