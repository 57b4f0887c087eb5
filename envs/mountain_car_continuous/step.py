"""The golden step of MountainCarContinuous, by Gymnasium's formulas over reals.

Follows https://gymnasium.farama.org/environments/classic_control/mountain_car_continuous/
(MountainCarContinuous-v0), which follows Andrew Moore's thesis, *Efficient memory-based learning for robot
control*, 1990.
"""

import math
from typing import NamedTuple

import numpy as np

from pearl_marl.golden import Draws, GoldenFunction, Word
from pearl_marl.layout import Real

MIN_ACTION, MAX_ACTION, POWER, GRAVITY = -1.0, 1.0, 0.0015, 0.0025
MIN_POSITION, MAX_POSITION, MAX_SPEED, GOAL = -1.2, 0.6, 0.07, 0.45


class State(NamedTuple):
    """Position, and velocity per step."""

    position: Real[MIN_POSITION, MAX_POSITION]
    velocity: Real[-MAX_SPEED, MAX_SPEED]


def initial(draws: Draws) -> State:
    """Return the state of a new episode: a position uniform between -0.6 and -0.4, at rest."""
    return State(draws.uniform(-0.6, -0.4), 0.0)


def make_step(goal_velocity: float) -> GoldenFunction:
    """Return the golden step under a velocity that the goal demands."""

    def step(state: State, action: Word, draws: Draws) -> tuple[State, Word, Word]:
        """Push the car; the reward is 100 at the goal, less what the force costs."""
        position, velocity = state
        force = np.clip(action, MIN_ACTION, MAX_ACTION)
        velocity += force * POWER - GRAVITY * math.cos(3 * position)
        velocity = np.clip(velocity, -MAX_SPEED, MAX_SPEED)
        position = np.clip(position + velocity, MIN_POSITION, MAX_POSITION)
        if position == MIN_POSITION and velocity < 0:
            velocity = 0.0
        terminated = position >= GOAL and velocity >= goal_velocity
        reward = 100.0 if terminated else 0.0
        return State(position, velocity), reward - force**2 * 0.1, terminated

    return step


def observe(state: State) -> State:
    """Return the observation: the state."""
    return state
