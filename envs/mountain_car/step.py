"""The golden step of MountainCar, in fixed point.

Follows https://gymnasium.farama.org/environments/classic_control/mountain_car/ (MountainCar-v0),
which follows Andrew Moore's thesis, *Efficient memory-based learning for robot control*, 1990.

Position and velocity (per step) have 30 fraction bits, so one is added to the other as it is.
"""

from __future__ import annotations

import math

import numpy as np

from pearl_marl.fixed_point import constant, multiply, sine_cosine
from pearl_marl.golden import GoldenFunction, Word, i32

FRACTION = 30

LEFT_END, RIGHT_END = constant(-1.2, FRACTION), constant(0.6, FRACTION)
GOAL = constant(0.5, FRACTION)
MAX_SPEED = constant(0.07, FRACTION)
FORCE = constant(0.001, FRACTION)
GRAVITY = constant(0.0025, 39)
TURNS = constant(2**2 * 3 / (2 * math.pi), 30)  # 3 times the position, in turns with 32 fraction bits
MIDDLE, START = constant(-0.5, FRACTION), 2 * math.floor(0.1 * 2**FRACTION)


def goal_word(goal_velocity: float) -> int:
    """Return the least velocity word that is not below ``goal_velocity``."""
    return math.ceil(goal_velocity * 2.0**FRACTION)


def initial(draw: Word) -> tuple[Word, Word]:
    """Return the state of a new episode: a position uniform between -0.6 and -0.4, at rest."""
    # As a signed number a draw is from -1/2 to 1/2.
    return MIDDLE + multiply(i32(draw), START, 32), 0


def step(goal: int) -> GoldenFunction:
    """Make the step under a velocity that the goal demands: see :func:`goal_word`."""

    def step(position: Word, velocity: Word, action: Word) -> tuple[Word, Word, Word, Word]:
        """Push left (0), not at all (1) or right (2); return state, category (one, 0) and end."""
        _, cosine = sine_cosine(multiply(position, TURNS, 30))
        change = (action - 1) * FORCE - multiply(cosine, GRAVITY, 39)
        velocity = np.clip(velocity + change, -MAX_SPEED, MAX_SPEED)
        position = np.clip(position + velocity, LEFT_END, RIGHT_END)
        velocity = np.where((position == LEFT_END) & (velocity < 0), 0, velocity)
        terminated = (position >= GOAL) & (velocity >= goal)
        return position, velocity, 0, terminated

    return step


def observe(position: Word, velocity: Word) -> tuple[Word, Word]:
    """Return the observation: the state."""
    return position, velocity
