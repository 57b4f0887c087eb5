"""MemoryChain against bsuite's: every transition, and whole episodes."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import pearl_marl
from pearl_marl.errors import ArgumentError

from .transitions import cases, check_every_step, check_play, check_starts

SPEC = pearl_marl.get_spec("MemoryChain")


@pytest.mark.parametrize("case", cases("MemoryChain"))
def test_every_step(case: str) -> None:
    assert check_every_step(case) >= 24


@pytest.mark.parametrize("case", cases("MemoryChain"))
def test_starts(case: str) -> None:
    check_starts(case, 192)


@pytest.mark.parametrize("games", [500, pytest.param(6_000, marks=pytest.mark.exhaustive)])
def test_play(games: int) -> None:
    check_play("MemoryChain, size", games, 20)


@pytest.mark.parametrize("bits", [pytest.param(32, marks=pytest.mark.exhaustive), 40])
def test_long_contexts(bits: int) -> None:
    """More bits than a draw has: each is as often 0 as 1, and the answer to each question is the bit."""
    n = 4000
    env = pearl_marl.parallel_env("MemoryChain", n, memory_length=2, num_bits=bits)
    context = env.reset_batch(seed=1)[:, 0, 2:]
    assert (np.abs(context.mean(0)) < 5 / np.sqrt(n)).all()
    env.step_batch(np.zeros(n, np.uint8))
    question = env.step_batch(np.zeros(n, np.uint8)).obs[:, 0, 1].astype(int)
    assert set(question) == set(range(bits))
    step = env.step_batch((context[np.arange(n), question] > 0).astype(np.uint8))
    assert (step.rewards == 1).all()
    assert step.terminations.all()


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"memory_length": 0}, "memory_length is 0; it must be an integer from 1 to 1,000"),
        ({"num_bits": 41}, "num_bits is 41; it must be an integer from 1 to 40"),
    ],
)
def test_refused_arguments(options: dict[str, Any], words: str) -> None:
    with pytest.raises(ArgumentError, match=words):
        SPEC.with_options(**options)


def test_picture() -> None:
    """Of the bits 1, 0 and 1 the second is asked for, and half of the time is gone."""
    spec = SPEC.with_options(num_bits=3)
    assert spec.draw is not None
    picture = spec.draw(spec.layout.built([3, 0b101, 1]))
    cells = picture[::48, ::48].tolist()
    assert cells[0] == [[40, 85, 200], [240, 150, 40], [40, 85, 200]]
    assert cells[1] == [[255] * 3, [0] * 3, [255] * 3]
    assert (picture[-1] == 0).all(-1).sum() == 72
