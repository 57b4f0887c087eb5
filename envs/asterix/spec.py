"""The spec of Asterix: its observation as MinAtar shows it, and MinAtar's own renderer."""

from __future__ import annotations

from typing import Any

from pearl_marl.envs.minatar import LAST, SIDE, checked_options, spec_parts
from pearl_marl.envs.minatar_planes import number
from pearl_marl.spec import EnvSpec, Golden

from .step import (
    MINIMAL,
    ROWS,
    SLOWEST_MOVE,
    SLOWEST_SPAWN,
    State,
    View,
    initial,
    make_step,
    observe,
)

CHANNELS = 4
PLAYER, ENEMY, TRAIL, GOLD = range(CHANNELS)


def unpack(view: View, row: Any) -> None:
    """Write one slot's observation, MinAtar's ``(10, 10, 4)`` of row, column and channel, into ``row``."""
    for k in range(SIDE * SIDE * CHANNELS):
        row[k] = 0
    row[(SIDE * int(view.y) + int(view.x)) * CHANNELS + PLAYER] = 1
    for k in range(ROWS):
        bit = 1 << k
        x = number(view.entities.column, bit)
        if view.entities.alive & bit and x <= LAST:
            first = SIDE * (k + 1)
            row[(first + x) * CHANNELS + (GOLD if view.entities.gold & bit else ENEMY)] = 1
            behind = x - 1 if view.entities.rightward & bit else x + 1
            if 0 <= behind <= LAST:
                row[(first + behind) * CHANNELS + TRAIL] = 1


def minatar_attributes(state: State) -> dict[str, Any]:
    """Return the attributes that MinAtar's ``asterix.Env`` has in this state."""
    planes = state.entities

    def entity(k: int) -> list[Any] | None:
        bit = 1 << k
        flags = [bool(plane & bit) for plane in (planes.rightward, planes.gold)]
        return [number(planes.column, bit), k + 1, *flags] if planes.alive & bit else None

    return {
        "player_x": state.x,
        "player_y": state.y,
        "entities": [entity(k) for k in range(ROWS)],
        "spawn_speed": SLOWEST_SPAWN - state.ramp,
        "spawn_timer": state.spawn_timer,
        "move_speed": SLOWEST_MOVE - (state.ramp >> 1),
        "move_timer": state.move_timer,
        "ramp_timer": state.ramp_timer - 1,
        "ramp_index": state.ramp,
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
        Whether enemies and treasure get faster and more frequent with time.
    use_minimal_action_set
        Whether the action space has 5 actions, or all 6 of MinAtar's.
    """
    options = checked_options(sticky_action_prob, difficulty_ramping, use_minimal_action_set)
    step = make_step(options["sticky_action_prob"], difficulty_ramping, use_minimal_action_set)
    return EnvSpec(
        **spec_parts("Asterix", CHANNELS, MINIMAL, minatar_attributes, **options),
        summary="Collect treasure among enemies that cross the board",
        rewards=(0.0, 1.0),
        golden=Golden(State, initial, step, observe, view=View),
        unpack=unpack,
        configure=configure,
    )


SPEC = configure()
