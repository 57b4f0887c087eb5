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

from collections.abc import Sequence
from copy import copy
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from gymnasium.spaces import Box, Discrete, Tuple

import pearl_marl
from pearl_marl import EnvSpec
from pearl_marl.golden import Draws, Word
from pearl_marl.layout import Bits, Flag, Signed
from pearl_marl.spec import Field, Golden

from .sampling import KINDS, sampled


class DriftState(NamedTuple):
    """Where the thing is, what moves it on, and two numbers that go round."""

    position: Signed[12, 4]
    fuel: Bits[5]
    serial: Bits[20]
    charge: Bits[33]


class DriftView(NamedTuple):
    """What is seen: the serial number's lower half only."""

    position: Signed[12, 4]
    fuel: Bits[5]
    dither: Signed[10, 9]


def drift_initial(draws: Draws) -> DriftState:
    first, second = draws.bits(), draws.bits()
    fuel = (second * 24 >> 32) + 2
    return DriftState((first >> 21) - 1024, fuel, second >> 12, (first << 1) | (second & 1))


def drift_step(push: int) -> Any:
    def step(state: DriftState, action: Word, draws: Draws) -> tuple[DriftState, Word, Word]:
        draw = draws.bits()
        moved = state.position + (action - 2) * push + (draw >> 27) - 16
        # Wraps around at the 12 bits that the field has, as the hardware's adder does.
        position = ((moved + 2048) & 4095) - 2048
        fuel = (state.fuel - 1) & 31
        serial = (state.serial * 1664525 + 1013904223) & 0xFFFFF
        charge = (state.charge * 3 + (draw & 1)) & 0x1FFFFFFFF
        after = DriftState(position, fuel, serial, charge)
        return after, (position >> 2) - fuel, fuel == 0 or position > 1000

    return step


def drift_observe(state: DriftState) -> DriftView:
    return DriftView(state.position, state.fuel, (state.serial & 0x3FF) - 512)


def configure_drift(push: int = 20, marks: tuple[int, ...] = (1, 2)) -> EnvSpec:
    """Return the spec; ``marks`` does nothing but be an option that JSON has no type for."""
    return EnvSpec(
        name="Drift",
        version=3,
        summary="A signed position drifts until the fuel is spent",
        reward=Field("reward", 16, signed=True, fraction=6),
        rewards=None,
        observation_space=Box(
            np.array([-128, 0, -1], np.float32), np.array([127.9375, 31, 1], np.float32), dtype=np.float32
        ),
        action_space=Discrete(5),
        golden=Golden(DriftState, drift_initial, drift_step(push), drift_observe, view=DriftView),
        max_cycles=12,
        options={"push": push, "marks": marks},
        configure=configure_drift,
    )


class LadderState(NamedTuple):
    """The rung that the climber stands on."""

    rung: Bits[4]


class LadderView(NamedTuple):
    """The same, and whether its number is odd."""

    rung: Bits[4]
    odd: Flag


def ladder_initial(draws: Draws) -> LadderState:
    return LadderState(draws.below(4))


def ladder_step(state: LadderState, action: Word, draws: Draws) -> tuple[LadderState, Word, Word]:
    rung = state.rung
    if action:
        rung = (rung + 1) & 15
    elif rung > 0:
        rung -= 1
    return LadderState(rung), (rung * 3) & 15, rung == 9


def ladder_observe(state: LadderState) -> LadderView:
    return LadderView(state.rung, state.rung & 1)


DRIFT = configure_drift()

LADDER = EnvSpec(
    name="Ladder",
    version=0,
    summary="Climb nine rungs",
    rewards=tuple(1.5 * k - 4.25 for k in range(16)),
    observation_space=Tuple((Discrete(10), Discrete(2))),
    action_space=Discrete(2),
    golden=Golden(LadderState, ladder_initial, ladder_step, ladder_observe, view=LadderView),
)


class SlideState(NamedTuple):
    """Where the thing is."""

    place: Signed[11]


class SlideView(NamedTuple):
    """The same, in two parts of which a picture is made."""

    row: Bits[3]
    column: Bits[7]


def slide_initial(draws: Draws) -> SlideState:
    return SlideState(draws.below(256))


def slide_step(state: SlideState, action: Word, draws: Draws) -> tuple[SlideState, Word, Word]:
    # Three places to either side, which the edges do not stop: 0 to 1023 go round.
    moved = (state.place + action) & 1023
    # Steps back from places below 0, where nothing ever is, wrap around at the 11 bits of the reward.
    return SlideState(moved), ((moved - state.place + 1024) & 2047) - 1024, moved >= 1000


def slide_observe(state: SlideState) -> SlideView:
    return SlideView(state.place >> 7 & 7, state.place & 127)


def slide_unpack(row: Word, column: Word, picture: Word) -> None:
    for k in range(24):
        picture[k] = k == 3 * row + column % 3


SLIDE = EnvSpec(
    name="Slide",
    version=1,
    summary="Push a thing along",
    action=Field("push", 10, signed=True, fraction=6),
    reward=Field("reward", 11, signed=True, fraction=6),
    rewards=None,
    observation_space=Box(0, 1, (4, 2, 3), np.bool_),
    action_space=Box(-1.5, 3, (1,), np.float32),
    golden=Golden(SlideState, slide_initial, slide_step, slide_observe, view=SlideView),
    unpack=slide_unpack,
    max_cycles=9,
)

TOYS = (DRIFT, LADDER, SLIDE)


def with_state(spec: EnvSpec, fields: Sequence[Field]) -> EnvSpec:
    """Return a spec whose state has other fields than its class declares, as many."""
    changed = replace(spec)
    layout = copy(spec.layout)
    layout.fields = tuple(fields)
    vars(changed)["layout"] = layout
    return changed


ENVIRONMENTS = (*sampled(pearl_marl.list_envs(), KINDS), *(spec.name for spec in TOYS))
