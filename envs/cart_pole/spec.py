"""The spec of CartPole: what the platform has to know besides the dynamics in ``step.py``."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from gymnasium import Env
from gymnasium.spaces import Box, Discrete

from pearl_marl.checks import checked_flag
from pearl_marl.spec import EnvSpec, Golden

from .presets import PRESETS
from .step import State, initial, make_step, observe

# Twice what ends an episode, so that its last observation is inside; velocities have no bound.
HIGH = np.array([4.8, np.inf, 2 * 12 * 2 * math.pi / 360, np.inf], np.float32)


def pose(oracle: Env[Any, Any], state: State) -> None:
    """Put Gymnasium's CartPole into a state, for rendering."""
    oracle.state = np.array(state)  # type: ignore[attr-defined]


def configure(sutton_barto_reward: bool = False) -> EnvSpec:
    """Return the spec under Gymnasium's keyword arguments.

    Parameters
    ----------
    sutton_barto_reward
        Whether the reward is 0 a step and -1 for the step that ends the episode, instead of 1 a step.
    """
    checked_flag("sutton_barto_reward", sutton_barto_reward)
    return EnvSpec(
        name="CartPole",
        version=0,
        summary="Balance a pole on a cart by pushing it left or right",
        rewards=(0.0, -1.0) if sutton_barto_reward else (1.0,),
        observation_space=Box(-HIGH, HIGH, dtype=np.float32),
        action_space=Discrete(2),
        golden=Golden(State, initial, make_step(int(sutton_barto_reward)), observe, view=State),
        max_cycles=500,
        options={"sutton_barto_reward": sutton_barto_reward},
        configure=configure,
        peers={"gymnax": "CartPole-v1"},
        presets=PRESETS,
        oracle="CartPole-v1",
        pose=pose,
        render_modes=("human", "rgb_array"),
        render_fps=50,
    )


SPEC = configure()
