"""LeducPoker against pgx's: every transition, legal and not, and whole games."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest

import pearl_marl
from pearl_marl.golden import call_reference

from .transitions import Recorded, check_every_step, check_play
from .turns import legal

SPEC = pearl_marl.get_spec("LeducPoker")


def test_every_step() -> None:
    """Whatever the cards, who begins, and what has been bet: observations, masks, rewards and ends."""
    assert check_every_step("LeducPoker") == 2_688


def test_illegal_actions_lose_a_point() -> None:
    oracle = Recorded("LeducPoker")
    table, spec = oracle.columns, oracle.spec
    rows, actions = np.nonzero(~table["legal"] & ~table["over"][:, None])
    results = call_reference(spec.positional.step, [*table["states"][rows].T, actions, actions])
    rewards, ends = np.stack(results[-4:-2], 1), np.stack(results[-2:], 1)
    np.testing.assert_array_equal(rewards, table["reward"][rows, actions])
    assert ends.all()
    # An action that is none does the same.
    words = table["states"][~table["over"]].T
    fourth = call_reference(spec.positional.step, [*words, *np.full((2, words.shape[1]), 3)])
    np.testing.assert_array_equal(np.where(words[5] == 0, fourth[-4], fourth[-3]), -1)
    assert np.stack(fourth[-2:]).all()


def test_starts() -> None:
    """Either player begins, and each of the 120 deals of three cards is equally likely."""
    oracle = Recorded("LeducPoker")
    draws = (2 * np.arange(240 * 50) + 1 << 31) // (240 * 50)
    ours = call_reference(oracle.spec.positional.initial, [draws])
    counts = Counter(zip(*(np.broadcast_to(c, draws.shape).tolist() for c in ours), strict=True))
    assert set(counts) == {state for state, row in oracle.rows.items() if row < oracle.columns["starts"]}
    for (first, second, third, *_), count in counts.items():
        ways = [2, 2, 2]
        deals = 1
        for rank in (first, second, third):
            deals *= ways[rank]
            ways[rank] -= 1
        assert count == 50 * deals


@pytest.mark.parametrize("games", [500, pytest.param(6_000, marks=pytest.mark.exhaustive)])
def test_play(games: int) -> None:
    check_play("LeducPoker", games, 20, legal)


def test_picture() -> None:
    """The third card shows in the second round, and chips are counted."""
    assert SPEC.draw is not None
    for round_, public in ((0, [60] * 3), (1, [240, 150, 40])):
        cells = SPEC.draw(SPEC.layout.built([2, 0, 1, 3, 5, 0, 0, round_, 0, 0]))[::16, ::64]
        assert cells[0].tolist() == [[205, 45, 45], public, [40, 85, 200]]
        assert (cells[4:] == 60).all(-1).sum(0).tolist() == [3, 0, 5]
