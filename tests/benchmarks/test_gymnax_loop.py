"""What the loops on gymnax compute, beside what our trainers compute."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
import pytest
import torch

from pearl_marl.benchmark.training import TASKS, TrainingTask
from pearl_marl.policies.network import networks

jax = pytest.importorskip("jax")
pytest.importorskip("gymnax")
pytest.importorskip("optax")
gymnax_loop: Any = pytest.importorskip("pearl_marl.benchmark.trainers.gymnax_loop")
purejaxql: Any = pytest.importorskip("pearl_marl.benchmark.trainers.purejaxql")

PQN_TASKS = {task.env_id: task for task in TASKS if task.name.startswith("PQN ")}


class Steps(NamedTuple):
    values: Any
    rewards: Any
    dones: Any


def test_advantages_end_with_episodes() -> None:
    rng = np.random.default_rng(0)
    values, rewards = (rng.normal(size=(6, 3)).astype(np.float32) for _ in range(2))
    dones = rng.random((6, 3)) < 0.3
    last = rng.normal(size=3).astype(np.float32)
    settings = SimpleNamespace(discount=0.9, gae_lambda=0.7)
    found = gymnax_loop.advantages(Steps(values, rewards, dones), last, settings)
    returns, following = last, last  # lambda-returns, from the last step on
    for step in reversed(range(6)):
        mixed = 0.3 * following + 0.7 * returns
        returns = rewards[step] + 0.9 * np.where(dones[step], 0, mixed)
        assert found[step] == pytest.approx(returns - values[step], abs=1e-5)
        following = values[step]


@pytest.mark.parametrize("env_id", ["CartPole", "Breakout"])
def test_action_values_are_those_of_our_network(env_id: str) -> None:
    """Layer norm after each layer, tanh over vectors, and one convolution before the layers for pictures."""
    spec, width = PQN_TASKS[env_id].spec, 8
    space: Any = spec.action_space
    shape, n_actions = spec.observation_shape, int(space.n)
    params = purejaxql.weights(jax.random.key(0), shape, n_actions, width)
    ours: Any = networks(spec, n_actions, width, layer_norm=True)
    rng = np.random.default_rng(0)
    obs = rng.normal(size=(5, *shape)).astype(np.float32)
    if "kernel" in params:
        obs = (obs > 1).astype(np.uint8)
        kernel, bias = (torch.tensor(np.array(array)) for array in params["kernel"])
        ours.encoder.convolution.weight.data = kernel.permute(3, 2, 0, 1).contiguous()
        ours.encoder.convolution.bias.data = bias
    layers = ours.encoder.linear, ours.hidden, ours.output
    for layer, (matrix, bias) in zip(layers, params["layers"], strict=True):
        layer.weight.data = torch.tensor(np.array(matrix).T.copy())
        layer.bias.data = torch.tensor(np.array(bias))
    with torch.no_grad():
        expected = ours(torch.from_numpy(obs)).numpy()
    assert np.asarray(purejaxql.network(params, obs.astype(np.float32))) == pytest.approx(expected, abs=1e-4)


def test_environments_start_over_and_rewards_are_scaled() -> None:
    task: TrainingTask = PQN_TASKS["CartPole"]
    agents = gymnax_loop.GymnaxAgents(task, SimpleNamespace(n_agents=4, reward_scale=0.5))
    statistics, states, obs = agents.started(jax.random.key(0))
    step, ended = jax.jit(agents.stepped), np.zeros(4, bool)
    for k in range(20):
        actions = np.zeros(4, np.int32)
        statistics, states, obs, rewards, dones = step(statistics, states, actions, jax.random.key(k))
        assert (np.asarray(rewards) == 0.5).all()
        ended |= np.asarray(dones)
        assert (np.abs(obs[np.asarray(dones)]) <= 0.05).all(), "the first observation of an episode"
    assert ended.all(), "always to the left, a pole falls within 20 steps"
    assert statistics.count == pytest.approx(21 * 4, abs=1e-2)
