"""The spec of Seaquest: its words, its observation as MinAtar shows it, and MinAtar's own renderer."""

from __future__ import annotations

from typing import Any

import numpy as np
from gymnasium import Env
from gymnasium.spaces import Box, Discrete

from pearl_marl.errors import ArgumentError
from pearl_marl.golden import Word
from pearl_marl.spec import EnvSpec, Field, Golden, is_number

from .step import (
    BULLETS,
    CHANCE_BITS,
    ENEMIES,
    LAST_RAMP,
    MOVE_RAMPS,
    SLOWEST_MOVE,
    SLOWEST_SPAWN,
    initial,
    make_step,
    observe,
)

SIZE, CHANNELS = 10, 10
FRONT, BACK, OWN_BULLET, TRAIL, HOSTILE_BULLET, FISH, SUBMARINE, OXYGEN, ABOARD, DIVER = range(CHANNELS)


def _planes(of: str, names: str, places: int) -> tuple[Field, ...]:
    return tuple(Field(f"{of}_{name}", places) for name in names.split())


SUBMARINE_FIELDS = (Field("x", 4), Field("y", 4), Field("facing_right", 1))
RECORDS = (
    # column, row of the board, rightward, alive
    Field("bullet_0", 10),
    Field("bullet_1", 10),
    # column, row of the sea, rightward, alive
    Field("diver_0", 9),
    Field("diver_1", 9),
)
PLACE = "row_0 row_1 row_2 column_0 column_1 column_2 column_3"
ENEMY_PLANES = _planes("enemy", f"alive submarine rightward {PLACE}", ENEMIES)

STATE = (
    Field("last_action", 3),
    *SUBMARINE_FIELDS,
    Field("surfaced", 1),
    Field("oxygen", 8),
    Field("divers", 16, signed=True),
    Field("reload", 3),
    Field("enemy_timer", 5),
    Field("diver_timer", 5),
    Field("ramp", 5),
    *RECORDS,
    *ENEMY_PLANES,
    *_planes("enemy", "move_0 move_1 move_2 fire_0 fire_1 fire_2 fire_3", ENEMIES),
    *_planes("hostile", f"alive rightward {PLACE}", BULLETS),
)

OBSERVATION = (
    *SUBMARINE_FIELDS,
    Field("oxygen_bar", 4),
    Field("aboard", 3),
    *RECORDS,
    *ENEMY_PLANES,
    *_planes("hostile", f"alive {PLACE}", BULLETS),
)


def mark(row: Any, x: int, y: int, channel: int) -> None:
    """Set one element of an observation; nothing where the cell is not on the board."""
    if 0 <= x < SIZE and 0 <= y < SIZE:
        row[(y * SIZE + x) * CHANNELS + channel] = 1


def mark_trail(row: Any, x: int, y: int, rightward: int) -> None:
    """Mark the cell that something came from."""
    mark(row, x - 1 if rightward else x + 1, y, TRAIL)


def unpack(
    x: Word,
    y: Word,
    facing_right: Word,
    bar: Word,
    aboard: Word,
    bullet_0: Word,
    bullet_1: Word,
    diver_0: Word,
    diver_1: Word,
    enemy_alive: Word,
    enemy_submarine: Word,
    enemy_rightward: Word,
    enemy_row_0: Word,
    enemy_row_1: Word,
    enemy_row_2: Word,
    enemy_column_0: Word,
    enemy_column_1: Word,
    enemy_column_2: Word,
    enemy_column_3: Word,
    hostile_alive: Word,
    hostile_row_0: Word,
    hostile_row_1: Word,
    hostile_row_2: Word,
    hostile_column_0: Word,
    hostile_column_1: Word,
    hostile_column_2: Word,
    hostile_column_3: Word,
    row: Any,
) -> None:
    """Write one slot's observation, MinAtar's ``(10, 10, 10)`` of row, column and channel, into ``row``."""
    for k in range(SIZE * SIZE * CHANNELS):
        row[k] = 0
    column, line = int(x), int(y)
    mark(row, column, line, FRONT)
    mark(row, column - 1 if facing_right else column + 1, line, BACK)
    for k in range(bar):
        mark(row, k, SIZE - 1, OXYGEN)
    for k in range(aboard):
        mark(row, SIZE - 2 - k, SIZE - 1, ABOARD)
    for bullet in (int(bullet_0), int(bullet_1)):
        if bullet >> 9:
            mark(row, bullet & 15, bullet >> 4 & 15, OWN_BULLET)
    for diver in (int(diver_0), int(diver_1)):
        if diver >> 8:
            column, line = diver & 15, (diver >> 4 & 7) + 1
            mark(row, column, line, DIVER)
            mark_trail(row, column, line, diver >> 7 & 1)
    left = int(enemy_alive)
    while left:
        bit = left & -left
        left ^= bit
        column = 1 if enemy_column_0 & bit else 0
        column += 2 if enemy_column_1 & bit else 0
        column += 4 if enemy_column_2 & bit else 0
        column += 8 if enemy_column_3 & bit else 0
        line = 2 if enemy_row_0 & bit else 1
        line += 2 if enemy_row_1 & bit else 0
        line += 4 if enemy_row_2 & bit else 0
        mark(row, column, line, SUBMARINE if enemy_submarine & bit else FISH)
        mark_trail(row, column, line, enemy_rightward & bit)
    left = int(hostile_alive)
    while left:
        bit = left & -left
        left ^= bit
        column = 1 if hostile_column_0 & bit else 0
        column += 2 if hostile_column_1 & bit else 0
        column += 4 if hostile_column_2 & bit else 0
        column += 8 if hostile_column_3 & bit else 0
        line = 2 if hostile_row_0 & bit else 1
        line += 2 if hostile_row_1 & bit else 0
        line += 4 if hostile_row_2 & bit else 0
        mark(row, column, line, HOSTILE_BULLET)


