"""The compiled gradients of PQN's loss are those of autograd, and layer norm is PyTorch's."""

from __future__ import annotations

from functools import partial
from typing import Any

import pytest
import torch

from pearl_marl.envs import get_spec
from pearl_marl.policies import network
from pearl_marl.training import halves
from pearl_marl.training.pqn import PQN
from pearl_marl.training.run import settings_for


@pytest.mark.parametrize("in_halves", [False, True])
@pytest.mark.parametrize(
    "env_id", ["CartPole", "FrozenLake", "LevelBasedForaging", "Seaquest", "ConnectFour"]
)
def test_gradients_are_those_of_pytorch(
    env_id: str, in_halves: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    spec = get_spec(env_id)
    small = {"n_agents": 64, "rollout_length": 4, "width": 40, "sharing": "indicator"}
    trainer = PQN(spec, "native", settings_for("pqn", env_id, small))
    samples = trainer.worker.gather(0).flat()
    trainer.model.see(samples.inputs)
    torch.manual_seed(1)
    with torch.no_grad():
        for parameter in trainer.model.parameters():
            parameter += 0.1 * torch.randn(parameter.shape)
    rows = samples.loss_mask.nonzero()[:, 0]
    rows = rows[torch.randperm(len(rows))[:200]]
    monkeypatch.setattr(halves, "SECOND_THREAD", 1 if in_halves else 1 << 30)
    compiled: Any = trainer.loops(samples)
    assert compiled is not None
    results = []
    for gradients in (compiled, partial(trainer.autograd, samples)):
        loss = gradients(rows)
        results.append((loss.float(), [parameter.grad.clone() for parameter in trainer.model.parameters()]))
        monkeypatch.setattr(network, "is_dense", lambda _: False)
    torch.testing.assert_close(*results, rtol=1e-4, atol=2e-5)
