"""The spec of LevelBasedForaging: what the package's options come to, in words."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, TypeAlias, TypeVar

import numpy as np
import numpy.typing as npt
from gymnasium.spaces import Box, Discrete

from pearl_marl.checks import checked_flag, checked_integer, checked_number
from pearl_marl.errors import ArgumentError
from pearl_marl.spec import EnvSpec, Grid, Peer

from .peers import OF_ENVPOOL, choose, make
from .picture import make_draw
from .presets import PRESETS
from .step import LOADED, ForagingRules, make_golden, rewards

SIZES, PLAYERS, FOODS, LEVELS = (3, 32), (1, 16), (1, 16), (1, 255)
MOST_REWARDS = 1 << 16
"""As many as a table of rewards has."""

T = TypeVar("T")
Levels: TypeAlias = int | Sequence[int]


def configure(
    players: int = 2,
    min_player_level: Levels = 1,
    max_player_level: Levels = 2,
    min_food_level: Levels = 1,
    max_food_level: Levels | None = None,
    field_size: Sequence[int] = (8, 8),
    max_num_food: int = 3,
    sight: int | None = None,
    max_episode_steps: int = 50,
    force_coop: bool = False,
    normalize_reward: bool = True,
    grid_observation: bool = False,
    observe_agent_levels: bool = True,
    penalty: float = 0.0,
) -> EnvSpec:
    """Return the spec under the package's keyword arguments; by default it is its ``Foraging-8x8-2p-3f-v3``.

    Parameters
    ----------
    players
        How many play, 1 to 16.
    min_player_level, max_player_level
        A player's level is any from the one to the other. Lists have a level for each player, and who gets
        which is drawn.
    min_food_level, max_food_level
        The same for food. Where the greatest is None, it is the sum of the three lowest players' levels.
    field_size
        Rows and columns, as many of the one as of the other, 3 to 32.
    max_num_food
        How many foods a game starts with, if they find room, 1 to 16.
    sight
        How many cells far a player sees; None is the whole grid.
    max_episode_steps
        The time limit.
    force_coop
        Whether all food is of the greatest level, so that without ``max_food_level`` three have to join.
    normalize_reward
        Whether the rewards of a game whose food is all loaded add up to 1.
    grid_observation
        Only False.
    observe_agent_levels
        Whether players see levels of players.
    penalty
        What it costs to try to load what is too heavy.
    """
    if grid_observation is not False:
        raise ArgumentError(
            f"grid_observation is {grid_observation!r}; only False is possible, as lbforaging 2.0.0 itself "
            "fails to make a space for grids"
        )
    flags = ("force_coop", force_coop), ("normalize_reward", normalize_reward)
    for name, flag in (*flags, ("observe_agent_levels", observe_agent_levels)):
        checked_flag(name, flag)
    penalty = checked_number("penalty", penalty)
    players = checked_integer("players", players, *PLAYERS)
    max_num_food = checked_integer("max_num_food", max_num_food, *FOODS)
    max_episode_steps = checked_integer("max_episode_steps", max_episode_steps, 1, (1 << 32) - 1)
    sight = None if sight is None else checked_integer("sight", sight, 1, 1 << 16)
    size = _size(field_size)
    least_food = _levels("min_food_level", min_food_level, max_num_food)
    most_food = None if max_food_level is None else _levels("max_food_level", max_food_level, max_num_food)
    rules = ForagingRules(
        size=size,
        player_levels=_ranges(
            "player",
            _levels("min_player_level", min_player_level, players),
            _levels("max_player_level", max_player_level, players),
        ),
        food_levels=_ranges("food", least_food, most_food or (None,) * max_num_food),
        greatest_only=force_coop,
        sight=size if sight is None else sight,
        shows_levels=observe_agent_levels,
        normalized=normalize_reward,
    )
    _check_together(rules)
    golden = make_golden(rules)
    return EnvSpec(
        name="LevelBasedForaging",
        version=0,
        summary="Walk on a grid and pick up food, much of it only together",
        rewards=rewards(rules, penalty),
        observation_space=observation_space(rules),
        action_space=Discrete(6),
        golden=golden,
        agents=players,
        max_cycles=max_episode_steps,
        options={
            "players": players,
            "min_player_level": _plain(min_player_level),
            "max_player_level": _plain(max_player_level),
            "min_food_level": _plain(min_food_level),
            "max_food_level": None if max_food_level is None else _plain(max_food_level),
            "field_size": [size, size],
            "max_num_food": max_num_food,
            "sight": sight,
            "max_episode_steps": max_episode_steps,
            "force_coop": force_coop,
            "normalize_reward": normalize_reward,
            "grid_observation": False,
            "observe_agent_levels": observe_agent_levels,
            "penalty": penalty,
        },
        configure=configure,
        peers={
            "EnvPool": Peer("LevelBasedForaging-v0", differs=OF_ENVPOOL),
            "lbforaging": Peer(make, choose=choose),
        },
        presets=PRESETS,
        draw=make_draw(size),
        follows="lbforaging Foraging-8x8-2p-3f-v3",
        render_modes=("rgb_array",),
        grid=grid(rules) if rules.sees_all else None,
    )


def observation_space(rules: ForagingRules) -> Box:
    """Return the package's space of one player's observations."""
    last = rules.size - 1
    low = [-1, -1, 0] * rules.foods + [-1, -1, 0][: 2 + rules.shows_levels] * rules.players
    high = [last, last, rules.most_food] * rules.foods
    high += [last, last, rules.strongest][: 2 + rules.shows_levels] * rules.players
    return Box(np.array(low, np.float32), np.array(high, np.float32), dtype=np.float32)


def grid(rules: ForagingRules) -> Grid:
    """Return where players are who see where they are."""
    row = 3 * rules.foods

    def cell(observations: npt.NDArray[Any]) -> npt.NDArray[Any]:
        places = observations.astype(np.int64)
        return places[:, row] * rules.size + places[:, row + 1]

    return Grid(rules.size, rules.size, cell)


def _size(field_size: object) -> int:
    """Return how many rows and columns there are."""
    sides = list(field_size) if isinstance(field_size, (Sequence, np.ndarray)) else []
    if len(sides) != 2 or sides[0] != sides[1] or isinstance(field_size, str):
        raise ArgumentError(
            f"field_size is {field_size!r}; it must be two equal numbers, as lbforaging's own observations "
            "leave their space on any other grid"
        )
    return checked_integer("field_size", sides[0], *SIZES)


def _levels(name: str, value: Levels, count: int) -> tuple[int, ...]:
    """Return the levels of all players or foods."""
    if not isinstance(value, (Sequence, np.ndarray)):
        return (checked_integer(name, value, *LEVELS),) * count
    if len(value) != count:
        raise ArgumentError(f"{name} is {value!r}; it must be one integer or a list of {count}")
    return tuple(checked_integer(f"{name}[{k}]", level, *LEVELS) for k, level in enumerate(value))


def _ranges(of: str, least: Sequence[int], most: Sequence[T]) -> tuple[tuple[int, T], ...]:
    for k, (low, high) in enumerate(zip(least, most, strict=True)):
        if isinstance(high, int) and low > high:
            raise ArgumentError(f"min_{of}_level {low} is greater than max_{of}_level {high}, of {of} {k}")
    return tuple(zip(least, most, strict=True))


def _check_together(rules: ForagingRules) -> None:
    """Refuse what is possible of each option, and not of all together."""
    if rules.players > rules.size**2:
        raise ArgumentError(
            f"players is {rules.players}; a grid of {rules.size} x {rules.size} has cells for {rules.size**2}"
        )
    lowest = sum(sorted(least for least, _ in rules.player_levels)[:3])
    heaviest = max(least for least, _ in rules.food_levels)
    if not rules.greatest_only and rules.food_levels[0][1] is None and heaviest > lowest:
        raise ArgumentError(
            f"min_food_level is {heaviest}; max_food_level=None, the sum of three players' levels, may "
            f"be {lowest}: give a max_food_level, or a lower min_food_level"
        )
    count = LOADED + math.prod(high - low + 1 for low, high in rules.limits)
    if count > MOST_REWARDS:
        raise ArgumentError(
            f"these levels make {count} rewards and a table has {MOST_REWARDS}; lower max_player_level or "
            "max_food_level, or set normalize_reward=False"
        )


def _plain(levels: Levels) -> int | list[int]:
    """Return what an option is told as."""
    return [int(level) for level in levels] if isinstance(levels, (Sequence, np.ndarray)) else int(levels)


SPEC = configure()
