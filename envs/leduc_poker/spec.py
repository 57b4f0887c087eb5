"""The spec of LeducPoker: what the platform has to know besides the dynamics in ``step.py``."""

from __future__ import annotations

import numpy as np
from gymnasium.spaces import Box, Discrete

from pearl_marl.spec import EnvSpec, Field, Golden

from .step import State, initial, masks, observe, step


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
        follows="pgx leduc_holdem",
    )


SPEC = configure()
