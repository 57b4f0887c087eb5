"""With how many threads PyTorch learns."""

from __future__ import annotations

import os

import pytest
import torch

from pearl_marl.envs import get_spec
from pearl_marl.training.run import settings_for
from pearl_marl.training.trainer import threads_for


@pytest.fixture(autouse=True)
def four_threads(monkeypatch: pytest.MonkeyPatch) -> None:
    found = {"threads": 4}
    monkeypatch.setattr(torch, "get_num_threads", lambda: found["threads"])
    monkeypatch.setattr(torch, "set_num_threads", lambda n: found.update(threads=n))


@pytest.mark.parametrize(
    ("name", "given", "threads"),
    [
        ("CartPole", {}, 1),
        ("LevelBasedForaging", {}, 1),
        ("MountainCar", {}, 4),
        ("CartPole", {"width": 512}, 4),
        ("Seaquest", {}, 4),
    ],
)
def test_small_networks_are_learned_by_one(name: str, given: dict[str, int], threads: int) -> None:
    with threads_for(get_spec(name), settings_for("ppo", name, given)):
        assert torch.get_num_threads() == threads
    assert torch.get_num_threads() == 4


def test_threads_that_wait_sleep() -> None:
    assert os.environ["OMP_WAIT_POLICY"] in ("PASSIVE", "ACTIVE")
