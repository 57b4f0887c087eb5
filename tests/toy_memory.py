"""``Positions``: CartPole of which an agent sees where cart and pole are, and not how fast they move."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from gymnasium.spaces import Box

from pearl_marl import EnvSpec, get_spec
from pearl_marl.envs.cart_pole.step import FRACTION, State
from pearl_marl.layout import Signed

CART_POLE = get_spec("CartPole")
HIGH = CART_POLE.observation_space.high[[0, 2]]


class PositionsView(NamedTuple):
    """What an agent sees of a state."""

    position: Signed[32, FRACTION]
    angle: Signed[32, FRACTION]


def positions_observe(state: State) -> PositionsView:
    return PositionsView(state.position, state.angle)


POSITIONS = EnvSpec(
    name="Positions",
    version=0,
    summary="Balance a pole by positions alone",
    rewards=(1.0,),
    observation_space=Box(-HIGH, HIGH, dtype=np.float32),
    action_space=CART_POLE.action_space,
    golden=CART_POLE.golden._replace(observe=positions_observe, view=PositionsView),
    max_cycles=500,
)
