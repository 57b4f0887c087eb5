"""KuhnPoker against pgx's: every transition, and whole games."""

from __future__ import annotations

import pytest

from .transitions import check_every_step, check_play, check_starts
from .turns import legal


def test_every_step() -> None:
    """Whatever the cards, who begins, and what has been bet: observations, masks, rewards and ends."""
    assert check_every_step("KuhnPoker") == 72


def test_starts() -> None:
    """Either player begins, and the six deals are equally likely."""
    check_starts("KuhnPoker", 1200)


@pytest.mark.parametrize("games", [500, pytest.param(6_000, marks=pytest.mark.exhaustive)])
def test_play(games: int) -> None:
    check_play("KuhnPoker", games, 20, legal)
