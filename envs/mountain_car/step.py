"""The golden step of MountainCar, in fixed point.

Follows https://gymnasium.farama.org/environments/classic_control/mountain_car/ (MountainCar-v0),
which follows Andrew Moore's thesis, *Efficient memory-based learning for robot control*, 1990.

Position and velocity (per step) have 30 fraction bits, so one is added to the other as it is.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from pearl_marl.fixed_point import constant, multiply, sine_cosine
from pearl_marl.golden import Draws, GoldenFunction, Word, i32
from pearl_marl.layout import Signed

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


class State(NamedTuple):
    """Position, and velocity per step."""

    position: Signed[32, FRACTION]
    velocity: Signed[32, FRACTION]


def initial(draws: Draws) -> State:
    """Return the state of a new episode: a position uniform between -0.6 and -0.4, at rest."""
    # As a signed number a draw is from -1/2 to 1/2.
    return State(MIDDLE + multiply(i32(draws.bits()), START, 32), 0)


def make_step(goal: int) -> GoldenFunction:
    """Return the golden step under a velocity that the goal demands: see :func:`goal_word`."""

    def step(state: State, action: Word, draws: Draws) -> tuple[State, Word, Word]:
        """Push left (0), not at all (1) or right (2); there is one category of reward, 0."""
        position, velocity = state
        _, cosine = sine_cosine(multiply(position, TURNS, 30))
        velocity += (action - 1) * FORCE - multiply(cosine, GRAVITY, 39)
        velocity = min(max(velocity, -MAX_SPEED), MAX_SPEED)
        position = min(max(position + velocity, LEFT_END), RIGHT_END)
        if position == LEFT_END and velocity < 0:
            velocity = 0
        return State(position, velocity), 0, position >= GOAL and velocity >= goal

    return step


def observe(state: State) -> State:
    """Return the observation: the state."""
    return state
