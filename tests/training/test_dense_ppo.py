"""The compiled gradients of PPO's loss are those of autograd."""

from __future__ import annotations

import threading
from collections.abc import Callable
from functools import partial
from typing import Any

import pytest
import torch
from torch import Tensor

from pearl_marl.envs import get_spec
from pearl_marl.training import dense_ppo, halves
from pearl_marl.training.dense_ppo import PPOGradients, fits, in_one_loop
from pearl_marl.training.ppo import PPO
from pearl_marl.training.rollout import RolloutBuffer
from pearl_marl.training.run import ALGORITHMS, settings_for

ROWS = 200


def trainer_with_samples(
    algorithm: str, env_id: str, minibatch: int = ROWS
) -> tuple[Any, RolloutBuffer, Tensor]:
    """A trainer far from its first weights, with a rollout of other ones, and rows of it to learn from."""
    spec = get_spec(env_id)
    small: dict[str, Any] = {"n_agents": 64, "rollout_length": 8, "minibatch": minibatch}
    if algorithm != "pqn":
        small["entropy"] = 0.05
    trainer = ALGORITHMS[algorithm](spec, "native", settings_for(algorithm, env_id, small))
    samples = trainer.worker.gather(0).flat()
    rows = samples.loss_mask.nonzero()[:, 0]
    trainer.model.see(samples.inputs)
    torch.manual_seed(1)
    moved = samples.log_probs + 0.3 * torch.randn(samples.log_probs.shape)  # some ratios are to be clipped
    with torch.no_grad():
        for parameter in trainer.model.parameters():
            parameter += 0.1 * torch.randn(parameter.shape)
    return trainer, samples._replace(log_probs=moved), rows[torch.randperm(len(rows))[:ROWS]]


def compiled_and_wanted(
    trainer: Any, samples: RolloutBuffer, rows: Tensor
) -> list[tuple[Tensor, list[Tensor]]]:
    settings, results = trainer.settings, []
    compiled = PPOGradients(trainer.model, samples, settings.clip, settings.entropy)
    for gradients in (compiled, partial(trainer.autograd, samples)):
        figures = gradients(rows)
        results.append(
            (figures.float(), [parameter.grad.clone() for parameter in trainer.model.parameters()])
        )
    return results


