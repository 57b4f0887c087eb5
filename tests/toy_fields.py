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

import numpy as np
from gymnasium.spaces import Box, MultiBinary, MultiDiscrete

from pearl_marl import EnvSpec
from pearl_marl.golden import Word, u8, uniform_below
from pearl_marl.spec import Field, Golden

SIDE = 12
"""Cells of a side of the rover's grid."""
REACH = 4
"""How far it can go, and one more; but its speed is told in hundreds, which takes 9 bits."""


def rover_initial(first: Word, second: Word) -> tuple[Word, ...]:
    return uniform_below(first, SIDE - 1), uniform_below(second, SIDE), 0


def rover_step(
    row: Word, column: Word, steps: Word, direction: Word, speed: Word, draw: Word
) -> tuple[Word, ...]:
    far = (speed >= 100) + (speed >= 200) + (speed >= 300)
    wind = (draw >> 29) == 0
    row = row + np.where(direction == 0, far, 0) - wind
    column = column + np.where(direction == 1, far, 0) - np.where(direction == 2, far, 0)
    over = row >= SIDE - 1
    row, column = np.clip(row, 0, SIDE - 1), np.clip(column, 0, SIDE - 1)
    return row, column, u8(steps + 1), 8 * over - far - 1, over


def rover_observe(row: Word, column: Word, steps: Word) -> tuple[Word, ...]:
    return row, column, steps & 1


ROVER = EnvSpec(
    name="Rover",
    version=0,
    summary="Drive to the last row, in a wind",
    state=(Field("row", 4), Field("column", 4), Field("steps", 8)),
    action=(Field("direction", 2), Field("speed", 9)),
    observation=(Field("row", 4), Field("column", 4), Field("odd", 1)),
    reward=Field("reward", 5, signed=True),
    rewards=None,
    observation_space=MultiDiscrete([SIDE, SIDE, 2]),
    action_space=MultiDiscrete([3, 100 * REACH]),
    golden=Golden(rover_initial, rover_step, rover_observe),
    reset_draws=2,
    step_draws=1,
    max_cycles=20,
)


def lamps_initial(draw: Word) -> tuple[Word, ...]:
    return draw & 1, draw >> 1 & 1, 0


def lamps_step(
    left: Word, middle: Word, right: Word, switch_left: Word, both: Word, switch_right: Word
) -> tuple[Word, ...]:
    left, middle, right = left ^ switch_left, middle ^ both ^ switch_right, right ^ switch_right ^ both
    lit = left + middle + right
    return left, middle, right, lit, lit == 3


def lamps_observe(left: Word, middle: Word, right: Word) -> tuple[Word, ...]:
    return left, middle, right, left ^ right


LAMPS = EnvSpec(
    name="Lamps",
    version=0,
    summary="Switch on three lamps",
    state=(Field("left", 1), Field("middle", 1), Field("right", 1)),
    action=(Field("switch_left", 1), Field("both", 1), Field("switch_right", 1)),
    observation=(Field("left", 1), Field("middle", 1), Field("right", 1), Field("differ", 1)),
    reward=Field("lit", 2),
    rewards=(-1.0, -0.5, -0.25, 2.0),
    observation_space=MultiBinary(4),
    action_space=MultiBinary(3),
    golden=Golden(lamps_initial, lamps_step, lamps_observe),
    reset_draws=1,
    max_cycles=11,
)


def glider_initial(draw: Word) -> tuple[Word, ...]:
    return (draw >> 20) - 2048, 64


def glider_step(place: Word, height: Word, thrust: Word, turn: Word) -> tuple[Word, ...]:
    place = np.clip(place + (turn << 1), -2048, 2047)
    height = np.clip(height + (thrust >> 4) - 5, 0, 255)
    near = (place > -256) & (place < 256)
    return place, height, near + (height == 0) * -2, height == 0


def glider_observe(place: Word, height: Word) -> tuple[Word, ...]:
    return place, height


GLIDER = EnvSpec(
    name="Glider",
    version=0,
    summary="Stay aloft, near the middle",
    state=(Field("place", 12, signed=True), Field("height", 8)),
    action=(Field("thrust", 7, fraction=5), Field("turn", 12, signed=True, fraction=8)),
    observation=(Field("place", 12, signed=True, fraction=10), Field("height", 8, fraction=6)),
    reward=Field("reward", 3, signed=True),
    rewards=None,
    observation_space=Box(np.array([-2, 0], np.float32), np.array([2, 4], np.float32)),
    action_space=Box(np.array([0, -1.5], np.float32), np.array([3, 1.5], np.float32)),
    golden=Golden(glider_initial, glider_step, glider_observe),
    reset_draws=1,
    max_cycles=15,
)


def relay_initial(draw: Word) -> tuple[Word, ...]:
    return draw & 1, draw >> 4 & 7, draw >> 8 & 7


def relay_step(
    holder: Word, first: Word, second: Word, go_0: Word, pass_0: Word, go_1: Word, pass_1: Word
) -> tuple[Word, ...]:
    first, second = (first + go_0 * (holder == 0)) & 15, (second + go_1 * (holder == 1)) & 15
    passes = np.where(holder, pass_1, pass_0) & ((first & 3) == (second & 3))
    over = (first >= 12) | (second >= 12)
    rewards = passes + go_0, 3 * passes - go_1
    return holder ^ passes, first, second, *rewards, over, over


def relay_observe(holder: Word, first: Word, second: Word, agent: int) -> tuple[Word, ...]:
    return (first, second, holder) if agent == 0 else (second, first, holder ^ 1)


RELAY = EnvSpec(
    name="Relay",
    version=0,
    summary="Two runners pass a token on",
    state=(Field("holder", 1), Field("first", 4), Field("second", 4)),
    action=(Field("go", 3), Field("pass_on", 1)),
    observation=(Field("own", 4), Field("other", 4), Field("waits", 1)),
    reward=Field("reward", 5, signed=True, fraction=1),
    rewards=None,
    observation_space=MultiDiscrete([16, 16, 2]),
    action_space=MultiDiscrete([5, 2]),
    golden=Golden(relay_initial, relay_step, relay_observe),
    agents=2,
    reset_draws=1,
    max_cycles=17,
)

FIELDS = (ROVER, LAMPS, GLIDER, RELAY)
