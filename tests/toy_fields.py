"""Environments whose actions have several fields, and whose observations are several numbers or flags.

``Rover``
    A grid with a wind, on which a ``MultiDiscrete`` action is a direction and how far to go; one observes a
    ``MultiDiscrete``. Its fields have 2 and 9 bits, so that they are not of one dtype on the host.
``Lamps``
    A ``MultiBinary`` action switches lamps over, of which one observes a ``MultiBinary``. Who has them all
    on is done.
``Glider``
    A ``Box`` of thrust and turn, of different bounds, fractions and signs.
``Relay``
    A world of two agents, each with a ``MultiDiscrete`` action, who pass a token on.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from gymnasium.spaces import Box, MultiBinary, MultiDiscrete

from pearl_marl import EnvSpec
from pearl_marl.golden import Draws, Word, u8
from pearl_marl.layout import Bits, Flag, Signed
from pearl_marl.spec import Field, Golden

SIDE = 12
"""Cells of a side of the rover's grid."""
REACH = 4
"""How far it can go, and one more; but its speed is told in hundreds, which takes 9 bits."""


class Rover(NamedTuple):
    row: Bits[4]
    column: Bits[4]
    steps: Bits[8]


class RoverView(NamedTuple):
    row: Bits[4]
    column: Bits[4]
    odd: Flag


def rover_initial(draws: Draws) -> Rover:
    return Rover(draws.below(SIDE - 1), draws.below(SIDE), 0)


def rover_step(state: Rover, action: Any, draws: Draws) -> tuple[Rover, Word, Word]:
    direction, speed = action
    far = (speed >= 100) + (speed >= 200) + (speed >= 300)
    row, column = state.row - (draws.bits(3) == 0), state.column
    if direction == 0:
        row = row + far
    elif direction == 1:
        column = column + far
    elif direction == 2:
        column = column - far
    over = row >= SIDE - 1
    row, column = min(max(row, 0), SIDE - 1), min(max(column, 0), SIDE - 1)
    return Rover(row, column, u8(state.steps + 1)), 8 * over - far - 1, over


def rover_observe(state: Rover) -> RoverView:
    return RoverView(state.row, state.column, state.steps & 1)


ROVER = EnvSpec(
    name="Rover",
    version=0,
    summary="Drive to the last row, in a wind",
    action=(Field("direction", 2), Field("speed", 9)),
    reward=Field("reward", 5, signed=True),
    rewards=None,
    observation_space=MultiDiscrete([SIDE, SIDE, 2]),
    action_space=MultiDiscrete([3, 100 * REACH]),
    golden=Golden(Rover, rover_initial, rover_step, rover_observe, view=RoverView),
    max_cycles=20,
)


class Lamps(NamedTuple):
    left: Flag
    middle: Flag
    right: Flag


def lamps_initial(draws: Draws) -> Lamps:
    draw = draws.bits()
    return Lamps(draw & 1, draw >> 1 & 1, 0)


def lamps_step(state: Lamps, action: Any, draws: Draws) -> tuple[Lamps, Word, Word]:
    switch_left, both, switch_right = action
    left, middle = state.left ^ switch_left, state.middle ^ both ^ switch_right
    right = state.right ^ switch_right ^ both
    lit = left + middle + right
    return Lamps(left, middle, right), lit, lit == 3


def lamps_observe(state: Lamps) -> tuple[Word, ...]:
    return (*state, state.left ^ state.right)


LAMPS = EnvSpec(
    name="Lamps",
    version=0,
    summary="Switch on three lamps",
    action=(Field("switch_left", 1), Field("both", 1), Field("switch_right", 1)),
    rewards=(-1.0, -0.5, -0.25, 2.0),
    observation_space=MultiBinary(4),
    action_space=MultiBinary(3),
    golden=Golden(Lamps, lamps_initial, lamps_step, lamps_observe),
    max_cycles=11,
)


class Glider(NamedTuple):
    place: Signed[12]
    height: Bits[8]


class GliderView(NamedTuple):
    place: Signed[12, 10]
    height: Bits[8, 6]


def glider_initial(draws: Draws) -> Glider:
    return Glider(draws.bits(12) - 2048, 64)


def glider_step(state: Glider, action: Any, draws: Draws) -> tuple[Glider, Word, Word]:
    thrust, turn = action
    place = min(max(state.place + (turn << 1), -2048), 2047)
    height = min(max(state.height + (thrust >> 4) - 5, 0), 255)
    near = -256 < place < 256
    return Glider(place, height), near + (height == 0) * -2, height == 0


def glider_observe(state: Glider) -> GliderView:
    return GliderView(*state)


GLIDER = EnvSpec(
    name="Glider",
    version=0,
    summary="Stay aloft, near the middle",
    action=(Field("thrust", 7, fraction=5), Field("turn", 12, signed=True, fraction=8)),
    reward=Field("reward", 3, signed=True),
    rewards=None,
    observation_space=Box(np.array([-2, 0], np.float32), np.array([2, 4], np.float32)),
    action_space=Box(np.array([0, -1.5], np.float32), np.array([3, 1.5], np.float32)),
    golden=Golden(Glider, glider_initial, glider_step, glider_observe, view=GliderView),
    max_cycles=15,
)


class Relay(NamedTuple):
    holder: Flag
    first: Bits[4]
    second: Bits[4]


class RelayView(NamedTuple):
    own: Bits[4]
    other: Bits[4]
    waits: Flag


def relay_initial(draws: Draws) -> Relay:
    draw = draws.bits()
    return Relay(draw & 1, draw >> 4 & 7, draw >> 8 & 7)


def relay_step(state: Relay, actions: Any, draws: Draws) -> tuple[Relay, list[Word], list[Word]]:
    (go_0, pass_0), (go_1, pass_1) = actions
    holder, first, second = state
    first, second = (first + go_0 * (holder == 0)) & 15, (second + go_1 * (holder == 1)) & 15
    passes = (pass_1 if holder else pass_0) & ((first & 3) == (second & 3))
    over = first >= 12 or second >= 12
    return Relay(holder ^ passes, first, second), [passes + go_0, 3 * passes - go_1], [over, over]


def relay_observe(state: Relay, agent: int) -> RelayView:
    holder, first, second = state
    return RelayView(first, second, holder) if agent == 0 else RelayView(second, first, holder ^ 1)


RELAY = EnvSpec(
    name="Relay",
    version=0,
    summary="Two runners pass a token on",
    action=(Field("go", 3), Field("pass_on", 1)),
    reward=Field("reward", 5, signed=True, fraction=1),
    rewards=None,
    observation_space=MultiDiscrete([16, 16, 2]),
    action_space=MultiDiscrete([5, 2]),
    golden=Golden(Relay, relay_initial, relay_step, relay_observe, view=RelayView),
    agents=2,
    max_cycles=17,
)

FIELDS = (ROVER, LAMPS, GLIDER, RELAY)
