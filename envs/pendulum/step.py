"""The golden step of Pendulum, in fixed point.

Follows https://gymnasium.farama.org/environments/classic_control/pendulum/ (Pendulum-v1).

The angle is kept as a fraction of a turn with 32 fraction bits, 0 upright: it wraps where the
integer does, which is the oracle's normalisation to -pi .. pi, and needs no conversion on its way
into :func:`sine_cosine`. The angular velocity (rad/s) has 27 fraction bits, torque (N m) 29.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from pearl_marl.fixed_point import FRACTION, constant, multiply, sine_cosine
from pearl_marl.golden import Draws, GoldenFunction, Word, i32
from pearl_marl.layout import Signed

TIME_STEP = 0.05
SPEED_FRACTION, TORQUE_FRACTION, REWARD_FRACTION = 27, 29, 26

SPEED = constant(8, SPEED_FRACTION)
TORQUE = constant(2, TORQUE_FRACTION)
KICK = constant(3 * TIME_STEP, 33)
TURN = constant(TIME_STEP / (2 * math.pi), 37)
RADIANS = constant(2 * math.pi, 28)
SPEED_COST = constant(0.1, 34)
TORQUE_COST = constant(0.001, 40)


def fall(g: float) -> int:
    """Return the word that gravity ``g`` (m/s**2) is to the step: the change of speed by sine 1."""
    return constant(3 * g / 2 * TIME_STEP, 27)


class State(NamedTuple):
    """The angle, in turns, and the angular velocity."""

    angle: Signed[32, 32]
    speed: Signed[32, SPEED_FRACTION]


class View(NamedTuple):
    """What an agent sees."""

    cosine: Signed[32, FRACTION]
    sine: Signed[32, FRACTION]
    speed: Signed[32, SPEED_FRACTION]


def initial(draws: Draws) -> State:
    """Return the state of a new episode: any angle, and a speed uniform from -1 to just below 1."""
    return State(i32(draws.bits()), i32(draws.bits()) >> 4)


def make_step(fall: int) -> GoldenFunction:
    """Return the golden step under a gravity: see :func:`fall`."""

    def step(state: State, action: Word, draws: Draws) -> tuple[State, Word, Word]:
        """Apply a torque; an episode has no end of its own."""
        angle, speed = state
        torque = min(max(action, -TORQUE), TORQUE)
        radians = multiply(angle, RADIANS, 31)  # with 29 fraction bits
        angle_cost = multiply(radians, radians, 32)
        speed_cost = multiply(multiply(speed, SPEED_COST, 31), speed, 31)
        torque_cost = multiply(multiply(torque, TORQUE_COST, 31), torque, 41)
        # Speeds beyond SPEED, which nothing reaches, would cost more than the reward can say.
        reward = i32(-(angle_cost + speed_cost + torque_cost))

        sine, _ = sine_cosine(angle)
        speed += multiply(sine, fall, 30) + multiply(torque, KICK, 35)
        speed = min(max(speed, -SPEED), SPEED)
        return State(i32(angle + multiply(speed, TURN, 32)), speed), reward, False

    return step


def observe(state: State) -> View:
    """Return what an agent sees."""
    sine, cosine = sine_cosine(state.angle)
    return View(cosine, sine, state.speed)
