"""MinAtar's Breakout with its own control flow, statement by statement, and once more without any branch.

Follows https://github.com/kenjyoung/MinAtar (1.0.15, ``breakout``): K. Young and T. Tian, *MinAtar: An
Atari-Inspired Testbed for Thorough and Reproducible Reinforcement Learning Experiments*, 2019.
"""

from typing import Any, NamedTuple

import numpy as np
from gymnasium.spaces import Box, Discrete

from pearl_marl import EnvSpec
from pearl_marl.golden import Draws, Word
from pearl_marl.layout import Array, Bits, Flag, Range
from pearl_marl.spec import Golden

SIDE = 10
PADDLE, BALL, TRAIL, BRICK = range(4)
LEFT, RIGHT = 1, 3


class State(NamedTuple):
    ball_y: Range[0, 9]
    ball_x: Range[0, 9]
    ball_dir: Bits[2]
    pos: Range[0, 9]
    brick_map: Array[Flag, SIDE, SIDE]
    strike: Flag
    last_x: Range[0, 9]
    last_y: Range[0, 9]


def initial(draws: Draws) -> State:
    ball_start = draws.bits(1)
    ball_x, ball_dir = [(0, 2), (9, 3)][ball_start]
    bricks = [[1 <= y < 4] * SIDE for y in range(SIDE)]
    return State(3, ball_x, ball_dir, 4, bricks, 0, ball_x, 3)


def step(state: State, action: Word, draws: Draws) -> tuple[State, Word, Word]:
    _, ball_x, ball_dir, pos, brick_map, strike, _, _ = state
    r = 0
    terminal = False

    # Resolve player action
    if action == LEFT:
        pos = max(0, pos - 1)
    elif action == RIGHT:
        pos = min(9, pos + 1)

    # Update ball position
    last_x = ball_x
    last_y = state.ball_y
    if ball_dir == 0:
        new_x = ball_x - 1
        new_y = last_y - 1
    elif ball_dir == 1:
        new_x = ball_x + 1
        new_y = last_y - 1
    elif ball_dir == 2:
        new_x = ball_x + 1
        new_y = last_y + 1
    elif ball_dir == 3:
        new_x = ball_x - 1
        new_y = last_y + 1
    # Only a ball that has been lost is in the last row, and from there nothing goes on.
    new_y = min(new_y, 9)

    strike_toggle = False
    if new_x < 0 or new_x > 9:
        if new_x < 0:
            new_x = 0
        if new_x > 9:
            new_x = 9
        ball_dir = [1, 0, 3, 2][ball_dir]
    if new_y < 0:
        new_y = 0
        ball_dir = [3, 2, 1, 0][ball_dir]
    elif brick_map[new_y][new_x] == 1:
        strike_toggle = True
        if not strike:
            r += 1
            strike = True
            brick_map[new_y][new_x] = 0
            new_y = last_y
            ball_dir = [3, 2, 1, 0][ball_dir]
    elif new_y == 9:
        if not any(any(row) for row in brick_map):
            for y in range(1, 4):
                brick_map[y] = [1] * SIDE
        if ball_x == pos:
            ball_dir = [3, 2, 1, 0][ball_dir]
            new_y = last_y
        elif new_x == pos:
            ball_dir = [2, 3, 0, 1][ball_dir]
            new_y = last_y
        else:
            terminal = True

    if not strike_toggle:
        strike = False

    ball_x = new_x
    ball_y = new_y
    return State(ball_y, ball_x, ball_dir, pos, brick_map, strike, last_x, last_y), r, terminal


def step_without_branches(state: State, action: Word, draws: Draws) -> tuple[State, Word, Word]:
    """Do the same by arithmetic on flags, as it had to be written before there were branches."""
    left, right = action == LEFT, action == RIGHT
    pos = state.pos - (left & (state.pos > 0)) + (right & (state.pos < 9))
    last_x, last_y, direction = state.ball_x, state.ball_y, state.ball_dir
    falls = direction >> 1
    rightward = falls ^ (direction & 1)
    off_left, off_right = (rightward == 0) & (last_x == 0), rightward & (last_x == 9)
    new_x = last_x + (rightward & (last_x < 9)) - ((rightward == 0) & (last_x > 0))
    direction = direction ^ (off_left | off_right)
    off_top = (falls == 0) & (last_y == 0)
    new_y = last_y + (falls & (last_y < 9)) - ((falls == 0) & (last_y > 0))
    brick = brick_at(state.brick_map, new_x, new_y) & (off_top == 0)
    hit = brick & (state.strike == 0)
    at_bottom = (new_y == 9) & (off_top == 0) & (brick == 0)
    full = at_bottom & (bits_of(state.brick_map) == 0)
    centre = at_bottom & (last_x == pos)
    corner = at_bottom & (last_x != pos) & (new_x == pos)
    terminal = at_bottom & (centre == 0) & (corner == 0)
    bounced = off_top | hit | centre
    direction = direction ^ (bounced * 3) ^ (corner * 2)
    stays = hit | centre | corner
    new_y = new_y + stays * (last_y - new_y)
    struck_y = last_y + (falls & (last_y < 9)) - ((falls == 0) & (last_y > 0))
    bricks = [
        [
            (brick_map & ((hit & (struck_y == y) & (new_x == x)) == 0)) | (full & (1 <= y < 4))
            for x, brick_map in enumerate(row)
        ]
        for y, row in enumerate(state.brick_map)
    ]
    return State(new_y, new_x, direction, pos, bricks, brick & (brick != 0), last_x, last_y), hit, terminal


def brick_at(brick_map: list[list[Word]], x: Word, y: Word) -> Word:
    return brick_map[y][x]


def bits_of(brick_map: list[list[Word]]) -> Word:
    return sum(sum(bit << x for x, bit in enumerate(row)) for row in brick_map)


def observe(state: State) -> tuple[Word, ...]:
    rows = [sum(bit << x for x, bit in enumerate(row)) for row in state.brick_map]
    return state.ball_y, state.ball_x, state.last_y, state.last_x, state.pos, *rows


class View(NamedTuple):
    ball_y: Bits[4]
    ball_x: Bits[4]
    last_y: Bits[4]
    last_x: Bits[4]
    pos: Bits[4]
    bricks: Array[Bits[SIDE], SIDE]


def unpack(
    ball_y: Any, ball_x: Any, last_y: Any, last_x: Any, pos: Any,
    row_0: Any, row_1: Any, row_2: Any, row_3: Any, row_4: Any,
    row_5: Any, row_6: Any, row_7: Any, row_8: Any, row_9: Any,
    row: Any,
) -> None:  # fmt: skip
    for k in range(4 * SIDE * SIDE):
        row[k] = 0
    row[4 * (SIDE * int(ball_y) + int(ball_x)) + BALL] = 1
    row[4 * (SIDE * 9 + int(pos)) + PADDLE] = 1
    row[4 * (SIDE * int(last_y) + int(last_x)) + TRAIL] = 1
    for y, bricks in enumerate((row_0, row_1, row_2, row_3, row_4, row_5, row_6, row_7, row_8, row_9)):
        for x in range(SIDE):
            row[4 * (SIDE * y + x) + BRICK] = int(bricks) >> x & 1


def spec_of(step: Any = step, name: str = "Breakout") -> EnvSpec:
    return EnvSpec(
        name=name,
        version=0,
        summary="Break bricks with a ball",
        rewards=(0.0, 1.0),
        observation_space=Box(0, 1, (SIDE, SIDE, 4), np.bool_),
        action_space=Discrete(6),
        golden=Golden(State, initial, step, observe, view=View),
        unpack=unpack,
    )
