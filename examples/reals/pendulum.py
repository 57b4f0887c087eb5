"""Gymnasium's Pendulum-v1, line by line; the angle is kept within a turn, which its fixed point needs."""

import math
from typing import Any, NamedTuple

import numpy as np
from gymnasium.spaces import Box

from pearl_marl.layout import Real
from pearl_marl.spec import EnvSpec, Golden

MAX_SPEED, MAX_TORQUE, DT, G, M, L = 8.0, 2.0, 0.05, 10.0, 1.0, 1.0


class State(NamedTuple):
    """A pendulum: 0 is upright."""

    th: Real[-math.pi, math.pi]
    thdot: Real[-MAX_SPEED, MAX_SPEED]


class View(NamedTuple):
    """What the agent sees of it."""

    cos: Real[-1.0, 1.0]
    sin: Real[-1.0, 1.0]
    thdot: Real[-MAX_SPEED, MAX_SPEED]


def initial(draws: Any) -> State:
    return State(draws.uniform(-math.pi, math.pi), draws.uniform(-1.0, 1.0))


def angle_normalize(x: Any) -> Any:
    return ((x + math.pi) % (2 * math.pi)) - math.pi


def step(state: State, u: Any, draws: Any) -> tuple[State, Any, Any]:
    th, thdot = state
    u = np.clip(u, -MAX_TORQUE, MAX_TORQUE)
    costs = angle_normalize(th) ** 2 + 0.1 * thdot**2 + 0.001 * (u**2)
    newthdot = thdot + (3 * G / (2 * L) * np.sin(th) + 3.0 / (M * L**2) * u) * DT
    newthdot = np.clip(newthdot, -MAX_SPEED, MAX_SPEED)
    newth = th + newthdot * DT
    return State(angle_normalize(newth), newthdot), -costs, False


def observe(state: State) -> View:
    return View(np.cos(state.th), np.sin(state.th), state.thdot)


HIGH = np.array([1.0, 1.0, MAX_SPEED], np.float32)
SPEC = EnvSpec(
    name="RealPendulum", version=0, summary="Swing a pendulum up, by Gymnasium's formulas", max_cycles=200,
    rewards=None, reward=Real[-16.3, 0.0], action_space=Box(-MAX_TORQUE, MAX_TORQUE, (1,), np.float32),
    observation_space=Box(-HIGH, HIGH), golden=Golden(State, initial, step, observe, view=View),
    oracle="Pendulum-v1",
)  # fmt: skip
