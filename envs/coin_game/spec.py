"""The spec of CoinGame: its words, and the package's options."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from gymnasium.spaces import Box, Discrete

from pearl_marl.checks import checked_flag, checked_integer, is_number
from pearl_marl.errors import ArgumentError
from pearl_marl.spec import EnvSpec, Grid

from .picture import draw
from .presets import PRESETS
from .step import SIZE, Around, Place, View, make_golden, rewards

CHANNELS = 4
CELLS = SIZE * SIZE
PAYOFF = ((1.0, 1.0, -2.0), (1.0, 1.0, -2.0))
MOST_STEPS = (1 << 16) - 1


def mark(row: Any, place: Place, channel: int) -> None:
    """Set one element of an observation; nothing where the cell is not on the torus."""
    line, column = int(place.row), int(place.column)
    if line < SIZE and column < SIZE:
        row[(line * SIZE + column) * CHANNELS + channel] = 1


def unpack(view: View, row: Any) -> None:
    """Write the package's ``(3, 3, 4)`` of row, column and what is there, into ``row``."""
    for k in range(CELLS * CHANNELS):
        row[k] = 0
    mark(row, view.own, 0)
    mark(row, view.other, 1)
    mark(row, view.own_coin, 2)
    mark(row, view.other_coin, 3)


def unpack_around(view: Around, row: Any) -> None:
    """Do the same for who is in the middle of what he sees."""
    unpack(View(Place(1, 1), view.other, view.own_coin, view.other_coin), row)


def configure(
    num_inner_steps: int = 10,
    num_outer_steps: int = 10,
    cnn: bool = False,
    egocentric: bool = False,
    shared_rewards: bool = False,
    payoff_matrix: Sequence[Sequence[float]] = PAYOFF,
) -> EnvSpec:
    """Return the spec under the package's keyword arguments.

    Parameters
    ----------
    num_inner_steps
        The steps of a game, 1 to 65,536.
    num_outer_steps
        The games of an episode, 1 to 65,536.
    cnn
        Whether observations have the shape ``(3, 3, 4)`` rather than ``(36,)``.
    egocentric
        Whether a player sees himself in the middle.
    shared_rewards
        Whether both get the sum of their rewards.
    payoff_matrix
        A row for the red player and one for the blue: what he gets for a red coin, for a blue coin, and
        when the other takes a coin of his colour.
    """
    inner = checked_integer("num_inner_steps", num_inner_steps, 1, MOST_STEPS)
    outer = checked_integer("num_outer_steps", num_outer_steps, 1, MOST_STEPS)
    for name, flag in (("cnn", cnn), ("egocentric", egocentric), ("shared_rewards", shared_rewards)):
        checked_flag(name, flag)
    payoff = _payoff(payoff_matrix)
    # What red gets for red coins, blue gets for blue ones.
    alike = payoff[0] == [payoff[1][1], payoff[1][0], payoff[1][2]]
    table = rewards(payoff, shared_rewards, alike)
    return EnvSpec(
        name="CoinGame",
        version=0,
        summary="Collect coins; one of the other's colour costs the other more than it brings",
        rewards=table,
        observation_space=Box(0, 1, (SIZE, SIZE, CHANNELS) if cnn else (CELLS * CHANNELS,), np.uint8),
        action_space=Discrete(5),
        golden=make_golden(inner, egocentric, shared_rewards, alike),
        agents=2,
        unpack=unpack_around if egocentric else unpack,
        max_cycles=inner * outer,
        options={
            "num_inner_steps": inner,
            "num_outer_steps": outer,
            "cnn": cnn,
            "egocentric": egocentric,
            "shared_rewards": shared_rewards,
            "payoff_matrix": payoff,
        },
        configure=configure,
        peers={"JaxMARL": "jaxmarl.environments.coin_game:CoinGame"},
        presets=PRESETS,
        draw=draw,
        follows="jaxmarl coin_game",
        render_modes=("rgb_array",),
        grid=None if egocentric else Grid(SIZE, SIZE, _cell),
    )


def _cell(observations: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Return the number of the cell that a player is in."""
    cells: npt.NDArray[Any] = observations.reshape(-1, CELLS, CHANNELS)[:, :, 0].argmax(1)
    return cells


def _payoff(matrix: object) -> list[list[float]]:
    """Return two rows of three finite numbers."""
    if isinstance(matrix, np.ndarray):
        matrix = matrix.tolist()
    rows = matrix if isinstance(matrix, Sequence) else []
    numbers = [one for row in rows if isinstance(row, Sequence) and len(row) == 3 for one in row]
    if len(rows) != 2 or len(numbers) != 6 or not all(map(is_number, numbers)):
        raise ArgumentError(f"payoff_matrix is {matrix!r}; it must be two rows of three finite numbers")
    return [[float(one) for one in row] for row in rows]


SPEC = configure()
