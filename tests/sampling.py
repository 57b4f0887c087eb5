"""Which parameters `make test` has, where only `make test-exhaustive` has them all."""

from __future__ import annotations

from collections.abc import Container, Iterable
from typing import Any

import pytest

exhaustive = False
"""Whether all parameters are wanted: to make thousands of tests only to leave them out takes seconds."""


KINDS = (
    "Blackjack",
    "Breakout",
    "CartPole",
    "CliffWalking",
    "ConnectFour",
    "LevelBasedForaging",
    "Overcooked",
    "Pendulum",
)
"""Environments that differ in what interfaces and devices can tell apart: spaces, draws, masks, turns,
worlds, pictures. The others also make observations in other ways, so tests of that take all of them."""


def sampled(values: Iterable[Any], always: Container[Any]) -> list[Any]:
    """Return parameters of a test; those that are not among ``always`` are exhaustive."""
    if not exhaustive:
        return [value for value in values if value in always]
    return [
        value if value in always else pytest.param(value, marks=pytest.mark.exhaustive) for value in values
    ]