def minatar_attributes(state: tuple[int, ...]) -> dict[str, Any]:
    """Return the attributes that MinAtar's ``seaquest.Env`` has in this state, its lists in their order."""
    words = dict(zip((field.name for field in STATE), map(int, state), strict=True))

    def entries(of: str, *names: str) -> list[list[int]]:
        alive = words[f"{of}_alive"]
        return [
            [_number(words, f"{of}_{name}", k) for name in names]
            for k in range(alive.bit_length())
            if alive >> k & 1
        ]

    enemies = entries("enemy", "submarine", "column", "row", "rightward", "move", "fire")
    bullets = [words[f"bullet_{k}"] for k in range(2)]
    divers = [words[f"diver_{k}"] for k in range(2)]
    ramp = words["ramp"]
    return {
        "oxygen": words["oxygen"],
        "diver_count": words["divers"],
        "sub_x": words["x"],
        "sub_y": words["y"],
        "sub_or": bool(words["facing_right"]),
        "f_bullets": [[b & 15, b >> 4 & 15, bool(b >> 8 & 1)] for b in bullets if b >> 9],
        "e_bullets": [[x, y + 1, bool(r)] for x, y, r in entries("hostile", "column", "row", "rightward")],
        "e_fish": [[x, y + 1, bool(r), move] for sub, x, y, r, move, _ in enemies if not sub],
        "e_subs": [[x, y + 1, bool(r), move, fire] for sub, x, y, r, move, fire in enemies if sub],
        "divers": [
            # All divers move at the same time, so their timers follow from that of their appearance.
            [d & 15, (d >> 4 & 7) + 1, bool(d >> 7 & 1), (words["diver_timer"] - 1) % 6]
            for d in divers
            if d >> 8
        ],
        "e_spawn_speed": SLOWEST_SPAWN - min(ramp, LAST_RAMP),
        "e_spawn_timer": words["enemy_timer"],
        "d_spawn_timer": words["diver_timer"],
        "move_speed": SLOWEST_MOVE - min(ramp >> 1, MOVE_RAMPS),
        "ramp_index": ramp,
        "shot_timer": words["reload"],
        "surface": bool(words["surfaced"]),
    }


def _number(words: dict[str, int], name: str, place: int) -> int:
    """Read the number that stands in one place of the planes ``name_0``, ``name_1``, ... or of ``name``."""
    if name in words:
        return words[name] >> place & 1
    planes = (words[plane] for plane in words if plane.startswith(f"{name}_"))
    return sum((plane >> place & 1) << k for k, plane in enumerate(planes))


def pose(oracle: Env[Any, Any], state: tuple[int, ...]) -> None:
    """Put MinAtar's Seaquest into a slot's state, for rendering."""
    game = oracle.game  # type: ignore[attr-defined]
    vars(game.env).update(minatar_attributes(state))
    game.last_action = int(state[0])


def configure(sticky_action_prob: float = 0.1, difficulty_ramping: bool = True) -> EnvSpec:
    """Return the spec under MinAtar's keyword arguments.

    Parameters
    ----------
    sticky_action_prob
        The probability with which the last action is repeated in place of the one given, 0 to 1. It is
        rounded to a multiple of ``2**-28``.
    difficulty_ramping
        Whether surfacing makes enemies faster and more frequent.
    """
    if not is_number(sticky_action_prob) or not 0 <= sticky_action_prob <= 1:
        raise ArgumentError(f"sticky_action_prob is {sticky_action_prob!r}; it must be a number from 0 to 1")
    if not isinstance(difficulty_ramping, bool):
        raise ArgumentError(f"difficulty_ramping is {difficulty_ramping!r}; it must be True or False")
    sticky_below = round(sticky_action_prob * (1 << CHANCE_BITS))
    return EnvSpec(
        name="Seaquest",
        version=0,
        summary="Dive for divers among fish and submarines, and surface before the oxygen is spent",
        state=STATE,
        action=Field("action", 3),
        observation=OBSERVATION,
        reward=Field("reward", 4),
        rewards=None,
        observation_space=Box(0.0, 1.0, (SIZE, SIZE, CHANNELS), np.bool_),
        action_space=Discrete(6),
        golden=Golden(initial, make_step(sticky_below, difficulty_ramping), observe),
        unpack=unpack,
        step_draws=2,
        options={"sticky_action_prob": float(sticky_action_prob), "difficulty_ramping": difficulty_ramping},
        configure=configure,
        oracle="pearl_marl.envs.seaquest.oracle:MinAtar/Seaquest-v1",
        follows="MinAtar Seaquest-v1",
        pose=pose,
        render_modes=("human", "rgb_array"),
    )


SPEC = configure()
