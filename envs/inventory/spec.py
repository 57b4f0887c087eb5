"""The spec of Inventory: or-gymnasium's spaces, and how a chain is drawn."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from gymnasium.spaces import Box, MultiDiscrete

from pearl_marl.spec import EnvSpec, Field, Golden, Peer

from .step import CAPACITY, FRACTION, LEAD, MOST_STORED, PERIODS, State, View, initial, observe, step

BLUE, ORANGE, WIDTH, ROW, UNITS = (40, 85, 200), (240, 150, 40), 120, 24, 4
"""Colours of what a stage has and of what comes to it, the size of a bar, and how many units a pixel is."""


def draw(state: State) -> npt.NDArray[np.uint8]:
    """Draw what each stage has as a bar, and below it upright bars of what comes, the soonest first."""
    picture = np.full((3, 2, ROW, WIDTH, 3), 255, np.uint8)
    cell = WIDTH // max(LEAD)
    for k, coming in enumerate((state.coming_0, state.coming_1, state.coming_2)):
        picture[k, 0, 2:, : -(-state.stored[k] // UNITS)] = BLUE
        for period, units in enumerate(coming):
            height = -(-units * (ROW - 2) // CAPACITY[0])
            picture[k, 1, ROW - height :, cell * period : cell * (period + 1) - 1] = ORANGE
    return picture.reshape(6 * ROW, WIDTH, 3).repeat(2, 0).repeat(2, 1)


def configure() -> EnvSpec:
    """Return the spec; there are no options."""
    return EnvSpec(
        name="Inventory",
        version=0,
        summary="Order goods along a chain of suppliers, neither too few nor too many",
        rewards=None,
        reward=Field("profit", 25, signed=True, fraction=FRACTION),
        observation_space=Box(0, MOST_STORED, (3 + 3 * max(LEAD),), np.int32),
        action_space=MultiDiscrete([most + 1 for most in CAPACITY]),
        golden=Golden(State, initial, step, observe, view=View),
        max_cycles=PERIODS,
        configure=configure,
        peers={"or-gymnasium": Peer("or_gymnasium:InvManagementLostSalesEnv", options=())},
        draw=draw,
        follows="or-gymnasium InvManagement-v1",
        render_modes=("rgb_array",),
    )


SPEC = configure()
