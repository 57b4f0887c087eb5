"""Gymnasium's classic control as an author would write it over reals, with its formulas and its numbers.

Branches are written as :func:`select`, since these functions run without a front end.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from pearl_marl.reals import fraction_for, select

PI = math.pi
TURNED = 12 * 2 * PI / 360


class Control(NamedTuple):
    """An environment: the bounds of its fields and of a real action, how many discrete ones, and a step."""

    bounds: tuple[tuple[float, float], ...]
    step: Any
    actions: int = 0
    action: tuple[float, float] | None = None

    @property
    def fraction(self) -> int:
        return fraction_for(self.bounds)


def cart_pole(state: Any, action: Any) -> tuple[Any, ...]:
    x, x_dot, theta, theta_dot = state
    gravity, masspole, total_mass, length, tau = 9.8, 0.1, 1.0 + 0.1, 0.5, 0.02
    polemass_length = masspole * length
    force = select(action == 1, 10.0, -10.0)
    costheta, sintheta = np.cos(theta), np.sin(theta)
    temp = (force + polemass_length * np.square(theta_dot) * sintheta) / total_mass
    thetaacc = (gravity * sintheta - costheta * temp) / (
        length * (4.0 / 3.0 - masspole * np.square(costheta) / total_mass)
    )
    xacc = temp - polemass_length * thetaacc * costheta / total_mass
    x = x + tau * x_dot
    x_dot = x_dot + tau * xacc
    theta = theta + tau * theta_dot
    theta_dot = theta_dot + tau * thetaacc
    terminated = (x < -2.4) | (x > 2.4) | (theta < -TURNED) | (theta > TURNED)
    return x, x_dot, theta, theta_dot, terminated


def mountain_car(state: Any, action: Any) -> tuple[Any, ...]:
    position, velocity = state
    velocity = velocity + (action - 1) * 0.001 + np.cos(3 * position) * (-0.0025)
    velocity = np.clip(velocity, -0.07, 0.07)
    position = np.clip(position + velocity, -1.2, 0.6)
    velocity = select((position == -1.2) & (velocity < 0), 0, velocity)
    return position, velocity, (position >= 0.5) & (velocity >= 0)


def pendulum(state: Any, u: Any) -> tuple[Any, ...]:
    th, thdot = state
    g, m, length, dt = 10.0, 1.0, 1.0, 0.05
    u = np.clip(u, -2.0, 2.0)
    costs = angle_normalize(th) ** 2 + 0.1 * thdot**2 + 0.001 * (u**2)
    newthdot = thdot + (3 * g / (2 * length) * np.sin(th) + 3.0 / (m * length**2) * u) * dt
    newthdot = np.clip(newthdot, -8.0, 8.0)
    newth = angle_normalize(th + newthdot * dt)
    return newth, newthdot, -costs


def angle_normalize(x: Any) -> Any:
    return ((x + PI) % (2 * PI)) - PI


MAX_VEL_1, MAX_VEL_2 = 4 * PI, 9 * PI
STAGE_1, STAGE_2 = 160.0, 320.0
"""What an author adds to Acrobot: within a step of Runge and Kutta's, velocities are bound, too."""


def acrobot(state: Any, action: Any) -> tuple[Any, ...]:
    torque = (action - 1) * 1.0
    theta1, theta2, dtheta1, dtheta2 = rk4(lambda s: dsdt(s, torque), state, 0.2)
    theta1, theta2 = angle_normalize(theta1), angle_normalize(theta2)
    dtheta1 = np.clip(dtheta1, -MAX_VEL_1, MAX_VEL_1)
    dtheta2 = np.clip(dtheta2, -MAX_VEL_2, MAX_VEL_2)
    terminated = -np.cos(theta1) - np.cos(theta2 + theta1) > 1.0
    return theta1, theta2, dtheta1, dtheta2, terminated


def dsdt(s: Any, a: Any) -> tuple[Any, ...]:
    m1 = m2 = l1 = I1 = I2 = 1.0  # noqa: N806, as Gymnasium has them
    lc1 = lc2 = 0.5
    g = 9.8
    theta1, theta2, dtheta1, dtheta2 = s
    cos, sin = np.cos, np.sin
    dtheta1 = np.clip(dtheta1, -STAGE_1, STAGE_1)
    dtheta2 = np.clip(dtheta2, -STAGE_2, STAGE_2)
    d1 = m1 * lc1**2 + m2 * (l1**2 + lc2**2 + 2 * l1 * lc2 * cos(theta2)) + I1 + I2
    d2 = m2 * (lc2**2 + l1 * lc2 * cos(theta2)) + I2
    phi2 = m2 * lc2 * g * cos(theta1 + theta2 - PI / 2.0)
    phi1 = (
        -m2 * l1 * lc2 * dtheta2**2 * sin(theta2)
        - 2 * m2 * l1 * lc2 * dtheta2 * dtheta1 * sin(theta2)
        + (m1 * lc1 + m2 * l1) * g * cos(theta1 - PI / 2)
        + phi2
    )
    ddtheta2 = (a + d2 / d1 * phi1 - m2 * l1 * lc2 * dtheta1**2 * sin(theta2) - phi2) / (
        m2 * lc2**2 + I2 - d2**2 / d1
    )
    ddtheta1 = -(d2 * ddtheta2 + phi1) / d1
    return dtheta1, dtheta2, ddtheta1, ddtheta2


def rk4(derivs: Any, y0: Any, dt: float) -> tuple[Any, ...]:
    k1 = derivs(y0)
    k2 = derivs(moved(y0, k1, dt / 2.0))
    k3 = derivs(moved(y0, k2, dt / 2.0))
    k4 = derivs(moved(y0, k3, dt))
    return tuple(
        y + dt / 6.0 * (a + 2 * b + 2 * c + d) for y, a, b, c, d in zip(y0, k1, k2, k3, k4, strict=True)
    )


def moved(state: Any, by: Any, dt: float) -> tuple[Any, ...]:
    return tuple(y + dt * k for y, k in zip(state, by, strict=True))


ANGLE = (-PI, PI)
CONTROLS = {
    "CartPole": Control(((-5.0, 5.0),) * 4, cart_pole, actions=2),
    "MountainCar": Control(((-1.2, 0.6), (-0.07, 0.07)), mountain_car, actions=3),
    "Pendulum": Control((ANGLE, (-8.0, 8.0)), pendulum, action=(-2.0, 2.0)),
    "Acrobot": Control((ANGLE, ANGLE, (-MAX_VEL_1, MAX_VEL_1), (-MAX_VEL_2, MAX_VEL_2)), acrobot, actions=3),
}
