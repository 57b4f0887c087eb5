"""The spec of Elevators: the instances of the competition, and how they are drawn."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from gymnasium.spaces import Discrete, MultiBinary, MultiDiscrete

from pearl_marl.checks import checked_integer
from pearl_marl.spec import EnvSpec, Field, Peer

from .peers import make, moves_of
from .presets import PRESETS
from .step import RIGHT, WAITING, WRONG, make_golden

INSTANCES: tuple[tuple[int, tuple[float, ...]], ...] = (
    (1, (0.14635538,)),
    (2, (0.07776069,)),
    (2, (0.23324005,)),
    (1, (0.051886387, 0.070308864)),
    (2, (0.06492667, 0.08997825)),
    (2, (0.089050114, 0.1175044)),
    (1, (0.057459753, 0.04761868, 0.041935332)),
    (2, (0.04416793, 0.07763073, 0.057016928)),
    (2, (0.06957142, 0.06842119, 0.080825426)),
    (1, (0.019988691, 0.03846489, 0.024069317, 0.025387743)),
)
"""Cars, and the chance of an arrival on each floor between, upwards as downwards."""
CELL = 24
"""Pixels along a side."""
SHAFT, DOOR = (225, 225, 225), (250, 210, 80)
UP, DOWN = (40, 85, 200), (205, 45, 45)
"""Colours of passengers, by the way that they go."""


def draw(state: Any) -> npt.NDArray[np.uint8]:
    """Draw the floors: passengers that wait, then each car in its shaft with its way and passengers."""
    floors, cell = len(state.waiting_up) + 2, CELL
    picture = np.full((floors, cell, 1 + len(state.cars), cell, 3), 255, np.uint8)
    picture[:, -1] = 0
    picture[:, :-1, 1:, 2:] = SHAFT
    places: list[tuple[int, int, Any, Any]] = [
        (k, 0, *waiting)
        for k, waiting in enumerate(zip(state.waiting_up, state.waiting_down, strict=True), 1)
    ]
    for column, car in enumerate(state.cars, 1):
        picture[car.floor, 2:-2, column, 4:-2] = (150, 150, 150) if car.closed else DOOR
        row = slice(2, 5) if car.up else slice(-5, -2)
        picture[car.floor, row, column, 4:-2] = 0
        places.append((car.floor, column, car.takes_up, car.takes_down))
    for floor, column, up, down in places:
        for there, left, colour in ((up, 6, UP), (down, 14, DOWN)):
            if there:
                picture[floor, 8:16, column, left : left + 6] = colour
    # The top floor is in the first row.
    return picture[::-1].reshape(floors * cell, -1, 3)


def configure(instance: int = 5) -> EnvSpec:
    """Return the spec of an instance of the competition.

    Parameters
    ----------
    instance
        Its number, 1 to 10.
    """
    instance = checked_integer("instance", instance, 1, len(INSTANCES))
    cars, arrivals = INSTANCES[instance - 1]
    floors = len(arrivals) + 2
    most = 2 * len(arrivals) * WAITING + cars * (RIGHT + WRONG)
    return EnvSpec(
        name="Elevators",
        version=0,
        summary="Fetch passengers that appear by chance, and take them to the top or the bottom",
        rewards=None,
        reward=Field("reward", 1 + most.bit_length(), signed=True, fraction=2),
        observation_space=MultiBinary(2 * floors + (4 + floors) * cars),
        action_space=MultiDiscrete([5] * cars) if cars > 1 else Discrete(5),
        golden=make_golden(cars, arrivals),
        max_cycles=40,
        options={"instance": instance},
        configure=configure,
        peers={"pyRDDLGym": Peer(make, actions=moves_of)},
        presets=PRESETS,
        draw=draw,
        follows="rddlrepository Elevators_MDP_ippc2011",
        render_modes=("rgb_array",),
    )


SPEC = configure()
