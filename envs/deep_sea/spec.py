"""The spec of DeepSea: its sizes, and bsuite's actions and observations."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from gymnasium.spaces import Box, Discrete

from pearl_marl.checks import checked_flag, checked_integer, checked_number
from pearl_marl.errors import ArgumentError
from pearl_marl.spec import EnvSpec, Grid, Peer

from .step import make_golden

SIZES = (2, 50)
SEA, DIVER, GOLD, CELL = (225, 238, 250), (40, 85, 200), (240, 200, 60), 24
"""Colours of a picture, and the width of a cell in pixels."""


def configure(
    size: int = 10,
    deterministic: bool = True,
    unscaled_move_cost: float = 0.01,
    randomize_actions: bool = True,
    mapping_seed: int = 42,
) -> EnvSpec:
    """Return the spec under bsuite's keyword arguments; the defaults are those of its ``deep_sea/0``.

    Parameters
    ----------
    size
        The rows and columns of the sea, 2 to 50.
    deterministic
        Must be true: bsuite's windy sea pays normally distributed rewards, which no draw here has.
    unscaled_move_cost
        What ``size`` moves to the right cost, 0 to 1.
    randomize_actions
        Whether the action that moves to the right differs from cell to cell; else it is 1.
    mapping_seed
        Seeds which action that is, 0 to ``2**32 - 1``.
    """
    size = checked_integer("size", size, *SIZES)
    if not checked_flag("deterministic", deterministic):
        raise ArgumentError("deterministic is False; only True is possible: no draw is normally distributed")
    cost = checked_number("unscaled_move_cost", unscaled_move_cost, 0, 1)
    checked_flag("randomize_actions", randomize_actions)
    mapping_seed = checked_integer("mapping_seed", mapping_seed, 0, 2**32 - 1)
    mapping = np.ones((size, size), np.int64)
    if randomize_actions:
        # The generator is bsuite's, and NumPy never changes its numbers.
        mapping = np.random.RandomState(mapping_seed).binomial(1, 0.5, (size, size))
    rights = [sum(int(bit) << k for k, bit in enumerate(row)) for row in mapping]

    def unpack(state: Any, row: Any) -> None:
        """Write a sea with a one where the diver is, and without one below the last row."""
        for cell in range(size * size):
            row[cell] = 0
        if state.row < size:
            row[state.row * size + state.column] = 1

    def draw(state: Any) -> npt.NDArray[np.uint8]:
        """Draw the sea: the diver is blue, the treasure in the lower right cell."""
        picture = np.full((size, size, 3), SEA, np.uint8)
        picture[-1, -1] = GOLD
        if state.row < size:
            picture[state.row, state.column] = DIVER
        return picture.repeat(CELL, 0).repeat(CELL, 1)

    return EnvSpec(
        name="DeepSea",
        version=0,
        summary="Dive along the one way that leads to the treasure",
        rewards=(0.0, -cost / size, 1 - cost / size),
        observation_space=Box(0, 1, (size, size), np.float32),
        action_space=Discrete(2),
        golden=make_golden(size, [*rights, 0]),
        unpack=unpack,
        options={
            "size": size,
            "deterministic": deterministic,
            "unscaled_move_cost": cost,
            "randomize_actions": randomize_actions,
            "mapping_seed": mapping_seed,
        },
        configure=configure,
        peers={
            "gymnax": Peer(
                "DeepSea-bsuite",
                options=("size",),
                parameters=("unscaled_move_cost", "randomize_actions"),
            ),
            "bsuite": "bsuite.environments.deep_sea:DeepSea",
        },
        draw=draw,
        follows="bsuite deep_sea",
        render_modes=("rgb_array",),
        grid=Grid(size, size, lambda observations: observations.reshape(len(observations), -1).argmax(1)),
    )


SPEC = configure()
