"""Gymnasium's MountainCar-v0, line by line."""

import math
from typing import Any, NamedTuple

import numpy as np
from gymnasium.spaces import Box, Discrete

from pearl_marl.layout import Real
from pearl_marl.spec import EnvSpec, Golden

MIN_POSITION, MAX_POSITION, MAX_SPEED, GOAL = -1.2, 0.6, 0.07, 0.5
FORCE, GRAVITY = 0.001, 0.0025


class State(NamedTuple):
    """A car between two hills."""

    position: Real[MIN_POSITION, MAX_POSITION]
    velocity: Real[-MAX_SPEED, MAX_SPEED]


def initial(draws: Any) -> State:
    return State(draws.uniform(-0.6, -0.4), 0.0)


def step(state: State, action: Any, draws: Any) -> tuple[State, Any, Any]:
    position, velocity = state
    velocity += (action - 1) * FORCE + math.cos(3 * position) * (-GRAVITY)
    velocity = np.clip(velocity, -MAX_SPEED, MAX_SPEED)
    position += velocity
    position = np.clip(position, MIN_POSITION, MAX_POSITION)
    if position == MIN_POSITION and velocity < 0:
        velocity = 0.0
    terminated = position >= GOAL and velocity >= 0
    return State(position, velocity), 0, terminated


def observe(state: State) -> State:
    return state


HIGH = np.array([MAX_POSITION, MAX_SPEED], np.float32)
SPEC = EnvSpec(
    name="RealMountainCar", version=0, summary="Drive up a hill, by Gymnasium's formulas", max_cycles=200,
    rewards=(-1.0,), observation_space=Box(np.array([MIN_POSITION, -MAX_SPEED], np.float32), HIGH),
    action_space=Discrete(3), golden=Golden(State, initial, step, observe, view=State),
    oracle="MountainCar-v0",
)  # fmt: skip
