"""Gymnasium's CartPole-v1, line by line."""

import math
from typing import Any, NamedTuple

import numpy as np
from gymnasium.spaces import Box, Discrete

from pearl_marl.layout import Real
from pearl_marl.spec import EnvSpec, Golden

GRAVITY, MASSCART, MASSPOLE, LENGTH, FORCE_MAG, TAU = 9.8, 1.0, 0.1, 0.5, 10.0, 0.02
TOTAL_MASS, POLEMASS_LENGTH = MASSPOLE + MASSCART, MASSPOLE * LENGTH
X_LIMIT, THETA_LIMIT = 2.4, 12 * 2 * math.pi / 360


class State(NamedTuple):
    """A cart and its pole; speeds that no episode reaches are cut off."""

    x: Real[-4.8, 4.8]
    x_dot: Real[-15.9, 15.9]
    theta: Real[-0.42, 0.42]
    theta_dot: Real[-15.9, 15.9]


def initial(draws: Any) -> State:
    return State(*[draws.uniform(-0.05, 0.05) for _ in range(4)])


def step(state: State, action: Any, draws: Any) -> tuple[State, Any, Any]:
    x, x_dot, theta, theta_dot = state
    force = FORCE_MAG if action == 1 else -FORCE_MAG
    costheta, sintheta = np.cos(theta), np.sin(theta)
    temp = (force + POLEMASS_LENGTH * np.square(theta_dot) * sintheta) / TOTAL_MASS
    thetaacc = (GRAVITY * sintheta - costheta * temp) / (
        LENGTH * (4.0 / 3.0 - MASSPOLE * np.square(costheta) / TOTAL_MASS)
    )
    xacc = temp - POLEMASS_LENGTH * thetaacc * costheta / TOTAL_MASS
    x = x + TAU * x_dot
    x_dot = x_dot + TAU * xacc
    theta = theta + TAU * theta_dot
    theta_dot = theta_dot + TAU * thetaacc
    terminated = x < -X_LIMIT or x > X_LIMIT or theta < -THETA_LIMIT or theta > THETA_LIMIT
    return State(x, x_dot, theta, theta_dot), 0, terminated


def observe(state: State) -> State:
    return state


HIGH = np.array([4.8, np.inf, 24 * 2 * math.pi / 360, np.inf], np.float32)
SPEC = EnvSpec(
    name="RealCartPole", version=0, summary="Balance a pole, by Gymnasium's formulas", max_cycles=500,
    rewards=(1.0,), observation_space=Box(-HIGH, HIGH), action_space=Discrete(2),
    golden=Golden(State, initial, step, observe, view=State), oracle="CartPole-v1",
)  # fmt: skip
