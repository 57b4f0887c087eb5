"""Gradients that autograd finds by halves are those of the whole minibatch, by however many threads."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from typing import Any

import pytest
import torch

from pearl_marl.envs import get_spec
from pearl_marl.training import halves
from pearl_marl.training.recurrent import chunked
from pearl_marl.training.run import ALGORITHMS, settings_for

pytestmark = pytest.mark.usefixtures("toys")

SMALL = {"n_agents": 64, "rollout_length": 8, "minibatch": 201, "width": 16}


@pytest.fixture(autouse=True)
def _threads(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setattr(halves, "SECOND_THREAD", 1)
    threads = torch.get_num_threads()
    yield
    torch.set_num_threads(threads)


MEMORY = {"memory": "gru", "chunk_length": 4}


def made(algorithm: str, env_id: str = "Breakout", **given: Any) -> Any:
    settings = settings_for(algorithm, env_id, {**SMALL, **given}, agents=get_spec(env_id).agents)
    return ALGORITHMS[algorithm](get_spec(env_id), "native", settings)


def gathered(trainer: Any) -> tuple[Any, Any]:
    """Return a rollout's samples, and every other row, chunk or world that is learned from."""
    for number in range(3):  # of Meadow's 20 cycles, the last is in the third
        rollout = trainer.worker.gather(number)
    samples, learned_from = rollout.flat(), rollout.loss_mask.flatten()
    if trainer.policy.remembers:
        samples = chunked(rollout, trainer.settings.chunk_length)
        learned_from = samples.loss_mask.any(0)
    rows = learned_from.nonzero()[:, 0]
    if trainer.of_teams:
        rows = torch.unique(rows // trainer.worker.spec.agents)
    return samples, rows[::2][:201]


def found(trainer: Any, samples: Any, rows: Any) -> list[Any]:
    """Return the losses and the gradients of some rows."""
    with trainer.halves.shared(len(rows), torch.get_num_threads()):
        losses = trainer.autograd(samples, rows)
    return [losses, *(parameter.grad.clone() for parameter in trainer.model.parameters())]


@pytest.mark.parametrize(
    ("algorithm", "env_id", "given"),
    [
        ("ppo", "Breakout", {}),
        ("pqn", "Breakout", {}),
        ("ppo", "Breakout", MEMORY),
        # Where agents end before their world, or a limit ends it, steps of chunks are not learned from.
        *((algorithm, "Meadow", MEMORY) for algorithm in ("ppo", "pqn", "vdn", "qmix")),
        ("qmix", "Meadow", {}),
    ],
)
def test_halves_make_the_whole(
    algorithm: str, env_id: str, given: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    trainer = made(algorithm, env_id, **given)
    samples, rows = gathered(trainer)
    terms = torch.tensor([trainer.terms(samples, row[None]) for row in rows])
    rows = rows[terms.argsort()]
    assert (terms.min() < terms.max()) == (env_id == "Meadow" and bool(given))
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


def test_a_single_row_is_not_halved() -> None:
    """It may be a chunk with as many samples as a large minibatch has."""
    trainer, asked = made("ppo", **MEMORY), []

    def loss(rows: Any) -> Any:
        asked.append(len(rows))
        return sum(parameter.sum() for parameter in trainer.model.parameters()), torch.ones(4)

    trainer.halves.find(torch.zeros(1, dtype=torch.int64), loss, len)
    trainer.halves.find(torch.zeros(2, dtype=torch.int64), loss, len)
    assert asked == [1, 1, 1]


def test_two_threads_learn_a_memory_to_the_weights_of_one() -> None:
    """PyTorch itself has one thread there; the second one is for a half of each minibatch."""
    weights = []
    for threads in (1, 2):
        trainer, names = made("ppo", "CartPole", **MEMORY), set()
        autograd = trainer.halves._of

        def noted(*given: Any, names: set[str] = names, autograd: Any = autograd) -> Any:
            names.add(threading.current_thread().name)
            return autograd(*given)

        trainer.halves._of = noted
        torch.set_num_threads(threads)
        trainer.iterate()
        assert len(names) == threads
        weights.append(trainer.policy.state_dict())
    for name, tensor in weights[0].items():
        assert torch.equal(tensor, weights[1][name]), name


def test_threads_are_given_back() -> None:
    trainer = made("ppo")

    def failing(*_: Any) -> None:
        assert torch.get_num_threads() == 1
        raise ValueError("no loss")

    def fail() -> None:
        with trainer.halves.shared(9, 2):
            trainer.halves.find(torch.arange(9), failing, len)

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
