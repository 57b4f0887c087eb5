"""The spec of Overcooked: the words of a kitchen, and what its options are."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt
from gymnasium.spaces import Box, Discrete

from pearl_marl.checks import checked_choice, checked_integer, checked_number
from pearl_marl.errors import ArgumentError
from pearl_marl.spec import EnvSpec, Grid, Peer

from .kitchen import LAYOUTS, MOST
from .layers import COUNT, OWN_PLACE, make_unpack
from .peers import Kitchen, pairs_of
from .picture import make_draw
from .presets import PRESETS
from .step import make_golden, rewards

SHAPING = {"PLACEMENT_IN_POT_REW": 3.0, "DISH_PICKUP_REWARD": 3.0, "SOUP_PICKUP_REWARD": 5.0}
"""The package's shaped rewards."""
HORIZONS, COOK_TIMES = (1, (1 << 32) - 1), (1, 254)


def configure(
    layout: str = "cramped_room",
    horizon: int = 400,
    cook_time: int | None = None,
    reward_shaping_factor: float = 0.0,
    rew_shaping_params: Mapping[str, float] | None = None,
) -> EnvSpec:
    """Return the spec of a kitchen.

    Parameters
    ----------
    layout
        The name of a layout: those of the package that :data:`.kitchen.LAYOUTS` lists.
    horizon
        The time limit. Observations of the last steps say that it is near.
    cook_time
        How long a soup cooks, 1 to 254; None is the layout's own time, which is 20 for most.
    reward_shaping_factor
        How much shaped rewards, which each cook gets for himself, count beside the price of soups.
    rew_shaping_params
        The shaped rewards, by the package's names: for an ingredient put into a pot, for a useful dish taken
        and for a soup taken from its pot. Those left out are 3, 3 and 5.
    """
    kitchen = LAYOUTS[checked_choice("layout", layout, LAYOUTS)]
    horizon = checked_integer("horizon", horizon, *HORIZONS)
    factor = checked_number("reward_shaping_factor", reward_shaping_factor)
    shaping = _shaping(rew_shaping_params)
    if cook_time is not None:
        if kitchen.recipes or kitchen.ingredients:
            raise ArgumentError(
                f"cook_time is {cook_time!r}, and {layout} has cooking times of its own; leave it out"
            )
        kitchen = kitchen.cooking(checked_integer("cook_time", cook_time, *COOK_TIMES))
    table = rewards(kitchen, tuple(factor * shaping[name] for name in SHAPING))
    shape = kitchen.width, kitchen.height, COUNT
    return EnvSpec(
        name="Overcooked",
        version=0,
        summary="Two cooks put onions into pots, and serve the soup",
        rewards=table,
        observation_space=Box(0, max(MOST, *kitchen.times), shape, np.uint8),
        action_space=Discrete(6),
        golden=make_golden(kitchen, horizon),
        agents=2,
        unpack=make_unpack(kitchen),
        max_cycles=horizon,
        options={
            "layout": layout,
            "horizon": horizon,
            "cook_time": cook_time,
            "reward_shaping_factor": factor,
            "rew_shaping_params": None if rew_shaping_params is None else shaping,
        },
        configure=configure,
        peers={"overcooked-ai": Peer(Kitchen, actions=pairs_of)},
        presets=PRESETS,
        draw=make_draw(kitchen),
        follows="overcooked-ai cramped_room",
        render_modes=("rgb_array",),
        grid=Grid(kitchen.height, kitchen.width, _cell),
    )


def _cell(observations: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Return the number of the cell that a cook is in, row by row."""
    own = observations[..., OWN_PLACE].swapaxes(1, 2)
    cells: npt.NDArray[Any] = own.reshape(len(own), -1).argmax(1)
    return cells


def _shaping(given: Mapping[str, float] | None) -> dict[str, float]:
    """Return all shaped rewards."""
    known = ", ".join(SHAPING)
    if given is not None and not isinstance(given, Mapping):
        raise ArgumentError(f"rew_shaping_params is {given!r}; it must be None or a dict of {known}")
    result = dict(SHAPING)
    for name, value in (given or {}).items():
        if name not in SHAPING:
            raise ArgumentError(
                f"rew_shaping_params has {name!r}; possible are {known}, and overcooked-ai 1.1.0 itself uses "
                "no other"
            )
        result[name] = checked_number(f"rew_shaping_params[{name!r}]", value)
    return result


SPEC = configure()
