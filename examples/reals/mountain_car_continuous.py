"""Gymnasium's MountainCarContinuous-v0, line by line."""

import math
from typing import Any, NamedTuple

import numpy as np
from gymnasium.spaces import Box

from pearl_marl.layout import Real
from pearl_marl.spec import EnvSpec, Golden

MIN_ACTION, MAX_ACTION, POWER = -1.0, 1.0, 0.0015
MIN_POSITION, MAX_POSITION, MAX_SPEED, GOAL = -1.2, 0.6, 0.07, 0.45


class State(NamedTuple):
    """A car between two hills."""

    position: Real[MIN_POSITION, MAX_POSITION]
    velocity: Real[-MAX_SPEED, MAX_SPEED]


def initial(draws: Any) -> State:
    return State(draws.uniform(-0.6, -0.4), 0.0)


def step(state: State, action: Any, draws: Any) -> tuple[State, Any, Any]:
    position, velocity = state
    force = min(max(action, MIN_ACTION), MAX_ACTION)
    velocity += force * POWER - 0.0025 * math.cos(3 * position)
    if velocity > MAX_SPEED:
        velocity = MAX_SPEED
    if velocity < -MAX_SPEED:
        velocity = -MAX_SPEED
    position += velocity
    if position > MAX_POSITION:
        position = MAX_POSITION
    if position < MIN_POSITION:
        position = MIN_POSITION
    if position == MIN_POSITION and velocity < 0:
        velocity = 0.0
    terminated = position >= GOAL and velocity >= 0.0
    reward = 100.0 if terminated else 0.0
    reward -= force**2 * 0.1
    return State(position, velocity), reward, terminated


def observe(state: State) -> State:
    return state


HIGH = np.array([MAX_POSITION, MAX_SPEED], np.float32)
SPEC = EnvSpec(
    name="RealMountainCarContinuous", version=0, summary="Drive up a hill by any force", max_cycles=999,
    rewards=None, reward=Real[-0.2, 100.0], action_space=Box(MIN_ACTION, MAX_ACTION, (1,), np.float32),
    observation_space=Box(np.array([MIN_POSITION, -MAX_SPEED], np.float32), HIGH),
    golden=Golden(State, initial, step, observe, view=State), oracle="MountainCarContinuous-v0",
)  # fmt: skip
