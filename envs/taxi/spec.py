"""The spec of Taxi: what the platform has to know besides the dynamics in ``step.py``."""

from __future__ import annotations

from typing import Any

import numpy.typing as npt
from gymnasium import Env
from gymnasium.spaces import Discrete

from pearl_marl.checks import checked_flag, checked_number
from pearl_marl.spec import EnvSpec, Golden, Grid

from .step import SIDE, State, make_initial, make_step, observe


def pose(oracle: Env[Any, Any], state: State) -> None:
    """Put Gymnasium's Taxi into a state, for rendering."""
    oracle.s = observe(state)  # type: ignore[attr-defined]
    oracle.fickle_step = bool(state.fickle)  # type: ignore[attr-defined]
    # Which way the taxi faces is no part of the state: it faces south, as at Gymnasium's start.
    oracle.lastaction = None  # type: ignore[attr-defined]
    oracle.taxi_orientation = 0  # type: ignore[attr-defined]


def taxi_cell(observations: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Return the cells that the taxis are in."""
    return observations // 20


def configure(
    is_rainy: bool = False,
    fickle_passenger: bool = False,
    rainy_probability: float = 0.8,
    fickle_probability: float = 0.3,
) -> EnvSpec:
    """Return the spec under Gymnasium's keyword arguments.

    Parameters
    ----------
    is_rainy
        Whether a taxi may slip to the left or right of where it is driven.
    fickle_passenger
        Whether passengers may change their destination at the first move with them.
    rainy_probability
        How often a taxi does not slip in rain, 0 to 1. It slips left and right equally often.
    fickle_probability
        How often a passenger does change his destination, 0 to 1.
    """
    checked_flag("is_rainy", is_rainy)
    checked_flag("fickle_passenger", fickle_passenger)
    rainy_probability = checked_number("rainy_probability", rainy_probability, 0, 1)
    fickle_probability = checked_number("fickle_probability", fickle_probability, 0, 1)
    slips = is_rainy and rainy_probability < 1
    thresholds = _threshold(rainy_probability), _threshold((1 + rainy_probability) / 2)
    fickle_below = _threshold(fickle_probability) if fickle_passenger and fickle_probability else 0
    return EnvSpec(
        name="Taxi",
        version=0,
        summary="Pick up a passenger and drive to the destination",
        rewards=(-1.0, -10.0, 20.0),
        observation_space=Discrete(500),
        action_space=Discrete(6),
        golden=Golden(
            State, make_initial(fickle_below), make_step(slips, fickle_below > 0, *thresholds), observe
        ),
        max_cycles=200,
        options={
            "is_rainy": is_rainy,
            "fickle_passenger": fickle_passenger,
            "rainy_probability": rainy_probability,
            "fickle_probability": fickle_probability,
        },
        configure=configure,
        oracle="Taxi-v4",
        pose=pose,
        render_modes=("human", "rgb_array", "ansi"),
        grid=Grid(SIDE, SIDE, cell=taxi_cell),
    )


def _threshold(probability: float) -> int:
    """Return the number, 1 to ``2**32 - 1``, that about this share of 32-bit draws is below."""
    return min(max(round(probability * 2**32), 1), 2**32 - 1)


SPEC = configure()
