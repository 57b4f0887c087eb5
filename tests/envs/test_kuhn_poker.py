"""KuhnPoker against pgx's: every transition, and whole games."""

from __future__ import annotations

import pytest

import pearl_marl

from .transitions import check_every_step, check_play, check_starts
from .turns import legal

SPEC = pearl_marl.get_spec("KuhnPoker")


def test_every_step() -> None:
    """Whatever the cards, who begins, and what has been bet: observations, masks, rewards and ends."""
    assert check_every_step("KuhnPoker") == 72


def test_starts() -> None:
    """Either player begins, and the six deals are equally likely."""
    check_starts("KuhnPoker", 1200)


@pytest.mark.parametrize("games", [500, pytest.param(6_000, marks=pytest.mark.exhaustive)])
def test_play(games: int) -> None:
    check_play("KuhnPoker", games, 20, legal)


def test_picture() -> None:
    """A king and a jack, and the second player has bet."""
    assert SPEC.draw is not None
    cells = SPEC.draw(SPEC.layout.built([2, 0, 0, 0, 0, 1]))[::64, ::64]
    assert cells.tolist() == [[[205, 45, 45], [40, 85, 200]], [[255] * 3, [60] * 3]]
