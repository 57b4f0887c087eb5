"""How many multiplications networks take, as PyTorch itself counts them."""

from __future__ import annotations

import importlib
from typing import Any

import pytest

from pearl_marl.envs import get_spec

torch = pytest.importorskip("torch", reason="torch is not installed: pip install '.[train]'")
peak = importlib.import_module("pearl_marl.experiments.learner_peak")
ppo = importlib.import_module("pearl_marl.training.ppo")
actor_critic = importlib.import_module("pearl_marl.training.actor_critic")
flops = importlib.import_module("torch.utils.flop_counter")


def model_of(name: str) -> Any:
    return actor_critic.ActorCritic.of(get_spec(name), ppo.PPOSettings(width=8))


def test_multiplications_are_those_that_pytorch_counts() -> None:
    """Of a picture's network, as PyTorch learns no other, but for its filters; two operations each."""
    model = model_of("Breakout")
    with flops.FlopCounterMode(display=False) as counter:
        outputs, values = model(actor_critic.Inputs(torch.rand(16, 10, 10, 4) < 0.2))
        forward = counter.get_total_flops() / 32
        (outputs.sum() + values.sum()).backward()
    assert (forward, counter.get_total_flops() / 32 - forward) == peak.multiplications(model, 0)


def test_multiplications_of_vectors_numbers_and_filters() -> None:
    """By hand: CartPole's four numbers, FrozenLake's tables, Breakout's filters; with a critic each."""
    forward = 2 * (4 * 8 + 8 * 8) + (2 + 1) * 8
    assert peak.multiplications(model_of("CartPole"), 0) == (forward, 2 * forward - 2 * 4 * 8)
    forward = 2 * 8 * 8 + (4 + 1) * 8
    assert peak.multiplications(model_of("FrozenLake"), 0) == (forward, 2 * forward)
    few, more = (peak.multiplications(model_of("Breakout"), elements) for elements in (0, 2.5))
    assert (more[0] - few[0], more[1] - few[1]) == (16 * 9 * 2.5, 2 * 16 * 9 * 2.5)
