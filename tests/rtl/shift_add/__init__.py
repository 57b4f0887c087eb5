"""An environment with a core of its own, which takes four cycles a slot."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
from gymnasium.spaces import Box, Discrete

from pearl_marl.golden import Draws, Word
from pearl_marl.layout import Bits
from pearl_marl.spec import EnvSpec, Field, Golden


class State(NamedTuple):
    value: Bits[8]
    count: Bits[3]


class View(NamedTuple):
    value: Bits[8]
    mixed: Bits[5]


def initial(draws: Draws) -> State:
    return State(draws.bits() & 0xFF, draws.below(8))


def observe(state: State) -> View:
    return View(state.value, (state.value >> 4) ^ state.count)


def configure(noise: int = 15) -> EnvSpec:
    """``noise`` are the bits that a random draw adds."""

    def step(state: State, action: Word, draws: Draws) -> tuple[State, Word, Word]:
        value = (state.value * action + (draws.bits() & noise)) & 0xFF
        return State(value, (state.count + 1) & 7), value >> 3, (value & 7) == 0

    return EnvSpec(
        name="ShiftAdd",
        version=0,
        summary="Multiply by the action, bit by bit",
        reward=Field("reward", 5),
        rewards=None,
        observation_space=Box(0, 255, (2,), np.uint8),
        action_space=Discrete(8),
        golden=Golden(State, initial, step, observe, view=View),
        options={"noise": noise},
        configure=configure,
        core=Path(__file__).with_name("shift_add_pe.sv"),
    )


SPEC = configure()
