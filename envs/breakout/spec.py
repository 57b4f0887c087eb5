"""The spec of Breakout: its observation as MinAtar shows it, and MinAtar's own renderer."""

from __future__ import annotations

from typing import Any

import numpy as np

from pearl_marl.envs.minatar import SIDE, checked_options, spec_parts
from pearl_marl.spec import EnvSpec, Golden

from .presets import PRESETS
from .step import BRICKS, MINIMAL, TOP, State, View, initial, make_step, observe

CHANNELS = 4
PADDLE, BALL, TRAIL, BRICK = range(CHANNELS)


def unpack(view: View, row: Any) -> None:
    """Write one slot's observation, MinAtar's ``(10, 10, 4)`` of row, column and channel, into ``row``."""
    for k in range(SIDE * SIDE * CHANNELS):
        row[k] = 0
    for k in range(BRICKS):
        row[(SIDE * TOP + k) * CHANNELS + BRICK] = int(view.bricks) >> k & 1
    row[(SIDE * (SIDE - 1) + int(view.paddle)) * CHANNELS + PADDLE] = 1
    row[(SIDE * int(view.y) + int(view.x)) * CHANNELS + BALL] = 1
    row[(SIDE * int(view.last_y) + int(view.last_x)) * CHANNELS + TRAIL] = 1


def minatar_attributes(state: State) -> dict[str, Any]:
    """Return the attributes that MinAtar's ``breakout.Env`` has in this state."""
    bricks = np.zeros((SIDE, SIDE))
    bricks.flat[SIDE * TOP : SIDE * TOP + BRICKS] = [state.bricks >> k & 1 for k in range(BRICKS)]
    return {
        "pos": state.paddle,
        "ball_x": state.x,
        "ball_y": state.y,
        "last_x": state.last_x,
        "last_y": state.last_y,
        "ball_dir": ((0, 1), (3, 2))[state.falls][state.rightward],
        "strike": bool(state.strike),
        "brick_map": bricks,
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
        Changes nothing: this game does not get harder.
    use_minimal_action_set
        Whether the action space has 3 actions, or all 6 of MinAtar's.
    """
    options = checked_options(sticky_action_prob, difficulty_ramping, use_minimal_action_set)
    step = make_step(options["sticky_action_prob"], use_minimal_action_set)
    return EnvSpec(
        **spec_parts("Breakout", CHANNELS, MINIMAL, minatar_attributes, **options) | {"presets": PRESETS},
        summary="Bounce a ball off a paddle to break bricks",
        rewards=(0.0, 1.0),
        golden=Golden(State, initial, step, observe, view=View),
        unpack=unpack,
        configure=configure,
    )


SPEC = configure()
