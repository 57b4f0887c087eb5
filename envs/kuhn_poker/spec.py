"""The spec of KuhnPoker: what the platform has to know besides the dynamics in ``step.py``."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from gymnasium.spaces import Box, Discrete

from pearl_marl.spec import EnvSpec, Field, Golden

from .presets import PRESETS
from .step import State, initial, masks, observe, step

CARDS, CHIP, CELL = np.array([(40, 85, 200), (240, 150, 40), (205, 45, 45)], np.uint8), (60, 60, 60), 64
"""Colours of a jack, a queen and a king, and of chips; and the width of a cell in pixels."""


def draw(state: State) -> npt.NDArray[np.uint8]:
    """Draw the card of each player, and below it the chip that the player has bet."""
    picture = np.full((2, 2, 3), 255, np.uint8)
    picture[0] = CARDS[list(state.cards)]
    picture[1, np.array(state.bets, np.bool_)] = CHIP
    return picture.repeat(CELL, 0).repeat(CELL, 1)


def configure() -> EnvSpec:
    """Return the spec; there are no options."""
    return EnvSpec(
        name="KuhnPoker",
        version=0,
        summary="Two players hold one card each of three, and bet a chip or pass",
        reward=Field("reward", 3, signed=True),
        rewards=None,
        observation_space=Box(0, 1, (7,), np.int8),
        action_space=Discrete(2),
        golden=Golden(State, initial, step, observe, masks),
        agents=2,
        turns=True,
        masked="refused",
        configure=configure,
        peers={"EnvPool": "KuhnPoker-v1", "pgx": "kuhn_poker"},
        presets=PRESETS,
        draw=draw,
        follows="pgx kuhn_poker",
        render_modes=("rgb_array",),
    )


SPEC = configure()
