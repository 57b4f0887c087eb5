"""Gradients that autograd finds by halves are those of the whole minibatch, by however many threads."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest
import torch

from pearl_marl.envs import get_spec
from pearl_marl.training import halves
from pearl_marl.training.run import ALGORITHMS, settings_for

SMALL = {"n_agents": 64, "rollout_length": 8, "minibatch": 201, "width": 16}


@pytest.fixture(autouse=True)
def _threads(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setattr(halves, "SECOND_THREAD", 1)
    threads = torch.get_num_threads()
    yield
    torch.set_num_threads(threads)


def made(algorithm: str, env_id: str = "Breakout", **given: Any) -> Any:
    settings = settings_for(algorithm, env_id, {**SMALL, **given})
    return ALGORITHMS[algorithm](get_spec(env_id), "native", settings)


def found(trainer: Any, samples: Any, rows: Any) -> list[Any]:
    """Return the losses and the gradients of some rows."""
    with trainer.halves.shared(len(rows)):
        losses = trainer.autograd(samples, rows)
    return [losses, *(parameter.grad.clone() for parameter in trainer.model.parameters())]


@pytest.mark.parametrize("algorithm", ["ppo", "pqn"])
def test_halves_make_the_whole(algorithm: str, monkeypatch: pytest.MonkeyPatch) -> None:
    trainer = made(algorithm)
    samples = trainer.worker.gather(0).flat()
    rows = torch.arange(len(samples.actions))[::2][:201]
    by_threads = []
    for threads in (1, 2):
        torch.set_num_threads(threads)
        by_threads.append(found(trainer, samples, rows))
    for one, two in zip(*by_threads, strict=True):
        assert torch.equal(one, two)
    monkeypatch.setattr(halves, "SECOND_THREAD", 1 << 30)
    whole = found(trainer, samples, rows)
    assert any(gradient.abs().max() > 1e-3 for gradient in whole[1:])
    for expected, halved in zip(whole, by_threads[0], strict=True):
        torch.testing.assert_close(halved, expected, rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize(
    ("algorithm", "env_id", "given"),
    [
        ("ppo", "Breakout", {"memory": "gru", "chunk_length": 4}),
        ("vdn", "Overcooked", {}),  # whose rows are worlds in which somebody acts
        ("qmix", "Overcooked", {}),
        ("ppo", "Breakout", {}),
    ],
)
def test_only_means_of_rows_are_halved(algorithm: str, env_id: str, given: dict[str, Any]) -> None:
    """With a memory, a loss is the mean of those of its rows that are learned from."""
    trainer = made(algorithm, env_id, **given)
    asked: list[int] = []

    def loss(rows: Any) -> Any:
        asked.append(len(rows))
        return sum(parameter.sum() for parameter in trainer.model.parameters()), rows.float().mean()

    torch.set_num_threads(2)
    with trainer.halves.shared(9):
        assert torch.get_num_threads() == (2 if given else 1)
        assert trainer.halves.find(torch.arange(9), loss) == 4
    assert sorted(asked) == ([9] if given else [4, 5])


def test_threads_are_given_back() -> None:
    trainer = made("ppo")

    def failing(*_: Any) -> None:
        assert torch.get_num_threads() == 1
        raise ValueError("no loss")

    def fail() -> None:
        with trainer.halves.shared(9):
            trainer.halves.find(torch.arange(9), failing)

    torch.set_num_threads(2)
    with pytest.raises(ValueError, match="no loss"):
        fail()
    assert torch.get_num_threads() == 2
    trainer.iterate()
    assert torch.get_num_threads() == 2


def test_loops_have_a_second_thread_where_pytorch_has_one(monkeypatch: pytest.MonkeyPatch) -> None:
    trainer = made("ppo", "CartPole", minibatch=512, width=128)
    both, shared = halves.both, []

    def counted(one: Any, other: Any) -> Any:
        shared.append(torch.get_num_threads())
        return both(one, other)

    monkeypatch.setattr(halves, "both", counted)
    torch.set_num_threads(2)
    trainer.iterate()
    assert set(shared) == {1}
    torch.set_num_threads(1)
    shared.clear()
    trainer.iterate()
    assert not shared
