"""Times of updates by shards."""

from __future__ import annotations

import importlib
import itertools
from types import SimpleNamespace
from typing import Any

import pytest

pytest.importorskip("torch", reason="torch is not installed: pip install '.[train]'")

shards = importlib.import_module("pearl_marl.experiments.shards")


@pytest.mark.parametrize("number", [None, 1])
def test_an_update_is_divided_into_gathering_and_learning(
    number: int | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The first one does not count; the others gather for 7, 9 and 11 seconds, and learn for 50."""
    if number is not None:
        pytest.importorskip("ray", reason="Ray is not installed: pip install '.[ray]'")
    clock, gathers = [0.0], iter((100.0, 7.0, 9.0, 11.0))

    def taking(seconds: Any, function: Any) -> Any:
        def timed(*given: Any) -> Any:
            clock[0] += next(seconds)
            return function(*given)

        return timed

    class Slow(shards.PPO):  # type: ignore[misc, name-defined]
        def __init__(self, *given: Any) -> None:
            super().__init__(*given)
            self.worker.gather = taking(gathers, self.worker.gather)
            self.learn = taking(itertools.repeat(50.0), self.learn)

    monkeypatch.setattr(shards, "time", SimpleNamespace(perf_counter=lambda: clock[0]))
    monkeypatch.setattr(shards, "PPO", Slow)
    changes = {"n_agents": 64, "rollout_length": 4}
    assert shards.measured("CartPole", changes, number, 3) == (9.0, 50.0)
