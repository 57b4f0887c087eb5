"""The spec of ConnectFour: two bitboards, and PettingZoo's planes of them."""

from __future__ import annotations

from typing import Any

import numpy as np
from gymnasium import Env
from gymnasium.spaces import Box, Discrete

from pearl_marl.planes import interleave
from pearl_marl.spec import EnvSpec, Field, Golden

from .presets import PRESETS
from .step import CELLS, COLUMNS, ROWS, State, View, initial, masks, observe, step


def unpack(view: View, row: Any) -> None:
    """Write PettingZoo's ``(6, 7, 2)`` of row, column and whose disc it is, into ``row``."""
    interleave(view.own, view.other, CELLS, row)


def pose(oracle: Env[Any, Any], state: State) -> None:
    """Put PettingZoo's game into a state, for rendering."""
    first, second = state.boards
    board = [(first >> cell & 1) + 2 * (second >> cell & 1) for cell in range(CELLS)]
    oracle.game.board = board  # type: ignore[attr-defined]


def configure() -> EnvSpec:
    """Return the spec; there are no options."""
    return EnvSpec(
        name="ConnectFour",
        version=0,
        summary="Two players drop discs in turn, and four in a row win",
        reward=Field("reward", 2, signed=True),
        rewards=None,
        observation_space=Box(0, 1, (ROWS, COLUMNS, 2), np.int8),
        action_space=Discrete(COLUMNS),
        golden=Golden(State, initial, step, observe, masks, view=View),
        agents=2,
        turns=True,
        masked="refused",
        unpack=unpack,
        configure=configure,
        peers={
            "EnvPool": "ConnectFour-v1",
            "PettingZoo": "pettingzoo.classic.connect_four.connect_four:raw_env",
        },
        presets=PRESETS,
        oracle="pearl_marl.envs.turns:PettingZoo/ConnectFour-v3",
        follows="PettingZoo connect_four_v3",
        pose=pose,
        render_modes=("human", "rgb_array"),
    )


SPEC = configure()
