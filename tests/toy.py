"""Three environments that do what CliffWalking does not, so that the contract is tested beyond it.

``Drift``
    Four state fields of different widths, one of them signed with fraction bits and one wider than
    32 bits; random starts (two draws), a draw in every step, a ``Box`` observation with a fraction,
    rewards that are computed rather than looked up, a time limit of its own, and options.
``Ladder``
    One state field, a ``Tuple`` observation, a reward table too long for a chain of blends, a random
    start, no time limit.
``Slide``
    A ``Box`` of actions, and a picture for an observation that is unpacked from a narrow word.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from gymnasium.spaces import Box, Discrete, Tuple

import pearl_marl
from pearl_marl import EnvSpec
from pearl_marl.golden import Word, uniform_below
from pearl_marl.spec import Field, Golden


def drift_initial(draw_0: Word, draw_1: Word) -> tuple[Word, ...]:
    position = (draw_0 >> 21) - 1024
    fuel = uniform_below(draw_1, 24) + 2
    serial = draw_1 >> 12
    charge = (draw_0 << 1) | (draw_1 & 1)
    return position, fuel, serial, charge


def drift_step(push: int) -> Any:
    def step(
        position: Word, fuel: Word, serial: Word, charge: Word, action: Word, draw: Word
    ) -> tuple[Word, ...]:
        moved = position + (action - 2) * push + (draw >> 27) - 16
        # Wraps around at the 12 bits that the field has, as the hardware's adder does.
        position = ((moved + 2048) & 4095) - 2048
        fuel = (fuel - 1) & 31
        serial = (serial * 1664525 + 1013904223) & 0xFFFFF
        charge = (charge * 3 + (draw & 1)) & 0x1FFFFFFFF
        return position, fuel, serial, charge, (position >> 2) - fuel, (fuel == 0) | (position > 1000)

    return step


def drift_observe(position: Word, fuel: Word, serial: Word, charge: Word) -> tuple[Word, ...]:
    return position, fuel, (serial & 0x3FF) - 512


def configure_drift(push: int = 20, marks: tuple[int, ...] = (1, 2)) -> EnvSpec:
    """Return the spec; ``marks`` does nothing but be an option that JSON has no type for."""
    return EnvSpec(
        name="Drift",
        version=3,
        summary="A signed position drifts until the fuel is spent",
        state=(
            Field("position", 12, signed=True, fraction=4),
            Field("fuel", 5),
            Field("serial", 20),
            Field("charge", 33),
        ),
        action=Field("action", 3),
        observation=(
            Field("position", 12, signed=True, fraction=4),
            Field("fuel", 5),
            Field("dither", 10, signed=True, fraction=9),
        ),
        reward=Field("reward", 16, signed=True, fraction=6),
        rewards=None,
        observation_space=Box(
            np.array([-128, 0, -1], np.float32), np.array([127.9375, 31, 1], np.float32), dtype=np.float32
        ),
        action_space=Discrete(5),
        golden=Golden(drift_initial, drift_step(push), drift_observe),
        reset_draws=2,
        step_draws=1,
        max_cycles=12,
        options={"push": push, "marks": marks},
        configure=configure_drift,
    )


def ladder_initial(draw: Word) -> Word:
    return uniform_below(draw, 4)


def ladder_step(rung: Word, action: Word) -> tuple[Word, ...]:
    rung = (rung + action - ((action == 0) & (rung > 0))) & 15
    return rung, (rung * 3) & 15, rung == 9


def ladder_observe(rung: Word) -> tuple[Word, ...]:
    return rung, rung & 1


DRIFT = configure_drift()

LADDER = EnvSpec(
    name="Ladder",
    version=0,
    summary="Climb nine rungs",
    state=(Field("rung", 4),),
    action=Field("action", 1),
    observation=(Field("rung", 4), Field("odd", 1)),
    reward=Field("reward", 4),
    rewards=tuple(1.5 * k - 4.25 for k in range(16)),
    observation_space=Tuple((Discrete(10), Discrete(2))),
    action_space=Discrete(2),
    golden=Golden(ladder_initial, ladder_step, ladder_observe),
    reset_draws=1,
)


def slide_initial(draw: Word) -> Word:
    return uniform_below(draw, 256)


def slide_step(place: Word, action: Word) -> tuple[Word, ...]:
    # Three places to either side, which the edges do not stop: 0 to 1023 go round.
    moved = (place + action) & 1023
    # Steps back from places below 0, where nothing ever is, wrap around at the 11 bits of the reward.
    return moved, ((moved - place + 1024) & 2047) - 1024, moved >= 1000


def slide_observe(place: Word) -> tuple[Word, ...]:
    return place >> 7 & 7, place & 127


def slide_unpack(row: Word, column: Word, picture: Word) -> None:
    for k in range(24):
        picture[k] = k == 3 * row + column % 3


SLIDE = EnvSpec(
    name="Slide",
    version=1,
    summary="Push a thing along",
    state=(Field("place", 11, signed=True),),
    action=Field("push", 10, signed=True, fraction=6),
    observation=(Field("row", 3), Field("column", 7)),
    reward=Field("reward", 11, signed=True, fraction=6),
    rewards=None,
    observation_space=Box(0, 1, (4, 2, 3), np.bool_),
    action_space=Box(-1.5, 3, (1,), np.float32),
    golden=Golden(slide_initial, slide_step, slide_observe),
    unpack=slide_unpack,
    reset_draws=1,
    max_cycles=9,
)

TOYS = (DRIFT, LADDER, SLIDE)
ENVIRONMENTS = (*pearl_marl.envs(), *(spec.name for spec in TOYS))
