"""The spec of SpaceInvaders: its observation as MinAtar shows it, and MinAtar's own renderer."""

from __future__ import annotations

from typing import Any

import numpy as np

from pearl_marl.envs.minatar import LAST, SIDE, checked_options, spec_parts
from pearl_marl.spec import EnvSpec, Golden

from .step import (
    ALIENS,
    COLUMNS,
    MARGIN,
    MINIMAL,
    ROWS,
    SLOWEST_MOVE,
    State,
    View,
    initial,
    make_step,
    observe,
)

CHANNELS = 6
CANNON, ALIEN, TO_LEFT, TO_RIGHT, OWN_BULLET, HOSTILE_BULLET = range(CHANNELS)


def unpack(view: View, row: Any) -> None:
    """Write one slot's observation, MinAtar's ``(10, 10, 6)`` of row, column and channel, into ``row``."""
    for k in range(SIDE * SIDE * CHANNELS):
        row[k] = 0
    row[(SIDE * LAST + int(view.x)) * CHANNELS + CANNON] = 1
    for bullet in view.bullets:
        if bullet.flies:
            row[(SIDE * int(bullet.y) + int(bullet.x)) * CHANNELS + OWN_BULLET] = 1
    if view.bomb.flies:
        row[(SIDE * int(view.bomb.y) + int(view.bomb.x)) * CHANNELS + HOSTILE_BULLET] = 1
    heading = TO_LEFT if view.aliens.leftward else TO_RIGHT
    for k in range(ROWS):
        y = int(view.aliens.top) + k
        y = y - SIDE if y > LAST else y
        line = (int(view.aliens.alive) >> COLUMNS * k & (1 << COLUMNS) - 1) << int(view.aliens.left) >> MARGIN
        for x in range(SIDE):
            row[(SIDE * y + x) * CHANNELS + ALIEN] = line >> x & 1
            row[(SIDE * y + x) * CHANNELS + heading] = line >> x & 1


def minatar_attributes(state: State) -> dict[str, Any]:
    """Return the attributes that MinAtar's ``space_invaders.Env`` has in this state."""
    own, hostile, aliens = (np.zeros((SIDE, SIDE)) for _ in range(3))
    for bullet in state.bullets:
        own[bullet.y, bullet.x] += bullet.flies
    hostile[state.bomb.y, state.bomb.x] = state.bomb.flies
    left, top, leftward, alive = state.aliens
    for k in range(ALIENS):
        if alive >> k & 1:
            aliens[(top + k // COLUMNS) % SIDE, left - MARGIN + k % COLUMNS] = 1
    return {
        "pos": state.x,
        "f_bullet_map": own,
        "e_bullet_map": hostile,
        "alien_map": aliens,
        "alien_dir": -1 if leftward else 1,
        "enemy_move_interval": SLOWEST_MOVE - state.ramp,
        "alien_move_timer": state.move_timer,
        "alien_shot_timer": state.bomb_timer,
        "ramp_index": state.ramp,
        "shot_timer": state.reload,
    }


def configure(
    sticky_action_prob: float = 0.1, difficulty_ramping: bool = True, use_minimal_action_set: bool = True
) -> EnvSpec:
    """Return the spec under MinAtar's keyword arguments.

    Parameters
    ----------
    sticky_action_prob
        The probability with which the last action is repeated in place of the one given, 0 to 1.
    difficulty_ramping
        Whether each wave of aliens is faster than the last, down to 6 steps a cell.
    use_minimal_action_set
        Whether the action space has 4 actions, or all 6 of MinAtar's.
    """
    options = checked_options(sticky_action_prob, difficulty_ramping, use_minimal_action_set)
    step = make_step(options["sticky_action_prob"], difficulty_ramping, use_minimal_action_set)
    return EnvSpec(
        **spec_parts("SpaceInvaders", CHANNELS, MINIMAL, minatar_attributes, **options),
        summary="Shoot wave after wave of aliens, and dodge their bullets",
        rewards=(0.0, 1.0, 2.0),
        golden=Golden(State, initial, step, observe, view=View),
        unpack=unpack,
        configure=configure,
    )


SPEC = configure()
