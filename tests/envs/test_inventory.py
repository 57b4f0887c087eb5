"""Inventory against or-gymnasium's: episodes of ``record_or_gymnasium.py``, with their demands."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import pearl_marl
from pearl_marl.envs.inventory.step import DEMANDS
from pearl_marl.golden import call_reference
from pearl_marl.porting.oracle import Ours

from .record_or_gymnasium import PERIODS, checksum, inputs

SPEC = pearl_marl.get_spec("Inventory")
CHECKS = np.load(Path(__file__).with_name("or_gymnasium.npz"))["checks"]


@pytest.mark.parametrize("episodes", [100, pytest.param(None, marks=pytest.mark.exhaustive)])
def test_episodes(episodes: int | None) -> None:
    """Every observation and profit is the package's, by its own orders and demands."""
    orders, demands = (numbers[:, :episodes] for numbers in inputs())
    least = np.array([0, *DEMANDS])[demands]
    ours = Ours(SPEC, demands.shape[1])
    ours.start(np.zeros((ours.n, 0)))
    assert SPEC.max_cycles == PERIODS
    for period in range(PERIODS):
        made = ours.step(orders[period, :, None], least[period, :, None])
        fortieths = np.rint(40 * made.rewards[:, 0] / 0.97**period)
        # What the reward loses by its 12 bits behind the point.
        assert abs(made.rewards[:, 0] - fortieths / 40 * 0.97**period).max() < 2**-11
        pairs = zip(ours.observations()[:, 0], fortieths, strict=True)
        np.testing.assert_array_equal([checksum(*pair) for pair in pairs], CHECKS[period, :episodes])
        assert not made.terminated.any()
    stored = [int(words.max()) for words in ours.words[:3]]
    assert max(stored) > 300, "some have to order too much"
    print(f"{demands.size:,} steps; stages have up to {stored}")


def test_demands() -> None:
    """A demand is a Poisson number, by its chances and by many draws."""
    chances = np.diff([0, *DEMANDS, 2**32]) / 2**32
    numbers = np.arange(len(chances))
    assert (chances @ numbers).round(6) == 20
    assert (chances @ (numbers - 20) ** 2).round(6) == 20
    start = call_reference(SPEC.positional.initial, ())
    draws = np.array([0, DEMANDS[0] - 1, DEMANDS[0], DEMANDS[19], 2**32 - 1])
    left = call_reference(SPEC.positional.step, [*start, 0, 0, 0, draws])[0]
    assert (100 - left).tolist() == [0, 0, 1, 20, len(DEMANDS)]


def test_picture() -> None:
    """A bar of what each stage has, and bars of what comes."""
    assert SPEC.draw is not None
    start = call_reference(SPEC.positional.initial, ())
    words = [int(word) for word in start]
    words[3:6] = 100, 0, 50
    picture = SPEC.draw(SPEC.layout.built(words))[::2, ::2].reshape(3, 2, 24, -1, 3)
    blue = (picture[:, 0] == (40, 85, 200)).all(-1).sum((1, 2))
    assert blue.tolist() == [22 * 25, 22 * 25, 22 * 50]
    orange = (picture[:, 1] == (240, 150, 40)).all(-1).sum(1)
    assert orange[0].reshape(10, 12)[:3, 0].tolist() == [22, 0, 11]
    assert not orange[1:].any()
