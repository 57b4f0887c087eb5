"""The spec of Pursuit: what the platform has to know besides the dynamics in ``step.py``."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from gymnasium.spaces import Box, Discrete

from pearl_marl.checks import checked_flag, checked_integer, checked_number
from pearl_marl.errors import ArgumentError
from pearl_marl.spec import EnvSpec

from .rules import PursuitRules
from .step import make_golden

SIZES, PURSUERS, EVADERS, WINDOWS = (4, 16), (2, 16), (1, 32), (3, 15)
CELL = 24
"""Width and height of a cell, in pixels."""
GROUND, BUILDING, EVADER, PURSUER = (235, 235, 235), (110, 110, 110), (40, 85, 200), (205, 45, 45)
MOST_REWARDS = 1 << 16
"""As many as a table of rewards has."""


def configure(
    x_size: int = 8,
    y_size: int = 8,
    shared_reward: bool = True,
    n_evaders: int = 6,
    n_pursuers: int = 4,
    obs_range: int = 7,
    n_catch: int = 2,
    freeze_evaders: bool = False,
    tag_reward: float = 0.01,
    catch_reward: float = 5.0,
    urgency_reward: float = -0.1,
    surround: bool = True,
) -> EnvSpec:
    """Return the spec under the package's keyword arguments, with a smaller map by default.

    Parameters
    ----------
    x_size, y_size
        The size of the map, 4 to 16.
    shared_reward
        Whether all get the mean of the rewards.
    n_evaders
        How many there are to catch, 1 to 32.
    n_pursuers
        How many agents there are, 2 to 16.
    obs_range
        How many cells wide and high an agent's window is, an odd number from 3 to 15.
    n_catch
        How many pursuers it takes where an evader is, without ``surround``.
    freeze_evaders
        Whether evaders stay where they are.
    tag_reward, catch_reward
        What it is worth to be beside an evader, and to catch some.
    urgency_reward
        What each step is worth.
    surround
        Whether an evader is caught once it is surrounded.
    """
    rules = PursuitRules(
        x_size=checked_integer("x_size", x_size, *SIZES),
        y_size=checked_integer("y_size", y_size, *SIZES),
        n_pursuers=checked_integer("n_pursuers", n_pursuers, *PURSUERS),
        n_evaders=checked_integer("n_evaders", n_evaders, *EVADERS),
        obs_range=checked_integer("obs_range", obs_range, *WINDOWS),
        n_catch=checked_integer("n_catch", n_catch, 1, PURSUERS[1]),
        surround=checked_flag("surround", surround),
        freeze_evaders=checked_flag("freeze_evaders", freeze_evaders),
        shared_reward=checked_flag("shared_reward", shared_reward),
    )
    if obs_range % 2 == 0:
        raise ArgumentError(f"obs_range is {obs_range}; it must be odd, so that an agent is in the middle")
    if n_catch > n_pursuers and not surround:
        raise ArgumentError(f"n_catch is {n_catch}, and there are {n_pursuers} pursuers; it must be no more")
    crowd, room = 5 * max(n_evaders - 1, n_pursuers - 1), rules.open_cells
    if crowd >= room:
        raise ArgumentError(
            f"n_pursuers is {n_pursuers} and n_evaders {n_evaders}; on a map of {x_size} x {y_size} there is "
            f"always a place for {(room - 1) // 5 + 1} of each that start apart: take fewer or a larger map"
        )
    worths = [
        checked_number(name, worth, -1000, 1000)
        for name, worth in (
            ("tag_reward", tag_reward),
            ("catch_reward", catch_reward),
            ("urgency_reward", urgency_reward),
        )
    ]
    if rules.categories > MOST_REWARDS:
        raise ArgumentError(
            f"n_pursuers is {n_pursuers} and n_evaders {n_evaders}; their shared reward has "
            f"{rules.categories:,} values, and a table {MOST_REWARDS:,}: take fewer, or shared_reward=False"
        )

    def draw(state: Any) -> npt.NDArray[np.uint8]:
        """Draw the map, with x to the right; above in a cell the evaders, and below them the pursuers."""
        (first_x, last_x), (first_y, last_y) = rules.building
        picture = np.zeros((y_size, CELL, x_size, CELL, 3), np.uint8)
        picture[:, :-1, :, :-1] = GROUND
        picture[first_y : last_y + 1, :, first_x : last_x + 1] = BUILDING
        for evader in state.evaders:
            if evader.free:
                picture[evader.y, 4 : CELL // 2 - 1, evader.x, 4:-5] = EVADER
        for pursuer in state.pursuers:
            picture[pursuer.y, CELL // 2 + 1 : -5, pursuer.x, 4:-5] = PURSUER
        return picture.reshape(y_size * CELL, x_size * CELL, 3)

    return EnvSpec(
        name="Pursuit",
        version=0,
        summary="Surround evaders, who walk around a building",
        rewards=rules.rewards(*worths),
        observation_space=Box(0, max(n_pursuers, n_evaders), (obs_range, obs_range, 3), np.float32),
        action_space=Discrete(5),
        golden=make_golden(rules),
        unpack=make_unpack(rules),
        agents=n_pursuers,
        max_cycles=500,
        options={
            "x_size": x_size,
            "y_size": y_size,
            "shared_reward": shared_reward,
            "n_evaders": n_evaders,
            "n_pursuers": n_pursuers,
            "obs_range": obs_range,
            "n_catch": n_catch,
            "freeze_evaders": freeze_evaders,
            "tag_reward": worths[0],
            "catch_reward": worths[1],
            "urgency_reward": worths[2],
            "surround": surround,
        },
        configure=configure,
        peers={"PettingZoo": "pettingzoo.sisl.pursuit_v5:parallel_env"},
        draw=draw,
        follows="PettingZoo pursuit_v5",
        render_modes=("rgb_array",),
        render_fps=5,
    )


def make_unpack(rules: PursuitRules) -> Any:
    """Return the function that writes an agent's window: walls, pursuers and evaders of each cell."""
    side, around = rules.obs_range, rules.obs_range // 2
    cells, first, last = side * side, -around, around + 1
    (first_x, last_x), (first_y, last_y) = rules.building
    x_size, y_size = rules.x_size, rules.y_size
    others, evaders = rules.n_pursuers - 1, rules.n_evaders

    def unpack(view: Any, row: Any) -> None:
        at = 0
        for y in range(int(view.y) + first, int(view.y) + last):
            for x in range(int(view.x) + first, int(view.x) + last):
                inside = 0 <= x < x_size and 0 <= y < y_size
                row[at] = not inside or (first_x <= x <= last_x and first_y <= y <= last_y)
                row[at + 1] = row[at + 2] = 0
                at += 3
        row[3 * (cells // 2) + 1] = 1
        for k in range(others):
            if view.pursuers[k] < cells:
                row[3 * int(view.pursuers[k]) + 1] += 1
        for k in range(evaders):
            if view.evaders[k] < cells:
                row[3 * int(view.evaders[k]) + 2] += 1

    return unpack


SPEC = configure()
