"""The spec of TicTacToe: two boards of bits, and PettingZoo's planes of them."""

from __future__ import annotations

from typing import Any

import numpy as np
from gymnasium import Env
from gymnasium.spaces import Box, Discrete

from pearl_marl.planes import interleave
from pearl_marl.spec import EnvSpec, Field, Golden

from .step import CELLS, State, View, initial, masks, observe, step


def unpack(view: View, row: Any) -> None:
    """Write PettingZoo's ``(3, 3, 2)`` of column, row and whose mark it is, into ``row``."""
    interleave(view.own, view.other, CELLS, row)


def pose(oracle: Env[Any, Any], state: State) -> None:
    """Put PettingZoo's game into a state, for rendering."""
    first, second = state.boards
    squares = [(first >> cell & 1) + 2 * (second >> cell & 1) for cell in range(CELLS)]
    oracle.game.board.squares = squares  # type: ignore[attr-defined]


def configure() -> EnvSpec:
    """Return the spec; there are no options."""
    return EnvSpec(
        name="TicTacToe",
        version=0,
        summary="Two players mark cells in turn, and three in a row win",
        reward=Field("reward", 2, signed=True),
        rewards=None,
        observation_space=Box(0, 1, (3, 3, 2), np.int8),
        action_space=Discrete(CELLS),
        golden=Golden(State, initial, step, observe, masks, view=View),
        agents=2,
        turns=True,
        masked="refused",
        unpack=unpack,
        configure=configure,
        peers={
            "EnvPool": "TicTacToe-v1",
            "PettingZoo": "pettingzoo.classic.tictactoe.tictactoe:raw_env",
        },
        oracle="pearl_marl.envs.turns:PettingZoo/TicTacToe-v3",
        follows="PettingZoo tictactoe_v3",
        pose=pose,
        render_modes=("human", "rgb_array"),
    )


SPEC = configure()
