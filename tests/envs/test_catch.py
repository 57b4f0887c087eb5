"""Catch against bsuite's: every transition, and whole episodes."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import pearl_marl
from pearl_marl.errors import ArgumentError

from .transitions import cases, check_every_step, check_play, check_starts

SPEC = pearl_marl.get_spec("Catch")


@pytest.mark.parametrize("case", cases("Catch"))
def test_every_step(case: str) -> None:
    assert check_every_step(case) >= 6


@pytest.mark.parametrize("case", cases("Catch"))
def test_starts(case: str) -> None:
    check_starts(case, 600)


@pytest.mark.parametrize("games", [500, pytest.param(6_000, marks=pytest.mark.exhaustive)])
def test_play(games: int) -> None:
    check_play("Catch", games, 20)


def test_picture() -> None:
    """The ball is red and the paddle blue; a ball that is caught hides the paddle's cell."""
    assert SPEC.draw is not None
    picture = SPEC.draw(SPEC.layout.built([4, 2, 1]))[::24, ::24]
    assert picture.shape == (10, 5, 3)
    assert (picture[2, 4] == (205, 45, 45)).all()
    assert (picture[9, 1] == (40, 85, 200)).all()
    assert np.count_nonzero((picture != 255).any(-1)) == 2


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"rows": 1}, "rows is 1; it must be an integer from 2 to 64"),
        ({"columns": 65}, "columns is 65"),
        ({"columns": 5.0}, "columns is 5.0"),
    ],
)
def test_refused_arguments(options: dict[str, Any], words: str) -> None:
    with pytest.raises(ArgumentError, match=words):
        SPEC.with_options(**options)
