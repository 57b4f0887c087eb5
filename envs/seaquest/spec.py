"""The spec of Seaquest: its observation as MinAtar shows it, and MinAtar's own renderer."""

from __future__ import annotations

from typing import Any

from pearl_marl.envs.minatar import SIDE, checked_options, spec_parts
from pearl_marl.envs.minatar_planes import number
from pearl_marl.planes import BoardCells, mark, mark_moving
from pearl_marl.spec import EnvSpec, Field, Golden

from .presets import PRESETS
from .step import (
    CHANCE_BITS,
    DEEPEST,
    LAST_RAMP,
    MAX_DIVERS,
    MOVE_RAMPS,
    SLOWEST_MOVE,
    SLOWEST_SPAWN,
    State,
    View,
    initial,
    make_step,
    observe,
)

CHANNELS = 10
SEA = BoardCells(DEEPEST, SIDE, SIDE * CHANNELS, CHANNELS)
FRONT, BACK, OWN_BULLET, TRAIL, HOSTILE_BULLET, FISH, SUBMARINE, OXYGEN, ABOARD, DIVER = range(CHANNELS)


def mark_cell(row: Any, x: int, y: int, channel: int) -> None:
    """Set one element of an observation; nothing where the cell is not on the board."""
    if 0 <= x < SIDE and 0 <= y < SIDE:
        row[(y * SIDE + x) * CHANNELS + channel] = 1


def mark_trail(row: Any, x: int, y: int, rightward: int) -> None:
    """Mark the cell that something came from."""
    mark_cell(row, x - 1 if rightward else x + 1, y, TRAIL)


def unpack(view: View, row: Any) -> None:
    """Write one slot's observation, MinAtar's ``(10, 10, 10)`` of row, column and channel, into ``row``."""
    for k in range(SIDE * SIDE * CHANNELS):
        row[k] = 0
    x, y = int(view.x), int(view.y)
    mark_cell(row, x, y, FRONT)
    mark_cell(row, x - 1 if view.facing_right else x + 1, y, BACK)
    for k in range(SIDE):
        row[((SIDE - 1) * SIDE + k) * CHANNELS + OXYGEN] = view.oxygen_bar > k
    for k in range(MAX_DIVERS):
        row[((SIDE - 1) * SIDE + SIDE - 2 - k) * CHANNELS + ABOARD] = view.aboard > k
    for word in view.bullets:
        bullet = int(word)
        if bullet >> 9:
            mark_cell(row, bullet & 15, bullet >> 4 & 15, OWN_BULLET)
    for word in view.divers:
        diver = int(word)
        if diver >> 8:
            x, y = diver & 15, (diver >> 4 & 7) + 1
            mark_cell(row, x, y, DIVER)
            mark_trail(row, x, y, diver >> 7 & 1)
    enemies, hostile = view.enemies, view.hostile
    mark_moving(
        enemies.alive,
        enemies.submarine,
        enemies.rightward,
        enemies.row,
        enemies.column,
        SEA,
        (FISH, SUBMARINE, TRAIL),
        row,
    )
    mark(hostile.alive, hostile.row, hostile.column, 0, SEA, HOSTILE_BULLET, row)


def minatar_attributes(state: State) -> dict[str, Any]:
    """Return the attributes that MinAtar's ``seaquest.Env`` has in this state, its lists in their order."""
    enemies, timers, hostile = state.enemies, state.timers, state.hostile

    def entries(alive: int, *planes: Any) -> list[list[int]]:
        bits = [1 << k for k in range(alive.bit_length()) if alive >> k & 1]
        return [[number(of if isinstance(of, list) else [of], bit) for of in planes] for bit in bits]

    ordered = entries(
        enemies.alive,
        enemies.submarine,
        enemies.column,
        enemies.row,
        enemies.rightward,
        timers.move,
        timers.fire,
    )
    bullets = entries(hostile.alive, hostile.column, hostile.row, hostile.rightward)
    ramp = state.ramp
    return {
        "oxygen": state.oxygen,
        "diver_count": state.aboard,
        "sub_x": state.x,
        "sub_y": state.y,
        "sub_or": bool(state.facing_right),
        "f_bullets": [[b & 15, b >> 4 & 15, bool(b >> 8 & 1)] for b in state.bullets if b >> 9],
        "e_bullets": [[x, y + 1, bool(right)] for x, y, right in bullets],
        "e_fish": [[x, y + 1, bool(right), move] for sub, x, y, right, move, _ in ordered if not sub],
        "e_subs": [[x, y + 1, bool(right), move, fire] for sub, x, y, right, move, fire in ordered if sub],
        "divers": [
            # All divers move at the same time, so their timers follow from that of their appearance.
            [d & 15, (d >> 4 & 7) + 1, bool(d >> 7 & 1), (state.diver_timer - 1) % 6]
            for d in state.divers
            if d >> 8
        ],
        "e_spawn_speed": SLOWEST_SPAWN - min(ramp, LAST_RAMP),
        "e_spawn_timer": state.enemy_timer,
        "d_spawn_timer": state.diver_timer,
        "move_speed": SLOWEST_MOVE - min(ramp >> 1, MOVE_RAMPS),
        "ramp_index": ramp,
        "shot_timer": state.reload,
        "surface": bool(state.surfaced),
    }


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
    options = checked_options(sticky_action_prob, difficulty_ramping)
    sticky_below = round(options["sticky_action_prob"] * (1 << CHANCE_BITS))
    return EnvSpec(
        **spec_parts("Seaquest", CHANNELS, range(6), minatar_attributes, **options) | {"presets": PRESETS},
        summary="Dive for divers among fish and submarines, and surface before the oxygen is spent",
        reward=Field("reward", 4),
        rewards=None,
        golden=Golden(State, initial, make_step(sticky_below, difficulty_ramping), observe, view=View),
        unpack=unpack,
        configure=configure,
    )


SPEC = configure()
