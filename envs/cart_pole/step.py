"""The golden step of CartPole, in fixed point.

Follows https://gymnasium.farama.org/environments/classic_control/cart_pole/ (CartPole-v1), which
follows Barto, Sutton and Anderson, *Neuronlike adaptive elements that can solve difficult learning
control problems*, 1983, with the equations corrected by Florian,
https://coneural.org/florian/papers/05_cart_pole.pdf.

The state's four words are position (m), velocity (m/s), angle (rad) and angular velocity (rad/s)
with 27 fraction bits. The equations are arranged so that every intermediate word is below 2,
whatever the state, and has 30 fraction bits: with the time step inside, accelerations are the
changes of a velocity in one step,

    push    = tau / M * (+-F + m l w**2 sin)                     change of velocity, massless pole
    swing   = (tau g sin - cos push) / (l (4/3 - m cos**2 / M))  change of angular velocity
    reaction = m l / M * swing cos                               change of velocity by the pole
"""

from __future__ import annotations

import math

import numpy as np

from pearl_marl.fixed_point import constant, multiply, reciprocal, saturating_add, sine_cosine
from pearl_marl.golden import Word, i32

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


def initial(draw_0: Word, draw_1: Word, draw_2: Word, draw_3: Word) -> tuple[Word, Word, Word, Word]:
    """Return the state of a new episode: each word uniform between -0.05 and 0.05."""
    return start(draw_0), start(draw_1), start(draw_2), start(draw_3)


def start(draw: Word) -> Word:
    """Spread a draw over -0.05 .. 0.05."""
    return multiply(i32(draw), START, 32)  # as a signed number a draw is from -1/2 to 1/2


def advance(x: Word, v: Word, angle: Word, w: Word, action: Word) -> tuple[Word, ...]:
    """Take one step of Euler's method; return the four words and whether the episode is over."""
    sine, cosine = sine_cosine(multiply(angle, TURNS, 28))
    spin = multiply(multiply(w, SPIN, 32), w, 33)
    push = np.where(action == 1, PUSH, -PUSH) + multiply(spin, sine, 30)
    pole = multiply(cosine, SHARE, 31)  # with 34 fraction bits
    # m cos**2 / M is twice the product, since the half length is 1/2.
    inertia = FOUR_THIRDS - multiply(pole, cosine, 33)
    torque = multiply(sine, WEIGHT, 30) - multiply(cosine, push, 30)
    swing = multiply(torque, reciprocal(inertia), 29)  # divided by the half length, too
    kick = push - multiply(pole, swing, 34)

    moved = saturating_add(x, multiply(v, TAU, 36))
    turned = saturating_add(angle, multiply(w, TAU, 36))
    v = saturating_add(v, (kick + 4) >> 3)
    w = saturating_add(w, (swing + 4) >> 3)
    off_track = (moved > TRACK) | (moved < -TRACK)
    fallen = (turned > LEAN) | (turned < -LEAN)
    return moved, v, turned, w, off_track | fallen


def step(x: Word, v: Word, angle: Word, w: Word, action: Word) -> tuple[Word, ...]:
    """Push the cart left (0) or right (1); return the state, the reward's category and the end.

    The one category, 0, is that of every step, the last one too.
    """
    x, v, angle, w, terminated = advance(x, v, angle, w, action)
    return x, v, angle, w, 0, terminated


def step_sutton_barto(x: Word, v: Word, angle: Word, w: Word, action: Word) -> tuple[Word, ...]:
    """Do the same; the category is 1 for the step that ends the episode."""
    x, v, angle, w, terminated = advance(x, v, angle, w, action)
    return x, v, angle, w, terminated, terminated


def observe(x: Word, v: Word, angle: Word, w: Word) -> tuple[Word, Word, Word, Word]:
    """Return the observation: the state."""
    return x, v, angle, w
