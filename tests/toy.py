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
from pearl_marl.golden import Word, i16, i32, u8, u32, u64, uniform_below
from pearl_marl.spec import Field, Golden


def drift_initial(draw_0: Word, draw_1: Word) -> tuple[Word, ...]:
    position = i16(i16(draw_0 >> u32(21)) - i16(1024))
    fuel = u8(u8(uniform_below(draw_1, 24)) + u8(2))
    serial = u32(draw_1 >> u32(12))
    charge = u64(u64(u64(draw_0) << u64(1)) | u64(draw_1 & u32(1)))
    return position, fuel, serial, charge


def drift_step(push: int) -> Any:
    def step(
        position: Word, fuel: Word, serial: Word, charge: Word, action: Word, draw: Word
    ) -> tuple[Word, ...]:
        thrust = i32(i32(i32(action) - i32(2)) * i32(push))
        kick = i32(i32(draw >> u32(27)) - i32(16))
        moved = i32(i32(i32(position) + thrust) + kick)
        # Wraps around at the 12 bits that the field has, as the hardware's adder does.
        position = i16(i32(i32(i32(moved + i32(2048)) & i32(4095)) - i32(2048)))
        fuel = u8(u8(fuel - u8(1)) & u8(31))
        serial = u32(u32(u32(serial * u32(1664525)) + u32(1013904223)) & u32(0xFFFFF))
        charge = u64(u64(u64(charge * u64(3)) + u64(draw & u32(1))) & u64(0x1FFFFFFFF))
        reward = i16(i16(position >> i16(2)) - i16(fuel))
        terminated = u8(u8(fuel == 0) | u8(position > 1000))
        return position, fuel, serial, charge, reward, terminated

    return step


def drift_observe(position: Word, fuel: Word, serial: Word, charge: Word) -> tuple[Word, ...]:
    return position, fuel, i16(i16(u32(serial & u32(0x3FF))) - i16(512))


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
    return u8(uniform_below(draw, 4))


def ladder_step(rung: Word, action: Word) -> tuple[Word, ...]:
    down = u8(u8(action == 0) & u8(rung > 0))
    rung = u8(u8(rung + u8(action)) - down)
    return rung, u8(u8(rung * u8(3)) & u8(15)), u8(rung == 9)


def ladder_observe(rung: Word) -> tuple[Word, ...]:
    return rung, u8(rung & u8(1))


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
    return i16(uniform_below(draw, 256))


def slide_step(place: Word, action: Word) -> tuple[Word, ...]:
    # Three places to either side, which the edges do not stop: 0 to 1023 go round.
    moved = i16(i16(place + i16(action)) & i16(1023))
    return moved, i16(moved - place), u8(moved >= 1000)


def slide_observe(place: Word) -> tuple[Word, ...]:
    return u8(place >> i16(7)), u8(place & i16(127))


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
