"""The golden step of SimpleTag, by MPE's formulas over reals.

Follows https://mpe2.farama.org/environments/simple_tag/ (``mpe2`` 1.0.0): R. Lowe et al., *Multi-Agent
Actor-Critic for Mixed Cooperative-Competitive Environments*, 2017.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from pearl_marl.envs.particles import MOST, Agent, Landmark, Relative, force_of, moved, push, touch
from pearl_marl.golden import Draws, Word
from pearl_marl.layout import Array, Real
from pearl_marl.spec import Golden

OBSTACLE = 0.2
"""The radius of an obstacle."""
CAUGHT = 10
EDGE = 0.9
"""Agents that are chased pay for places farther from the middle than this, along each axis."""
FAR = 2.2
"""Where that is more than the most that they pay, 10."""


class Role(NamedTuple):
    """What the two sides differ in."""

    size: float
    acceleration: float
    speed: float


ADVERSARY, GOOD = Role(0.075, 3.0, 1.0), Role(0.05, 4.0, 1.3)


class Velocity(NamedTuple):
    """The velocity of an agent."""

    x: Real[-MOST, MOST]
    y: Real[-MOST, MOST]


def limited(agent: Agent, most: float) -> Agent:
    """Return an agent that is no faster than it may be."""
    vx, vy = (np.clip(v, -MOST, MOST) for v in (agent.vx, agent.vy))  # no contacts push as hard as that
    speed = max(math.hypot(vx, vy), most)
    if speed > most:
        vx, vy = vx / speed * most, vy / speed * most
    return agent._replace(vx=vx, vy=vy)


def price_of(place: Any) -> Any:
    """Return what it costs to be at a place, along one axis."""
    x = abs(place)
    if x < EDGE:
        return 0.0
    if x < 1:
        return (x - EDGE) * 10
    return min(math.exp(2 * min(x, FAR) - 2), 10.0)


def make_golden(good: int, adversaries: int, obstacles: int, terminates: bool) -> Golden:
    """Return the golden functions of so many agents, adversaries before good ones, and obstacles."""
    n = adversaries + good
    roles = [ADVERSARY] * adversaries + [GOOD] * good

    class State(NamedTuple):
        agents: Array[Agent, n]
        landmarks: Array[Landmark, obstacles]

    class View(NamedTuple):
        vx: Real[-MOST, MOST]
        vy: Real[-MOST, MOST]
        x: Real[-MOST, MOST]
        y: Real[-MOST, MOST]
        landmarks: Array[Relative, obstacles]
        others: Array[Relative, n - 1]
        velocities: Array[Velocity, good]
        """Of the other good agents; then zeros."""

    def initial(draws: Draws) -> State:
        """Put agents, at rest, and obstacles anywhere."""
        agents = [Agent(draws.uniform(-1, 1), draws.uniform(-1, 1), 0.0, 0.0) for _ in range(n)]
        places = [(draws.uniform(-0.9, 0.9), draws.uniform(-0.9, 0.9)) for _ in range(obstacles)]
        return State(agents, [Landmark(*place) for place in places])

    def step(state: State, actions: list[Any], draws: Draws) -> tuple[State, list[Any], list[Word]]:
        """Move all agents; adversaries share what each touch of a good agent is worth."""
        before = state.agents
        forces = [[force_of(action, role.acceleration)] for action, role in zip(actions, roles, strict=True)]
        for a, role in enumerate(roles):
            for b in range(a + 1, n):
                x, y = push(before[a], before[b], role.size + roles[b].size)
                forces[a].append((x, y))
                forces[b].append((-x, -y))
            forces[a] += [push(before[a], obstacle, role.size + OBSTACLE) for obstacle in state.landmarks]
        agents = [
            limited(moved(agent, forces[k]), role.speed)
            for k, (agent, role) in enumerate(zip(before, roles, strict=True))
        ]
        sizes = ADVERSARY.size + GOOD.size
        touches = [
            sum(touch(prey, hunter, sizes) for hunter in agents[:adversaries])
            for prey in agents[adversaries:]
        ]
        paid = [
            -CAUGHT * caught - price_of(prey.x) - price_of(prey.y)
            for prey, caught in zip(agents[adversaries:], touches, strict=True)
        ]
        over = terminates and all(caught > 0 for caught in touches)
        rewards = [1.0 * CAUGHT * sum(touches)] * adversaries + paid
        return state._replace(agents=agents), rewards, [over] * n

    def observe(state: State, agent: int) -> View:
        """Return what an agent sees: itself, and where everything else is from it."""
        x, y, vx, vy = state.agents[agent]
        others = [*state.landmarks, *state.agents[:agent], *state.agents[agent + 1 :]]
        seen = [Relative(other.x - x, other.y - y) for other in others]
        prey = [state.agents[k] for k in range(adversaries, n) if k != agent]
        velocities = [Velocity(other.vx, other.vy) for other in prey]
        velocities += [Velocity(0.0, 0.0)] * (good - len(prey))
        return View(vx, vy, x, y, seen[:obstacles], seen[obstacles:], velocities)

    return Golden(State, initial, step, observe, view=View)
