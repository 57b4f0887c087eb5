"""The spec of LeducPoker: what the platform has to know besides the dynamics in ``step.py``."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from gymnasium.spaces import Box, Discrete

from pearl_marl.spec import EnvSpec, Field, Golden

from .presets import PRESETS
from .step import MOST_CHIPS, State, initial, masks, observe, step

CARDS, CHIP, CELL = np.array([(40, 85, 200), (240, 150, 40), (205, 45, 45)], np.uint8), (60, 60, 60), 16
"""Colours of a jack, a queen and a king, and of chips; and the width of a cell in pixels."""


def draw(state: State) -> npt.NDArray[np.uint8]:
    """Draw the cards of both players, the third one between them, and below them a column of chips each."""
    picture = np.full((4 + MOST_CHIPS, 3, 3), 255, np.uint8)
    first, second, public = CARDS[list(state.cards)]
    picture[:3] = first, public if state.round else CHIP, second
    for column, chips in zip((0, 2), state.chips, strict=True):
        picture[4 : 4 + chips, column] = CHIP
    return picture.repeat(CELL, 0).repeat(4 * CELL, 1)


def configure() -> EnvSpec:
    """Return the spec; there are no options."""
    return EnvSpec(
        name="LeducPoker",
        version=0,
        summary="Two players hold a card each, see a third, and bet in two rounds",
        reward=Field("reward", 5, signed=True),
        rewards=None,
        observation_space=Box(0, 1, (34,), np.int8),
        action_space=Discrete(3),
        golden=Golden(State, initial, step, observe, masks),
        agents=2,
        turns=True,
        masked="refused",
        configure=configure,
        peers={"EnvPool": "LeducHoldem-v1", "pgx": "leduc_holdem"},
        presets=PRESETS,
        draw=draw,
        follows="pgx leduc_holdem",
        render_modes=("rgb_array",),
    )


SPEC = configure()