@pytest.mark.parametrize(
    ("algorithm", "env_id"),
    [
        ("ppo", "CartPole"),
        ("ppo", "FrozenLake"),
        ("ppo", "Blackjack"),
        ("ppo", "Pendulum"),
        ("ppo", "LevelBasedForaging"),
        ("mappo", "LevelBasedForaging"),
        ("ppo", "Seaquest"),
        ("ppo", "ConnectFour"),
    ],
)
@pytest.mark.parametrize("in_halves", [False, True])
def test_gradients_are_those_of_pytorch(
    algorithm: str, env_id: str, in_halves: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(halves, "SECOND_THREAD", 1 if in_halves else 1 << 30)
    found, wanted = compiled_and_wanted(*trainer_with_samples(algorithm, env_id))
    torch.testing.assert_close(found, wanted, rtol=1e-4, atol=2e-5)
    assert 0.1 < float(found[0][3]) < 0.9, "ratios were to be clipped, and others not"


@pytest.mark.parametrize("n", [1, 2, 63, 65])
def test_minibatches_of_any_size(n: int) -> None:
    trainer, samples, rows = trainer_with_samples("ppo", "CartPole")
    torch.testing.assert_close(*compiled_and_wanted(trainer, samples, rows[:n]), rtol=1e-4, atol=2e-5)


def test_rows_that_share_a_state() -> None:
    """The critic is asked once for those that follow each other, of which here a world's first is missing."""
    trainer, samples, _ = trainer_with_samples("mappo", "LevelBasedForaging")
    agents = trainer.model.agents_per_state
    assert agents > 1
    worlds = torch.randperm(len(samples.actions) // agents)[:ROWS]
    rows = (worlds[:, None] * agents + torch.arange(agents)).flatten()[1:]
    torch.testing.assert_close(*compiled_and_wanted(trainer, samples, rows), rtol=1e-4, atol=2e-5)


def test_actions_that_were_not_allowed() -> None:
    trainer, samples, rows = trainer_with_samples("ppo", "LevelBasedForaging")
    masks = (torch.rand(len(samples.actions), trainer.model.policy.outputs) < 0.5).to(torch.int8)
    masks[torch.arange(len(masks)), samples.actions] = 1
    samples = samples._replace(inputs=samples.inputs._replace(masks=masks))
    torch.testing.assert_close(*compiled_and_wanted(trainer, samples, rows), rtol=1e-4, atol=2e-5)


def test_separate_networks_are_left_to_pytorch() -> None:
    small = {"n_agents": 4, "rollout_length": 2}
    settings = settings_for("ppo", "CoinGame", small)
    assert not fits(ALGORITHMS["ppo"](get_spec("CoinGame"), "native", settings).model)


@pytest.mark.parametrize(
    ("algorithm", "env_id"),
    [
        ("ppo", "CartPole"),
        ("ppo", "FrozenLake"),
        ("ppo", "Pendulum"),
        ("ppo", "LevelBasedForaging"),
        ("mappo", "LevelBasedForaging"),
    ],
)
def test_one_loop_learns_what_gradients_and_steps_learn(algorithm: str, env_id: str) -> None:
    """Bit by bit, in one thread and with a thread for each network."""
    found = []
    for threads in (0, 1, 2):
        trainer, samples, rows = trainer_with_samples(algorithm, env_id, minibatch=33)
        assert in_one_loop(trainer.model, trainer.minibatch)
        rows = rows.sort().values
        for rate in (1e-2, 1e-3):
            if threads:
                trainer.threads = threads
                losses = trainer.descend(samples, rows, rate)
            else:
                losses = super(PPO, trainer).descend(samples, rows, rate)
        found.append((losses, *trainer.model.parameters(), *trainer.optimiser.state_dict().values()))
    for other in found[1:]:
        for wanted, one in zip(found[0], other, strict=True):
            assert wanted == one if isinstance(wanted, int) else torch.equal(wanted, one)


@pytest.mark.parametrize("stopped", [dense_ppo.ACTOR, dense_ppo.CRITIC, None])
def test_a_loop_that_stops_stops_the_other(stopped: int | None, monkeypatch: pytest.MonkeyPatch) -> None:
    """Before any weight is moved; also where an interrupt comes before the first of them has begun."""
    trainer, samples, rows = trainer_with_samples("ppo", "CartPole")
    before = [parameter.clone() for parameter in trainer.model.parameters()]
    compiled, other = dense_ppo._descend_of(), []

    def stopping(network: int, *arguments: Any) -> None:
        if network == stopped:
            raise KeyboardInterrupt
        compiled(network, *arguments)

    def interrupted(_: Callable[[], None], second: Callable[[], None]) -> None:
        other.append(threading.Thread(target=second))
        other[0].start()
        raise KeyboardInterrupt

    monkeypatch.setattr(dense_ppo, "_descend_of", lambda: stopping)
    if stopped is None:
        monkeypatch.setattr(dense_ppo, "both", interrupted)
    trainer.threads = 2
    with pytest.raises(KeyboardInterrupt):
        trainer.descend(samples, rows, 1e-3)
    for thread in other:
        thread.join(60)
        assert not thread.is_alive()
    assert all(map(torch.equal, before, trainer.model.parameters()))


@pytest.mark.parametrize("n", [40, ROWS])
@pytest.mark.parametrize("algorithm", ["ppo", "pqn"])
def test_threads_change_nothing(algorithm: str, n: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of pictures, whether minibatches are halved or not."""
    monkeypatch.setattr(halves, "SECOND_THREAD", ROWS * 128)
    trainer, samples, rows = trainer_with_samples(algorithm, "Breakout")
    found, threads = [], torch.get_num_threads()
    try:
        for number in (1, 2, 4):
            torch.set_num_threads(number)
            gradients = trainer.loops(samples) or partial(trainer.autograd, samples)
            figures = gradients(rows[:n])
            found.append((figures, *(parameter.grad.clone() for parameter in trainer.model.parameters())))
    finally:
        torch.set_num_threads(threads)
    for other in found[1:]:
        assert all(torch.equal(one, two) for one, two in zip(found[0], other, strict=True))
