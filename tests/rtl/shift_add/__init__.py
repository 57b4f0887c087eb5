"""An environment with a core of its own, which takes four cycles a slot."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from gymnasium.spaces import Box, Discrete

from pearl_marl.golden import Word, u8, uniform_below
from pearl_marl.spec import EnvSpec, Field, Golden


def initial(value_draw: Word, count_draw: Word) -> tuple[Word, Word]:
    return value_draw & 0xFF, uniform_below(count_draw, 8)


def observe(value: Word, count: Word) -> tuple[Word, Word]:
    return value, (value >> 4) ^ count


def configure(noise: int = 15) -> EnvSpec:
    """``noise`` are the bits that a random draw adds."""

    def step(value: Word, count: Word, action: Word, draw: Word) -> tuple[Word, Word, Word, Word]:
        value = u8(value * action + (draw & noise))
        return value, (count + 1) & 7, value >> 3, (value & 7) == 0

    return EnvSpec(
        name="ShiftAdd",
        version=0,
        summary="Multiply by the action, bit by bit",
        state=(Field("value", 8), Field("count", 3)),
        action=Field("action", 3),
        observation=(Field("value", 8), Field("mixed", 5)),
        reward=Field("reward", 5),
        rewards=None,
        observation_space=Box(0, 255, (2,), np.uint8),
        action_space=Discrete(8),
        golden=Golden(initial, step, observe),
        reset_draws=2,
        step_draws=1,
        options={"noise": noise},
        configure=configure,
        core=Path(__file__).with_name("shift_add_pe.sv"),
    )


SPEC = configure()
