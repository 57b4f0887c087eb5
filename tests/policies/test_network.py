"""What a network makes of many rows, and the statistics by which it standardises them."""

from __future__ import annotations

import importlib
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from pearl_marl import get_spec

torch = pytest.importorskip("torch", reason="torch is not installed: pip install '.[train]'")
network = importlib.import_module("pearl_marl.policies.network")


@pytest.fixture(autouse=True)
def two_threads() -> Iterator[None]:
    before = torch.get_num_threads()
    torch.set_num_threads(2)
    yield
    torch.set_num_threads(before)


def made(env_id: str, **kinds: Any) -> Any:
    return network.networks(get_spec(env_id), 3, 16, **kinds)


@pytest.mark.parametrize("env_id", ["CartPole", "Blackjack"])
def test_rows_of_a_second_thread_are_the_same(env_id: str, monkeypatch: pytest.MonkeyPatch) -> None:
    net = made(env_id, sharing="indicator")
    space = get_spec(env_id).observation_space
    obs = torch.from_numpy(np.stack([np.asarray(space.sample()) for _ in range(101)]))
    position = torch.zeros(len(obs), dtype=torch.int64)
    found = []
    for rows in (4, 1000):
        monkeypatch.setattr(network, "SHARED_ROWS", rows)
        with torch.no_grad():
            found.append(net(obs, position))
    assert torch.equal(*found)


def test_a_fault_in_either_half_is_raised() -> None:
    second_thread = importlib.import_module("pearl_marl.policies.second_thread")

    done: list[tuple[int, int]] = []

    def fails(rows: slice, at: int) -> None:
        done.append((rows.start, rows.stop))
        if rows.start <= at < rows.stop:
            raise ValueError("a row that cannot be done")

    for at in (0, 9):
        with pytest.raises(ValueError, match="cannot be done"):
            second_thread.over_rows(10, 2, lambda rows, at=at: fails(rows, at))
    assert {(0, 5), (5, 10)} == set(done)


def test_statistics_are_those_of_all_rows(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(network, "SEEN_NUMBERS", 30)
    encoder = made("CartPole").encoder
    obs = 5 + 3 * torch.randn(100, 4)
    encoder.see(obs[:40])
    encoder.see(obs[40:])
    # The statistics begin as if a ten-thousandth of a row had been seen.
    torch.testing.assert_close(encoder.mean, obs.double().mean(0), rtol=1e-5, atol=0)
    torch.testing.assert_close(encoder.variance, obs.double().var(0, correction=0), rtol=1e-4, atol=0)
