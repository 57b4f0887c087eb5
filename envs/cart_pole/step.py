"""The golden step of CartPole, in fixed point.

Follows https://gymnasium.farama.org/environments/classic_control/cart_pole/ (CartPole-v1), which
follows Barto, Sutton and Anderson, *Neuronlike adaptive elements that can solve difficult learning
control problems*, 1983, with the equations corrected by Florian,
https://coneural.org/florian/papers/05_cart_pole.pdf.

The state's words have 27 fraction bits. The equations are arranged so that every intermediate word is
below 2, whatever the state, and has 30 fraction bits: with the time step inside, accelerations are the
changes of a velocity in one step,

    push    = tau / M * (+-F + m l w**2 sin)                     change of velocity, massless pole
    swing   = (tau g sin - cos push) / (l (4/3 - m cos**2 / M))  change of angular velocity
    reaction = m l / M * swing cos                               change of velocity by the pole
"""

from __future__ import annotations

import math
from typing import NamedTuple

from pearl_marl.fixed_point import constant, multiply, reciprocal, saturating_add, sine_cosine
from pearl_marl.golden import Draws, GoldenFunction, Word, i32
from pearl_marl.layout import Signed

FRACTION = 27

GRAVITY, CART_MASS, POLE_MASS, HALF_LENGTH, FORCE, TIME_STEP = 9.8, 1.0, 0.1, 0.5, 10.0, 0.02
MASS = CART_MASS + POLE_MASS
POLE_SHARE = POLE_MASS * HALF_LENGTH / MASS

TURNS = constant(2**5 / (2 * math.pi), 28)  # rad with 27 fraction bits to turns with 32
TAU = constant(TIME_STEP, 36)
PUSH = constant(TIME_STEP * FORCE / MASS, 30)
SPIN = constant(TIME_STEP * POLE_SHARE, 41)
WEIGHT = constant(TIME_STEP * GRAVITY, 30)
SHARE = constant(POLE_SHARE, 35)
FOUR_THIRDS = constant(4 / 3, 30)

# The greatest words that are still inside.
TRACK = math.floor(2.4 * 2**FRACTION)
LEAN = math.floor(12 * 2 * math.pi / 360 * 2**FRACTION)
START = 2 * math.floor(0.05 * 2**FRACTION)


class State(NamedTuple):
    """Position (m), velocity (m/s), angle (rad) and angular velocity (rad/s)."""

    position: Signed[32, FRACTION]
    velocity: Signed[32, FRACTION]
    angle: Signed[32, FRACTION]
    angular_velocity: Signed[32, FRACTION]


def initial(draws: Draws) -> State:
    """Return the state of a new episode: each word uniform between -0.05 and 0.05."""
    # As a signed number a draw is from -1/2 to 1/2.
    return State(*[multiply(i32(draws.bits()), START, 32) for _ in range(4)])


def make_step(last: int) -> GoldenFunction:
    """Return the golden step whose last reward of an episode is of the category ``last``, and others of 0."""

    def step(state: State, action: Word, draws: Draws) -> tuple[State, Word, Word]:
        """Push the cart left (0) or right (1), by one step of Euler's method."""
        x, v, angle, w = state
        sine, cosine = sine_cosine(multiply(angle, TURNS, 28))
        spin = multiply(multiply(w, SPIN, 32), w, 33)
        push = (PUSH if action == 1 else -PUSH) + multiply(spin, sine, 30)
        pole = multiply(cosine, SHARE, 31)  # with 34 fraction bits
        # m cos**2 / M is twice the product, since the half length is 1/2.
        inertia = FOUR_THIRDS - multiply(pole, cosine, 33)
        torque = multiply(sine, WEIGHT, 30) - multiply(cosine, push, 30)
        swing = multiply(torque, reciprocal(inertia), 29)  # divided by the half length, too
        kick = push - multiply(pole, swing, 34)

        x = saturating_add(x, multiply(v, TAU, 36))
        angle = saturating_add(angle, multiply(w, TAU, 36))
        v = saturating_add(v, kick + 4 >> 3)
        w = saturating_add(w, swing + 4 >> 3)
        inside = -TRACK <= x <= TRACK and -LEAN <= angle <= LEAN
        return State(x, v, angle, w), 0 if inside else last, not inside

    return step


def observe(state: State) -> State:
    """Return the observation: the state."""
    return state
