"""The spec of Freeway: its observation as MinAtar shows it, and MinAtar's own renderer."""

from __future__ import annotations

from typing import Any

from pearl_marl.envs.minatar import LAST, SIDE, checked_options, spec_parts
from pearl_marl.envs.minatar_planes import number_in
from pearl_marl.spec import EnvSpec, Golden

from .step import LANES, MINIMAL, OWN_COLUMN, SPEEDS, State, View, initial, make_step, observe

CHANNELS = 7
CHICKEN, CAR, SPEED_1 = range(3)


def unpack(view: View, row: Any) -> None:
    """Write one slot's observation, MinAtar's ``(10, 10, 7)`` of row, column and channel, into ``row``."""
    for k in range(SIDE * SIDE * CHANNELS):
        row[k] = 0
    row[(SIDE * int(view.y) + OWN_COLUMN) * CHANNELS + CHICKEN] = 1
    for k in range(LANES):
        car = int(view.cars[k])
        x, interval = car & 15, car >> 4 & 7
        # A word can hold what is no column and no speed, though no car has them.
        if x <= LAST and 1 <= interval <= SPEEDS:
            behind = x - 1 if car >> 7 else x + 1
            behind = LAST if behind < 0 else 0 if behind > LAST else behind
            first = SIDE * (k + 1)
            row[(first + x) * CHANNELS + CAR] = 1
            row[(first + behind) * CHANNELS + SPEED_1 + interval - 1] = 1


def minatar_attributes(state: State) -> dict[str, Any]:
    """Return the attributes that MinAtar's ``freeway.Env`` has in this state."""

    def car(k: int) -> list[int]:
        planes = state.cars.column, state.timer, state.cars.interval
        x, timer, interval = (number_in(of, k) for of in planes)
        return [x, k + 1, timer, interval if state.cars.rightward >> k & 1 else -interval]

    return {
        "pos": state.y,
        "move_timer": state.move_timer,
        "terminate_timer": state.steps_left,
        "cars": [car(k) for k in range(LANES)],
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
        **spec_parts("Freeway", CHANNELS, MINIMAL, minatar_attributes, **options),
        summary="Cross eight lanes of cars again and again",
        rewards=(0.0, 1.0),
        golden=Golden(State, initial, step, observe, view=View),
        unpack=unpack,
        configure=configure,
    )


SPEC = configure()
