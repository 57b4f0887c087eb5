"""The spec of FrozenLake: its maps, its arguments and what the platform has to know."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from gymnasium import Env
from gymnasium.spaces import Discrete

from pearl_marl.checks import checked_choice, checked_flag, checked_number, is_number
from pearl_marl.errors import ArgumentError
from pearl_marl.spec import EnvSpec, Field, Grid

from .step import SIDE, State, make_golden

MAPS = {
    "4x4": ("SFFF", "FHFH", "FFFH", "HFFG"),
    "8x8": (
        "SFFFFFFF",
        "FFFFFFFF",
        "FFFHFFFF",
        "FFFFFHFF",
        "FFFHFFFF",
        "FHHFFFHF",
        "FHFFHFHF",
        "FFFHFFFG",
    ),
}
"""Gymnasium's, by ``map_name``."""

OWN_MAP = (
    "; or give a map of your own as desc "
    "(gymnasium.envs.toy_text.frozen_lake.generate_random_map makes random ones)"
)


def configure(
    desc: Sequence[str] | None = None,
    map_name: str = "4x4",
    is_slippery: bool = True,
    success_rate: float = 1 / 3,
    reward_schedule: Sequence[float] = (1, 0, 0),
) -> EnvSpec:
    """Return the spec under Gymnasium's keyword arguments.

    Parameters
    ----------
    desc
        A map of one's own, which takes precedence over ``map_name``: strings of equal length, up to
        eight of up to eight letters, of ``S`` (start), ``F`` (frozen), ``H`` (hole) and ``G`` (goal).
        An episode starts in one of the ``S``, all alike.
    map_name
        ``"4x4"`` or ``"8x8"``.
    is_slippery
        Whether the ice turns actions.
    success_rate
        How often it does not, 0 to 1. It turns them left and right equally often.
    reward_schedule
        The rewards for reaching a goal, a hole and anything else.
    """
    lake = _map(desc) if desc is not None else MAPS[checked_choice("map_name", map_name, MAPS, OWN_MAP)]
    checked_flag("is_slippery", is_slippery)
    success_rate = checked_number("success_rate", success_rate, 0, 1)
    if (
        isinstance(reward_schedule, str)
        or not isinstance(reward_schedule, (Sequence, np.ndarray))
        or len(reward_schedule) != 3
        or not all(map(is_number, reward_schedule))
    ):
        raise ArgumentError(
            f"reward_schedule is {reward_schedule!r}; it must be three finite numbers: goal, hole, frozen"
        )
    # Gymnasium registers this map under an id of its own, with a time limit of its own.
    eight = desc is None and map_name == "8x8"
    rows, columns = len(lake), len(lake[0])
    return EnvSpec(
        name="FrozenLake",
        version=0,
        summary="Cross a slippery lake to the goal without falling through a hole",
        observation=(Field("cell", 6),),
        rewards=tuple(map(float, reward_schedule)),
        observation_space=Discrete(rows * columns),
        action_space=Discrete(4),
        golden=make_golden(lake, (1 - success_rate) / 2 if is_slippery else 0),
        max_cycles=200 if eight else 100,
        options={
            "desc": None if desc is None else list(lake),
            "map_name": map_name,
            "is_slippery": is_slippery,
            "success_rate": success_rate,
            "reward_schedule": list(map(float, reward_schedule)),
        },
        configure=configure,
        peers={"gymnax": "FrozenLake-misc"},
        oracle="FrozenLake8x8-v1" if eight else "FrozenLake-v1",
        pose=pose,
        render_modes=("human", "rgb_array", "ansi"),
        grid=Grid(rows, columns, cell=np.asarray),
    )


def pose(oracle: Env[Any, Any], state: State) -> None:
    """Put Gymnasium's FrozenLake into a state, for rendering."""
    oracle.s = oracle.ncol * state.row + state.column  # type: ignore[attr-defined]
    oracle.lastaction = None  # type: ignore[attr-defined]


def _map(desc: Sequence[str]) -> tuple[str, ...]:
    """Return a map of the user's, or say what is wrong with it."""
    if isinstance(desc, str) or not isinstance(desc, Sequence) or not all(isinstance(r, str) for r in desc):
        raise ArgumentError(f"desc is {desc!r}; it must be a list of strings, a row each")
    lake = tuple(map(str, desc))
    # Gymnasium takes no lake that is one cell wide.
    if not 1 <= len(lake) <= SIDE or not all(2 <= len(line) <= SIDE for line in lake):
        sizes = ", ".join(map(str, sorted({len(line) for line in lake}))) or "no"
        raise ArgumentError(
            f"desc has {len(lake)} rows of {sizes} cells; possible are 1 to {SIDE} rows of 2 to {SIDE}"
        )
    for row, line in enumerate(lake):
        if len(line) != len(lake[0]):
            raise ArgumentError(
                f"row {row} of desc has {len(line)} cells, row 0 has {len(lake[0])}; make them equally long"
            )
        for letter in line:
            if letter not in "SFHG":
                raise ArgumentError(
                    f"row {row} of desc has the letter {letter!r}; possible are S (start), F (frozen), "
                    "H (hole) and G (goal)"
                )
    if not any("S" in line for line in lake):
        raise ArgumentError("desc has no S; put one where episodes are to start")
    return lake


SPEC = configure()
