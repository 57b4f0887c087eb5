"""Gymnasium's Acrobot-v1, line by line. Within a step of Runge and Kutta's its speeds are bound, too."""

from typing import Any, NamedTuple

import numpy as np
from gymnasium.spaces import Box, Discrete
from numpy import cos, pi, sin

from pearl_marl.layout import Array, Real
from pearl_marl.spec import EnvSpec, Golden

DT, MAX_VEL_1, MAX_VEL_2 = 0.2, 4 * pi, 9 * pi
G, L1, LC1, LC2, M1, M2, MOI = 9.8, 1.0, 0.5, 0.5, 1.0, 1.0, 1.0
STAGE_1, STAGE_2 = 160.0, 320.0


class State(NamedTuple):
    theta1: Real[-pi, pi]
    theta2: Real[-pi, pi]
    dtheta1: Real[-MAX_VEL_1, MAX_VEL_1]
    dtheta2: Real[-MAX_VEL_2, MAX_VEL_2]  # fmt: skip


class View(NamedTuple):
    angles: Array[Real[-1.0, 1.0], 4]
    dtheta1: Real[-MAX_VEL_1, MAX_VEL_1]
    dtheta2: Real[-MAX_VEL_2, MAX_VEL_2]  # fmt: skip


def initial(draws: Any) -> State:
    return State(*[draws.uniform(-0.1, 0.1) for _ in range(4)])


def step(state: State, action: Any, draws: Any) -> tuple[State, Any, Any]:
    torque = (action - 1) * 1.0
    theta1, theta2, dtheta1, dtheta2 = rk4(state, torque, DT)
    dtheta1, dtheta2 = np.clip(dtheta1, -MAX_VEL_1, MAX_VEL_1), np.clip(dtheta2, -MAX_VEL_2, MAX_VEL_2)
    ns = State(wrap(theta1), wrap(theta2), dtheta1, dtheta2)
    terminated = -cos(ns.theta1) - cos(ns.theta2 + ns.theta1) > 1.0
    return ns, terminated, terminated


def wrap(x: Any) -> Any:
    return (x + pi) % (2 * pi) - pi


def dsdt(s: Any, a: Any) -> tuple[Any, ...]:
    theta1, theta2 = s[0], s[1]
    dtheta1, dtheta2 = np.clip(s[2], -STAGE_1, STAGE_1), np.clip(s[3], -STAGE_2, STAGE_2)
    d1 = M1 * LC1**2 + M2 * (L1**2 + LC2**2 + 2 * L1 * LC2 * cos(theta2)) + MOI + MOI
    d2 = M2 * (LC2**2 + L1 * LC2 * cos(theta2)) + MOI
    phi2 = M2 * LC2 * G * cos(theta1 + theta2 - pi / 2.0)
    phi1 = (
        -M2 * L1 * LC2 * dtheta2**2 * sin(theta2) - 2 * M2 * L1 * LC2 * dtheta2 * dtheta1 * sin(theta2)
        + (M1 * LC1 + M2 * L1) * G * cos(theta1 - pi / 2) + phi2
    )  # fmt: skip
    ddtheta2 = (a + d2 / d1 * phi1 - M2 * L1 * LC2 * dtheta1**2 * sin(theta2) - phi2) / (
        M2 * LC2**2 + MOI - d2**2 / d1
    )
    ddtheta1 = -(d2 * ddtheta2 + phi1) / d1
    return dtheta1, dtheta2, ddtheta1, ddtheta2


def rk4(y0: Any, a: Any, dt: float) -> list[Any]:
    k1 = dsdt(y0, a)
    k2 = dsdt([y + dt / 2.0 * k for y, k in zip(y0, k1, strict=True)], a)
    k3 = dsdt([y + dt / 2.0 * k for y, k in zip(y0, k2, strict=True)], a)
    k4 = dsdt([y + dt * k for y, k in zip(y0, k3, strict=True)], a)
    return [y0[k] + dt / 6.0 * (k1[k] + 2 * k2[k] + 2 * k3[k] + k4[k]) for k in range(4)]


def observe(state: State) -> View:
    t1, t2, dtheta1, dtheta2 = state
    return View([cos(t1), sin(t1), cos(t2), sin(t2)], dtheta1, dtheta2)


HIGH = np.array([1.0, 1.0, 1.0, 1.0, MAX_VEL_1, MAX_VEL_2], np.float32)
SPEC = EnvSpec(
    name="RealAcrobot", version=0, summary="Swing two links up, by Gymnasium's formulas", max_cycles=500,
    rewards=(-1.0, 0.0), observation_space=Box(-HIGH, HIGH), action_space=Discrete(3),
    golden=Golden(State, initial, step, observe, view=View), oracle="Acrobot-v1",
)  # fmt: skip
