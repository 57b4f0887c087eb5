"""Probabilities, the gradients of networks, and Adam, against those of PyTorch."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor, nn
from torch.distributions import Categorical, Normal

from pearl_marl.envs import get_spec
from pearl_marl.policies.network import Network
from pearl_marl.training.actor_critic import ActorCritic
from pearl_marl.training.adam import Adam
from pearl_marl.training.ppo import PPOSettings


def textbook(model: ActorCritic, outputs: Tensor, actions: Tensor) -> tuple[Tensor, Tensor]:
    """Return logarithms of probabilities, and the entropy, as PyTorch has them."""
    if not model.continuous:
        chosen: Any = Categorical(logits=outputs)
        return chosen.log_prob(actions), chosen.entropy().mean()
    chosen = Normal(outputs, model.log_deviation.exp().expand_as(outputs))
    return chosen.log_prob(actions).sum(-1), chosen.entropy().sum(-1).mean()


@pytest.mark.parametrize("name", ["CartPole", "Pendulum", "Taxi"])
def test_probabilities_and_entropy(name: str) -> None:
    torch.manual_seed(0)
    spec = get_spec(name)
    model = ActorCritic(spec, PPOSettings(width=8))
    outputs = torch.randn(64, model.policy.outputs)
    actions = outputs + torch.randn(64, 1) if model.continuous else torch.randint(2, (64,))
    torch.testing.assert_close(model.evaluate(outputs, actions), textbook(model, outputs, actions))


@pytest.mark.parametrize("name", ["CartPole", "Taxi", "LevelBasedForaging"])
def test_the_network_and_its_gradients(name: str) -> None:
    torch.manual_seed(0)
    spec = get_spec(name)
    network = Network(spec.observation_space, 3, 16, positions=spec.agents)
    obs = torch.as_tensor(np.array([spec.observation_space.sample() for _ in range(9)]))
    position = torch.arange(9) % spec.agents
    first = network.encoder(obs) + network.indicator(position)  # type: ignore[misc]
    plain = network.output(torch.tanh(network.hidden(torch.tanh(first))))
    outputs, weights = network(obs, position), torch.randn(9, 3)
    torch.testing.assert_close(outputs, plain)
    parameters = list(network.parameters())
    found, wanted = (torch.autograd.grad((x * weights).sum(), parameters) for x in (outputs, plain))
    torch.testing.assert_close(found, wanted)


@pytest.mark.parametrize("max_grad_norm", [0.5, 1e9])
def test_adam_is_that_of_pytorch(max_grad_norm: float) -> None:
    torch.manual_seed(0)
    mine, other = nn.Linear(5, 3), nn.Linear(5, 3)
    other.load_state_dict(mine.state_dict())
    optimiser = Adam(mine.parameters(), epsilon=1e-5, max_grad_norm=max_grad_norm)
    known = torch.optim.Adam(other.parameters(), eps=1e-5)
    for rate in (1e-2, 1e-2, 3e-3, 1e-3):
        given, gradient = torch.randn(7, 5), torch.randn(7, 3)
        optimiser.zero_grad()
        (mine(given) * gradient).sum().backward()
        optimiser.step(rate)
        known.zero_grad()
        (other(given) * gradient).sum().backward()
        nn.utils.clip_grad_norm_(other.parameters(), max_grad_norm)
        known.param_groups[0]["lr"] = rate
        known.step()
        torch.testing.assert_close(mine.state_dict(), other.state_dict())


def test_adam_goes_on() -> None:
    torch.manual_seed(0)
    models = [nn.Linear(4, 2) for _ in range(2)]
    optimisers = [Adam(model.parameters(), epsilon=1e-8, max_grad_norm=10.0) for model in models]
    given = torch.randn(5, 4)
    for _ in range(3):
        optimisers[0].zero_grad()
        models[0](given).sum().backward()
        optimisers[0].step(0.1)
    models[1].load_state_dict(models[0].state_dict())
    optimisers[1].load_state_dict(optimisers[0].state_dict())
    for model, optimiser in zip(models, optimisers, strict=True):
        optimiser.zero_grad()
        model(given).sum().backward()
        optimiser.step(0.1)
    assert torch.equal(models[0].weight, models[1].weight)
