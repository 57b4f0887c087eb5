"""The golden step of Pendulum, in fixed point.

Follows https://gymnasium.farama.org/environments/classic_control/pendulum/ (Pendulum-v1).

The angle is kept as a fraction of a turn with 32 fraction bits, 0 upright: it wraps where the
integer does, which is the oracle's normalisation to -pi .. pi, and needs no conversion on its way
into :func:`sine_cosine`. The angular velocity (rad/s) has 27 fraction bits, torque (N m) 29.
"""

from __future__ import annotations

import math

import numpy as np

from pearl_marl.fixed_point import constant, multiply, sine_cosine
from pearl_marl.golden import GoldenFunction, Word, i32

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


def initial(draw_0: Word, draw_1: Word) -> tuple[Word, Word]:
    """Return the state of a new episode: any angle, and a speed uniform from -1 to just below 1."""
    return i32(draw_0), i32(draw_1) >> 4


def step(fall: int) -> GoldenFunction:
    """Make the step under a gravity: see :func:`fall`."""

    def step(angle: Word, speed: Word, action: Word) -> tuple[Word, Word, Word, Word]:
        """Apply a torque; return ``(angle, speed, reward, terminated)``, the last always 0."""
        torque = np.clip(action, -TORQUE, TORQUE)
        radians = multiply(angle, RADIANS, 31)  # with 29 fraction bits
        angle_cost = multiply(radians, radians, 32)
        speed_cost = multiply(multiply(speed, SPEED_COST, 31), speed, 31)
        torque_cost = multiply(multiply(torque, TORQUE_COST, 31), torque, 41)
        # Speeds beyond SPEED, which nothing reaches, would cost more than the reward can say.
        reward = i32(-(angle_cost + speed_cost + torque_cost))

        sine, _ = sine_cosine(angle)
        change = multiply(sine, fall, 30) + multiply(torque, KICK, 35)
        speed = np.clip(speed + change, -SPEED, SPEED)
        angle = i32(angle + multiply(speed, TURN, 32))
        return angle, speed, reward, 0

    return step


def observe(angle: Word, speed: Word) -> tuple[Word, Word, Word]:
    """Return the observation: cosine and sine of the angle, and the speed."""
    sine, cosine = sine_cosine(angle)
    return cosine, sine, speed
