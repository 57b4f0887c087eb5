"""MPE's games beside ours: one step each, from states of random play or from crowds."""

from __future__ import annotations

import itertools
import math
from collections import Counter, defaultdict
from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from pearl_marl import EnvSpec
from pearl_marl.envs import particles_oracle
from pearl_marl.envs.particles import FINE, LEAST
from pearl_marl.porting.oracle import Move, Outcome, Rules, compare, one_by_one

from .fixed import values, words

Array = npt.NDArray[Any]
NEAR = 0.05


def oracle(spec: EnvSpec, game: Any) -> Rules:
    """Return MPE's step from states of ours, whose discs are held at the ends of the fields of ours."""
    limits = {field.name: (field.low, field.high) for field in spec.state}

    def padded(observation: Array) -> Array:
        """Return an observation as long as any agent's of the world."""
        return np.pad(observation, (0, spec.observation_size - len(observation)))

    def step(state: Any, actions: list[Any], draws: list[int]) -> Outcome:
        particles_oracle.pose(game, state)
        game.current_actions = list(actions)
        game._execute_world_step()
        after, agents = {}, game.world.agents
        for k, agent in enumerate(agents):
            for v, vector in (("", agent.state.p_pos), ("v", agent.state.p_vel)):
                for place, axis in enumerate("xy"):
                    name = f"agents_{k}_{v}{axis}"
                    after[name] = vector[place] = np.clip(vector[place], *limits[name])
        return Outcome(
            observations=[padded(game.scenario.observation(agent, game.world)) for agent in agents],
            rewards=[game.rewards[name] for name in game.possible_agents],
            terminated=[game.scenario.is_terminal(game.world)] * len(agents),
            state=after,
            undecided=any(abs(gap) < 1e-6 for gap in gaps(game)),
        )

    return one_by_one(spec, step)


def gaps(game: Any) -> list[float]:
    """Return how far agents are from touching each other, for each two of them."""
    pairs = itertools.combinations(game.world.agents, 2)
    return [math.dist(a.state.p_pos, b.state.p_pos) - a.size - b.size for a, b in pairs]


def crowded(spec: EnvSpec, n: int, side: float) -> list[Array]:
    """Return states of discs at any place of a square in the middle, so that many of them touch."""
    generator, fast = np.random.default_rng(4), 1.5
    ends = [fast if field.name[-2] == "v" else min(side / 2, field.high) for field in spec.state]
    return [words(generator, field, -end, end, n) for field, end in zip(spec.state, ends, strict=True)]


def least_distances(spec: EnvSpec, state: Sequence[Array], obstacles: bool) -> Array:
    """Return the distance of the nearest two discs in each state, of which one at least is an agent."""
    named = {field.name: values(word, field) for field, word in zip(spec.state, state, strict=True)}
    discs = [key.removesuffix("_x") for key in named if key.endswith("_x")]
    pairs = [
        (a, b)
        for a, b in itertools.combinations(discs, 2)
        if a.startswith("agents") and (obstacles or b.startswith("agents"))
    ]
    return np.min(
        [np.hypot(*(named[f"{a}_{axis}"] - named[f"{b}_{axis}"] for axis in "xy")) for a, b in pairs], 0
    )


def errors_of(spec: EnvSpec, move: Move, obstacles: bool = False) -> dict[str, float]:
    """Return the greatest errors of places, speeds and rewards in units of the last place.

    With ``obstacles``, landmarks push agents too. Errors of speeds are over ``1 + (NEAR / distance)**2``, by
    the distance of the nearest two discs: near each other, their places do not tell well in which direction
    they are pushed. Nearer than the least distance that our force is divided by, they are not compared.
    """
    distance = least_distances(spec, move.before, obstacles)
    relative = np.where(distance < LEAST / FINE, np.inf, 1 + (NEAR / distance) ** 2)
    worst: dict[str, float] = defaultdict(float)
    for name, error in move.errors.items():
        kind = name if name in ("reward", "observation") else name.rpartition("_")[2].rstrip("xy") or "place"
        size = error.reshape(len(relative), -1).max(1) / 2.0 ** -spec.state[0].fraction
        by = 1.0 if kind in ("place", "reward") else relative
        worst[kind] = max(worst[kind], float((size / by).max()))
    return worst


def errors_in_play(spec: EnvSpec, game: Any, steps: int, obstacles: bool = False) -> Counter[str]:
    """Return the greatest errors, as :func:`errors_of` has them, in so many steps of random play."""
    n, worst = 10 if steps < 25 else 64, Counter[str]()
    for move in compare(spec, oracle(spec, game), n, steps, seed=2, posed=True, tolerance=math.inf):
        worst |= Counter(errors_of(spec, move, obstacles))
    return worst
