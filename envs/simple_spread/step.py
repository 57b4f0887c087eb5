"""The golden step of SimpleSpread, by MPE's formulas over reals.

Follows https://mpe2.farama.org/environments/simple_spread/ (``mpe2`` 1.0.0): R. Lowe et al., *Multi-Agent
Actor-Critic for Mixed Cooperative-Competitive Environments*, 2017.
"""

import math
from typing import Any, NamedTuple

from pearl_marl.envs.particles import (
    FINE,
    MOST,
    Agent,
    Landmark,
    Relative,
    force_of,
    moved,
    push,
    square,
    touch,
)
from pearl_marl.golden import Draws, Word
from pearl_marl.layout import Array, Flag, Real
from pearl_marl.spec import Golden

ACCELERATION, SIZES = 5.0, 0.3
"""Of an agent, and the radii of two."""


def make_golden(n: int, local_ratio: float) -> Golden:
    """Return the golden functions of ``n`` agents and landmarks."""

    class State(NamedTuple):
        agents: Array[Agent, n]
        landmarks: Array[Landmark, n]

    class View(NamedTuple):
        vx: Real[-MOST, MOST]
        vy: Real[-MOST, MOST]
        x: Real[-MOST, MOST]
        y: Real[-MOST, MOST]
        landmarks: Array[Relative, n]
        others: Array[Relative, n - 1]
        said: Array[Flag, 2 * (n - 1)]
        """MPE's channel, on which agents are silent here."""

    def initial(draws: Draws) -> State:
        """Put agents, at rest, and landmarks anywhere."""
        agents = [Agent(draws.uniform(-1, 1), draws.uniform(-1, 1), 0.0, 0.0) for _ in range(n)]
        return State(agents, [Landmark(draws.uniform(-1, 1), draws.uniform(-1, 1)) for _ in range(n)])

    def step(state: State, actions: list[Any], draws: Draws) -> tuple[State, list[Any], list[Word]]:
        """Move all agents; the nearer the nearest to each landmark is, the better for all."""
        forces = [[force_of(action, ACCELERATION)] for action in actions]
        pairs = [(a, b) for b in range(n) for a in range(b)]
        for a, b in pairs:
            x, y = push(state.agents[a], state.agents[b], SIZES)
            forces[a].append((x, y))
            forces[b].append((-x, -y))
        agents = [moved(agent, forces[k]) for k, agent in enumerate(state.agents)]
        far = sum(math.sqrt(min(square(agent, mark) for agent in agents)) for mark in state.landmarks) / FINE
        hits = [0] * n
        for a, b in pairs:
            if touch(agents[a], agents[b], SIZES):
                hits[a] += 1
                hits[b] += 1
        rewards = [-far * (1 - local_ratio) - hit * local_ratio for hit in hits]
        return state._replace(agents=agents), rewards, [False] * n

    def observe(state: State, agent: int) -> View:
        """Return what an agent sees: itself, and where everything else is from it."""
        x, y, vx, vy = state.agents[agent]
        others = [*state.landmarks, *state.agents[:agent], *state.agents[agent + 1 :]]
        seen = [Relative(other.x - x, other.y - y) for other in others]
        return View(vx, vy, x, y, seen[:n], seen[n:], [0] * (2 * n - 2))

    return Golden(State, initial, step, observe, view=View)
