"""What is written out of the trainers' gradients and of Adam, against autograd and PyTorch's."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor, nn
from torch.distributions import Categorical, Normal

from pearl_marl.policies.network import Network
from pearl_marl.registry import get_spec
from pearl_marl.training.actor_critic import ActorCritic
from pearl_marl.training.adam import Adam


def textbook(model: ActorCritic, outputs: Tensor, actions: Tensor) -> tuple[Tensor, Tensor]:
    """Return logarithms of probabilities, and the entropy, as PyTorch has them."""
    if not model.continuous:
        chosen: Any = Categorical(logits=outputs)
        return chosen.log_prob(actions), chosen.entropy().mean()
    chosen = Normal(outputs, model.log_deviation.exp().expand_as(outputs))
    return chosen.log_prob(actions).sum(-1), chosen.entropy().sum(-1).mean()


@pytest.mark.parametrize("name", ["CartPole", "Pendulum", "Taxi"])
def test_gradients_of_probabilities(name: str) -> None:
    torch.manual_seed(0)
    spec = get_spec(name)
    model = ActorCritic(spec, 8)
    outputs = torch.randn(64, model.policy.outputs, requires_grad=True)
    actions = outputs.detach() + torch.randn(64, 1) if model.continuous else torch.randint(2, (64,))
    logs, entropy = textbook(model, outputs, actions)
    weighed = model.weigh(outputs, actions)
    torch.testing.assert_close(weighed.logs, logs.detach())
    torch.testing.assert_close(weighed.entropy, entropy.detach())
    by_logs = torch.randn(64)
    (logs @ by_logs + 0.3 * entropy).backward()
    tensors = [outputs, *([model.log_deviation] if model.continuous else [])]
    found = weighed.gradients(by_logs, 0.3)
    assert [tensor is known for (tensor, _), known in zip(found, tensors, strict=True)] == [True] * len(
        tensors
    )
    for tensor, gradient in found:
        torch.testing.assert_close(gradient, tensor.grad)


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


@pytest.mark.parametrize("longest", [0.5, 1e9])
def test_adam_is_that_of_pytorch(longest: float) -> None:
    torch.manual_seed(0)
    mine, other = nn.Linear(5, 3), nn.Linear(5, 3)
    other.load_state_dict(mine.state_dict())
    optimiser = Adam(mine.parameters(), epsilon=1e-5, longest=longest)
    known = torch.optim.Adam(other.parameters(), eps=1e-5)
    for rate in (1e-2, 1e-2, 3e-3, 1e-3):
        given, gradient = torch.randn(7, 5), torch.randn(7, 3)
        optimiser.backward([(mine(given), gradient)])
        optimiser.step(rate)
        known.zero_grad()
        (other(given) * gradient).sum().backward()
        nn.utils.clip_grad_norm_(other.parameters(), longest)
        known.param_groups[0]["lr"] = rate
        known.step()
        torch.testing.assert_close(mine.state_dict(), other.state_dict())


def test_adam_goes_on() -> None:
    torch.manual_seed(0)
    models = [nn.Linear(4, 2) for _ in range(2)]
    optimisers = [Adam(model.parameters(), epsilon=1e-8, longest=10.0) for model in models]
    given = torch.randn(5, 4)
    for _ in range(3):
        optimisers[0].backward([(models[0](given), torch.ones(5, 2))])
        optimisers[0].step(0.1)
    models[1].load_state_dict(models[0].state_dict())
    optimisers[1].load_state_dict(optimisers[0].state_dict())
    for model, optimiser in zip(models, optimisers, strict=True):
        optimiser.backward([(model(given), torch.ones(5, 2))])
        optimiser.step(0.1)
    assert torch.equal(models[0].weight, models[1].weight)
