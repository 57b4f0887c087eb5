"""DeepSea against bsuite's: every transition, and whole episodes."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import pearl_marl
from pearl_marl.errors import ArgumentError

from .transitions import Recorded, cases, check_every_step, check_play

SPEC = pearl_marl.get_spec("DeepSea")


@pytest.mark.parametrize("case", cases("DeepSea"))
def test_every_step(case: str) -> None:
    """Every cell that a diver reaches, and both actions: so the mapping of actions is bsuite's."""
    size = Recorded(case).spec.options["size"]
    assert check_every_step(case) >= size * size // 2


@pytest.mark.parametrize("games", [500, pytest.param(6_000, marks=pytest.mark.exhaustive)])
def test_play(games: int) -> None:
    check_play("DeepSea", games, 20)


def test_the_way_to_the_treasure_is_worth_099() -> None:
    """The right action of every cell on the diagonal."""
    oracle = Recorded("DeepSea")
    table, row, sum_ = oracle.columns, 0, 0.0
    env = pearl_marl.parallel_env("DeepSea", 1)
    env.reset_batch(seed=0)
    for _ in range(10):
        action = int(table["states"][table["after"][row], 1].argmax())
        row = int(table["after"][row, action])
        sum_ += float(env.step_batch([action]).rewards[0])
    assert sum_ == pytest.approx(0.99)


def test_picture() -> None:
    """The diver is blue; below the last row there is no diver."""
    assert SPEC.draw is not None
    blue = [(SPEC.draw(SPEC.layout.built(state)) == (40, 85, 200)).all(-1) for state in ([3, 2], [10, 2])]
    assert [int(where.sum()) for where in blue] == [24 * 24, 0]
    assert blue[0][3 * 24, 2 * 24]


def test_cells_of_the_heat_map() -> None:
    assert SPEC.grid is not None
    boards = np.eye(100, dtype=np.float32).reshape(-1, 10, 10)
    np.testing.assert_array_equal(SPEC.grid.cell(boards), np.arange(100))


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"size": 1}, "size is 1; it must be an integer from 2 to 50"),
        ({"size": 51}, "size is 51"),
        ({"deterministic": False}, "deterministic is False; only True is possible"),
        ({"deterministic": 1}, "deterministic is 1; it must be True or False"),
        ({"unscaled_move_cost": -0.1}, "unscaled_move_cost is -0.1"),
        ({"mapping_seed": None}, "mapping_seed is None"),
        ({"mapping_seed": 2**32}, "mapping_seed is 4294967296"),
        ({"randomize_actions": 0}, "randomize_actions is 0"),
    ],
)
def test_refused_arguments(options: dict[str, Any], words: str) -> None:
    with pytest.raises(ArgumentError, match=words):
        SPEC.with_options(**options)
