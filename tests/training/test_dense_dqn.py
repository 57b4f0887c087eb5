"""The compiled gradients of DQN's loss are those of autograd."""

from __future__ import annotations

from typing import Any

import pytest
import torch

from pearl_marl.envs import get_spec
from pearl_marl.training.dqn import Minibatch
from pearl_marl.training.run import ALGORITHMS, settings_for


@pytest.mark.parametrize("n", [1, 64, 100])
@pytest.mark.parametrize("masked", [False, True])
@pytest.mark.parametrize("env_id", ["CartPole", "FrozenLake", "LevelBasedForaging"])
def test_gradients_are_those_of_pytorch(env_id: str, masked: bool, n: int) -> None:
    spec = get_spec(env_id)
    given = {"n_agents": 100 * spec.agents, "sharing": "indicator"}
    trainer: Any = ALGORITHMS["dqn"](spec, "native", settings_for("dqn", env_id, given))
    for _ in range(5):
        trainer.update()
    torch.manual_seed(1)
    with torch.no_grad():
        for parameter in (*trainer.policy.parameters(), *trainer.target.parameters()):
            parameter += 0.2 * torch.randn(parameter.shape)
    chosen = torch.arange(n)
    kept = {name: rows[:4].flatten(0, 1)[chosen] for name, rows in trainer.memory.items()}
    masks = (torch.rand(n, trainer.policy.outputs) < 0.5).to(torch.int8)
    masks[:, 0] = 1
    over, alive, rewards = torch.rand(n) < 0.2, torch.rand(n) < 0.8, torch.randn(n)
    kept |= {"over": over, "alive": alive, "rewards": rewards, "masks": masks if masked else None}
    minibatch = Minibatch(**kept, position=chosen % spec.agents)
    found = []
    for gradients in (trainer.compiled_gradients, trainer.gradients):
        loss = gradients(minibatch)
        found.append((loss.float(), [p.grad.clone() for p in trainer.policy.parameters()]))
    torch.testing.assert_close(*found, rtol=1e-4, atol=1e-5)
