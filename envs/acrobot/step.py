"""The golden step of Acrobot, by Gymnasium's formulas over reals: a step of Runge and Kutta's method.

Within a step speeds may grow far beyond those of a state, so they are bound there, too.

Follows https://gymnasium.farama.org/environments/classic_control/acrobot/ (Acrobot-v1), which follows R. S.
Sutton, *Generalization in Reinforcement Learning: Successful Examples Using Sparse Coarse Coding*, 1996.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy import cos, pi, sin

from pearl_marl.golden import Draws, GoldenFunction, Word
from pearl_marl.layout import Array, Real

DT, MAX_VEL_1, MAX_VEL_2 = 0.2, 4 * pi, 9 * pi
G, L1, LC1, LC2, M1, M2, MOI = 9.8, 1.0, 0.5, 0.5, 1.0, 1.0, 1.0
STAGE_1, STAGE_2 = 160.0, 320.0
"""The greatest speeds within a step, in rad/s."""


class State(NamedTuple):
    """The angle of the first link, 0 where it hangs, that of the second to it, and their speeds."""

    theta1: Real[-pi, pi]
    theta2: Real[-pi, pi]
    dtheta1: Real[-MAX_VEL_1, MAX_VEL_1]
    dtheta2: Real[-MAX_VEL_2, MAX_VEL_2]  # fmt: skip


class View(NamedTuple):
    """The cosine and the sine of each angle, and the speeds."""

    angles: Array[Real[-1.0, 1.0], 4]
    dtheta1: Real[-MAX_VEL_1, MAX_VEL_1]
    dtheta2: Real[-MAX_VEL_2, MAX_VEL_2]  # fmt: skip


def initial(draws: Draws) -> State:
    """Return the state of a new episode: nearly hanging, nearly at rest."""
    return State(*[draws.uniform(-0.1, 0.1) for _ in range(4)])


def make_step(nips: bool) -> GoldenFunction:
    """Return the golden step by the equations of the book, or by those of the paper (``nips``)."""

    def step(state: State, action: Word, draws: Draws) -> tuple[State, Word, Word]:
        """Apply a torque of -1, 0 or 1 N m for 0.2 s; the category of the reward is 1 at the goal."""
        # Two bits hold a fourth action, which is the third.
        theta1, theta2, dtheta1, dtheta2 = rk4(state, (min(action, 2) - 1) * 1.0, nips)
        dtheta1, dtheta2 = np.clip(dtheta1, -MAX_VEL_1, MAX_VEL_1), np.clip(dtheta2, -MAX_VEL_2, MAX_VEL_2)
        after = State(wrap(theta1), wrap(theta2), dtheta1, dtheta2)
        terminated = -cos(after.theta1) - cos(after.theta2 + after.theta1) > 1.0
        return after, terminated, terminated

    return step


def wrap(x: Any) -> Any:
    """Return an angle within a turn."""
    return (x + pi) % (2 * pi) - pi


def dsdt(s: Any, a: Any, nips: bool) -> tuple[Any, ...]:
    """Return how fast a state changes under a torque."""
    theta1, theta2 = s[0], s[1]
    dtheta1, dtheta2 = np.clip(s[2], -STAGE_1, STAGE_1), np.clip(s[3], -STAGE_2, STAGE_2)
    d1 = M1 * LC1**2 + M2 * (L1**2 + LC2**2 + 2 * L1 * LC2 * cos(theta2)) + MOI + MOI
    d2 = M2 * (LC2**2 + L1 * LC2 * cos(theta2)) + MOI
    phi2 = M2 * LC2 * G * cos(theta1 + theta2 - pi / 2.0)
    phi1 = (
        -M2 * L1 * LC2 * dtheta2**2 * sin(theta2) - 2 * M2 * L1 * LC2 * dtheta2 * dtheta1 * sin(theta2)
        + (M1 * LC1 + M2 * L1) * G * cos(theta1 - pi / 2) + phi2
    )  # fmt: skip
    centripetal = 0.0 if nips else M2 * L1 * LC2 * dtheta1**2 * sin(theta2)
    ddtheta2 = (a + d2 / d1 * phi1 - centripetal - phi2) / (M2 * LC2**2 + MOI - d2**2 / d1)
    ddtheta1 = -(d2 * ddtheta2 + phi1) / d1
    return dtheta1, dtheta2, ddtheta1, ddtheta2


def rk4(y0: Any, a: Any, nips: bool) -> list[Any]:
    """Return the state after ``DT`` seconds under a torque."""
    k1 = dsdt(y0, a, nips)
    k2 = dsdt([y + DT / 2.0 * k for y, k in zip(y0, k1, strict=True)], a, nips)
    k3 = dsdt([y + DT / 2.0 * k for y, k in zip(y0, k2, strict=True)], a, nips)
    k4 = dsdt([y + DT * k for y, k in zip(y0, k3, strict=True)], a, nips)
    return [y0[k] + DT / 6.0 * (k1[k] + 2 * k2[k] + 2 * k3[k] + k4[k]) for k in range(4)]


def observe(state: State) -> View:
    """Return what the agent sees."""
    t1, t2, dtheta1, dtheta2 = state
    return View([cos(t1), sin(t1), cos(t2), sin(t2)], dtheta1, dtheta2)
