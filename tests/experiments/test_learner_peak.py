"""How many multiplications networks take, as PyTorch itself counts them."""

from __future__ import annotations

import importlib
from typing import Any

import numpy as np
import pytest

from pearl_marl.envs import get_spec

torch = pytest.importorskip("torch", reason="torch is not installed: pip install '.[train]'")
peak = importlib.import_module("pearl_marl.experiments.learner_peak")
ppo = importlib.import_module("pearl_marl.training.ppo")
actor_critic = importlib.import_module("pearl_marl.training.actor_critic")
flops = importlib.import_module("torch.utils.flop_counter")


def model_of(name: str) -> Any:
    return actor_critic.ActorCritic(get_spec(name), ppo.PPOSettings(width=8))


def test_multiplications_are_those_that_pytorch_counts() -> None:
    """Of the layers behind a picture's first, as PyTorch learns no others; two operations each."""
    model = model_of("Breakout")
    with flops.FlopCounterMode(display=False) as counter:
        outputs, values = model(actor_critic.Inputs(torch.rand(16, 10, 10, 4) < 0.2))
        forward = counter.get_total_flops() / 32
        (outputs.sum() + values.sum()).backward()
    assert (forward, counter.get_total_flops() / 32 - forward) == peak.multiplications(model, (0, 0))


def test_multiplications_of_vectors_numbers_and_pictures() -> None:
    """By hand: CartPole's four numbers, FrozenLake's tables, Breakout's pictures; with a critic each."""
    forward = 2 * (4 * 8 + 8 * 8) + (2 + 1) * 8
    assert peak.multiplications(model_of("CartPole"), (0, 0)) == (forward, 2 * forward - 2 * 4 * 8)
    forward = 2 * 8 * 8 + (4 + 1) * 8
    assert peak.multiplications(model_of("FrozenLake"), (0, 0)) == (forward, 2 * forward)
    few, more = (peak.multiplications(model_of("Breakout"), squares) for squares in ((0, 0), (3, 2.5)))
    made, summed = 16 * 2.5, 3 * 16 * 8
    assert (more[0] - few[0], more[1] - few[1]) == (made + summed, 2 * made + 2 * summed)


def test_squares_that_are_multiplied() -> None:
    """Each once that differs from others of its place, and is not empty."""
    pictures = np.zeros((4, 3, 4, 2), np.uint8)
    assert peak.squares_of(pictures) == (0, 0)
    pictures[1:, 1, 1, 0] = 1  # in both squares of three pictures
    pictures[3, 2, 3, 1] = 1  # and in the second square of the last
    assert peak.squares_of(pictures) == ((1 + 2) / 4, (1 + 1 + 2) / 4)
