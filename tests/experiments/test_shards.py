"""Times of updates by shards."""

from __future__ import annotations

import importlib
import time

import pytest

pytest.importorskip("torch", reason="torch is not installed: pip install '.[train]'")

shards = importlib.import_module("pearl_marl.experiments.shards")


@pytest.mark.parametrize("number", [None, 1])
def test_an_update_is_divided_into_gathering_and_learning(number: int | None) -> None:
    if number is not None:
        pytest.importorskip("ray", reason="Ray is not installed: pip install '.[ray]'")
    began = time.perf_counter()
    gathers, learns = shards.measured("CartPole", {"n_agents": 64, "rollout_length": 4}, number, 2)
    assert gathers > 0
    assert learns > 0
    assert 2 * min(gathers, learns) < time.perf_counter() - began
