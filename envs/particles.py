"""What MPE's environments have in common: discs that are pushed about on a plane, and push each other apart.

Squares of distances are in units of ``1 / FINE``, so that small ones keep their digits.

Follows https://github.com/Farama-Foundation/MPE2 (``mpe2`` 1.0.0): R. Lowe et al., *Multi-Agent Actor-Critic
for Mixed Cooperative-Competitive Environments*, 2017.
"""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from pearl_marl.golden import Word
from pearl_marl.layout import Real

MOST = 16 - 2**-27
"""How far agents get from the middle, along each axis, and how fast."""
DT, DAMPING, CONTACT_FORCE, CONTACT_MARGIN = 0.1, 0.25, 100.0, 0.001
NEAR = 0.5
"""No contact reaches as far along an axis: of the largest discs 0.03 % of MPE's force is left at 0.31."""
FINE = 16
LEAST = 1 / 64
"""The least distance that a force is divided by, in units of ``1 / FINE``: 0 has no direction."""


class Agent(NamedTuple):
    """Where an agent is, and its velocity."""

    x: Real[-MOST, MOST]
    y: Real[-MOST, MOST]
    vx: Real[-MOST, MOST]
    vy: Real[-MOST, MOST]


class Landmark(NamedTuple):
    """Where a landmark is."""

    x: Real[-1, 1]
    y: Real[-1, 1]


class Relative(NamedTuple):
    """Where something is, seen from an agent."""

    x: Real[-2 * MOST, 2 * MOST]
    y: Real[-2 * MOST, 2 * MOST]


def force_of(action: Any, acceleration: float) -> tuple[Any, Any]:
    """Return the force of an action: 1 left, 2 right, 3 down, 4 up, others none; or how much of each."""
    if isinstance(action, tuple):
        _, left, right, down, up = action
    else:
        left, right, down, up = (1.0 * (action == k) for k in range(1, 5))
    return (right - left) * acceleration, (up - down) * acceleration


def square(a: Any, b: Any) -> Any:
    """Return the square of the distance of two places, in units of ``1 / FINE``."""
    return (FINE * (a.x - b.x)) ** 2 + (FINE * (a.y - b.y)) ** 2


def touch(a: Any, b: Any, sizes: float) -> Word:
    """Return whether two discs overlap, given the sum of their radii."""
    return square(a, b) < (FINE * sizes) ** 2


def push(a: Any, b: Any, sizes: float) -> tuple[Any, Any]:
    """Return the force with which a disc ``b`` pushes a disc ``a`` away, given the sum of their radii."""
    x, y = (FINE * np.clip(apart, -NEAR, NEAR) for apart in (a.x - b.x, a.y - b.y))
    distance = math.hypot(x, y)
    force = CONTACT_FORCE / FINE * penetration(FINE * sizes - distance) / max(distance, LEAST)
    return force * x, force * y


def penetration(depth: Any) -> Any:
    """Return how hard discs press that overlap so far: 0 where they do not, with a smooth way in between.

    It is ``log(1 + exp(depth / margin)) * margin``. Both are in units of ``1 / FINE``.
    """
    margin = FINE * CONTACT_MARGIN
    x = math.exp(-abs(depth) / margin)
    # The logarithm of 1 + x is a series in x / (2 + x); what is left out is 1.1e-6 at most.
    x = x / (2 + x)
    square = x * x
    logarithm = 2 * x * (1 + square * (1 / 3 + square * (1 / 5 + square * (1 / 7 + square / 9))))
    return max(depth, 0.0) + margin * logarithm


def moved(disc: Any, forces: Sequence[tuple[Any, Any]]) -> Any:
    """Return a disc after a step under forces."""
    fx, fy = (sum(parts) for parts in zip(*forces, strict=True))
    return disc._replace(
        x=disc.x + disc.vx * DT,
        y=disc.y + disc.vy * DT,
        vx=disc.vx * (1 - DAMPING) + fx * DT,
        vy=disc.vy * (1 - DAMPING) + fy * DT,
    )
