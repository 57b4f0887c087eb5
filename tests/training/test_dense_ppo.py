"""What is learned by compiled loops is what PPO's operations of PyTorch learn."""

from __future__ import annotations

from typing import Any

import pytest
import torch
from torch import Tensor

from pearl_marl.registry import get_spec
from pearl_marl.training import dense_ppo
from pearl_marl.training.actor_critic import View
from pearl_marl.training.dense_ppo import Learning, fits
from pearl_marl.training.run import ALGORITHMS, settings_for

ROWS = 200


def trainer_with_experience(algorithm: str, env_id: str) -> tuple[Any, View, list[Tensor], Tensor]:
    """A trainer far from its first weights, with a rollout of other ones, and rows of it to learn from."""
    spec = get_spec(env_id)
    small = {"n_agents": 64, "rollout_length": 8, "minibatch": ROWS, "entropy": 0.05}
    trainer = ALGORITHMS[algorithm](spec, "native", settings_for(algorithm, env_id, small))
    experience = trainer.worker.gather(0)
    view, rows = experience.view.flat(), experience.learned.flatten().nonzero()[:, 0]
    trainer.model.see(view)
    actions, logs, advantages, returns = (part.flatten(0, 1) for part in experience[1:5])
    torch.manual_seed(1)
    logs = logs + 0.3 * torch.randn(logs.shape)  # some ratios are to be clipped
    with torch.no_grad():
        for parameter in trainer.model.parameters():
            parameter += 0.1 * torch.randn(parameter.shape)
    some = rows[torch.randperm(len(rows))[:ROWS]]
    return trainer, view, [actions, logs, advantages, returns], some


def learned(trainer: Any, learn: Any, rows: Tensor) -> tuple[Tensor, list[Tensor]]:
    found = learn(rows)
    return found.float(), [parameter.grad.clone() for parameter in trainer.model.parameters()]


@pytest.mark.parametrize(
    ("algorithm", "env_id"),
    [
        ("ppo", "CartPole"),
        ("ppo", "FrozenLake"),
        ("ppo", "Blackjack"),
        ("ppo", "Pendulum"),
        ("ppo", "LevelBasedForaging"),
        ("mappo", "LevelBasedForaging"),
    ],
)
@pytest.mark.parametrize("halves", [False, True])
def test_gradients_are_those_of_pytorch(
    algorithm: str, env_id: str, halves: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(dense_ppo, "WORTH", 1 if halves else 1 << 30)
    trainer, view, parts, rows = trainer_with_experience(algorithm, env_id)
    settings = trainer.settings
    found = learned(trainer, Learning(trainer.model, view, parts, settings.clip, settings.entropy), rows)
    wanted = learned(trainer, lambda some: trainer.learn_by_torch(view, parts, some), rows)
    torch.testing.assert_close(found, wanted, rtol=1e-4, atol=2e-5)
    assert 0.1 < float(found[0][3]) < 0.9, "ratios were to be clipped, and others not"


@pytest.mark.parametrize("n", [1, 2, 63, 65])
def test_minibatches_of_any_size(n: int) -> None:
    trainer, view, parts, rows = trainer_with_experience("ppo", "CartPole")
    learn = Learning(trainer.model, view, parts, trainer.settings.clip, trainer.settings.entropy)
    found = learned(trainer, learn, rows[:n])
    wanted = learned(trainer, lambda some: trainer.learn_by_torch(view, parts, some), rows[:n])
    torch.testing.assert_close(found, wanted, rtol=1e-4, atol=2e-5)


def test_actions_that_were_not_allowed() -> None:
    trainer, view, parts, rows = trainer_with_experience("ppo", "LevelBasedForaging")
    masks = (torch.rand(len(view.obs), trainer.model.policy.outputs) < 0.5).to(torch.int8)
    masks[torch.arange(len(masks)), parts[0]] = 1
    view = view._replace(masks=masks)
    learn = Learning(trainer.model, view, parts, trainer.settings.clip, trainer.settings.entropy)
    found = learned(trainer, learn, rows)
    wanted = learned(trainer, lambda some: trainer.learn_by_torch(view, parts, some), rows)
    torch.testing.assert_close(found, wanted, rtol=1e-4, atol=2e-5)


def test_pictures_and_networks_apart_are_left_to_pytorch() -> None:
    for env_id in ("Seaquest", "CoinGame"):
        spec = get_spec(env_id)
        small = {"n_agents": 4, "rollout_length": 2}
        assert not fits(ALGORITHMS["ppo"](spec, "native", settings_for("ppo", env_id, small)).model)
