"""skrl trains on environments as they are, through its own wrappers of PettingZoo's and Gymnasium's forms."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from gymnasium.spaces import Discrete

import pearl_marl
from pearl_marl import wrappers

pytest.importorskip("skrl", reason="skrl is not installed: make test-clients")
import torch
from skrl.envs.wrappers.torch import wrap_env
from skrl.utils.runner.torch import Runner

NETWORK = [{"name": "net", "input": "OBSERVATIONS", "layers": [8], "activations": "elu"}]


def config(folder: Path, agent: str, action_space: Any) -> dict[str, Any]:
    policy = "CategoricalMixin" if isinstance(action_space, Discrete) else "GaussianMixin"
    models = {
        "policy": {"class": policy, "network": NETWORK, "output": "ACTIONS"},
        "value": {"class": "DeterministicMixin", "network": NETWORK, "output": "ONE"},
    }
    experiment = {"directory": str(folder), "write_interval": 0, "checkpoint_interval": 0}
    trainer = {"class": "SequentialTrainer", "timesteps": 32, "disable_progressbar": True, "headless": True}
    return {
        "seed": 0,
        "models": {"separate": True, **models},
        "memory": {"class": "RandomMemory", "memory_size": -1},
        "agent": {"class": agent, "rollouts": 8, "learning_epochs": 2, "experiment": experiment},
        "trainer": {**trainer, "environment_info": "none", "close_environment_at_exit": False},
    }


def within_bounds(env: Any) -> Any:
    """Its Gaussian policies draw any number."""
    return env if isinstance(env.batch.action_space, Discrete) else wrappers.clip_actions_v0(env)


@pytest.mark.parametrize("agent", ["IPPO", "MAPPO"])
@pytest.mark.parametrize("name", ["CartPole", "Pendulum"])
def test_many_agents(name: str, agent: str, tmp_path: Path) -> None:
    """It takes their spaces from ``observation_spaces`` and ``action_spaces``."""
    inside = within_bounds(pearl_marl.parallel_env(name, 4, max_cycles=5))
    env = wrap_env(inside, wrapper="pettingzoo", verbose=False)
    settings = config(tmp_path, agent, inside.batch.action_space)
    settings["agent"]["learning_rate_scheduler_kwargs"] = {agent: {} for agent in env.possible_agents}
    runner = Runner(env, settings)
    models = runner.agent.models
    before = {name: value.clone() for name, value in models["agent_0"]["policy"].state_dict().items()}
    runner.run()
    after = models["agent_0"]["policy"].state_dict()
    assert any(not torch.equal(after[name], before[name]) for name in before)


def test_what_it_sees() -> None:
    inside, twin = (pearl_marl.parallel_env("CartPole", 3, max_cycles=2) for _ in range(2))
    env = wrap_env(inside, wrapper="pettingzoo", verbose=False)
    observations, _ = env.reset()
    twin.load_state(inside.save_state())
    for _ in range(3):
        actions = {agent: torch.tensor([[1]]) for agent in env.agents}
        observations, rewards, _, truncated, _ = env.step(actions)
        step = twin.step_batch([1, 1, 1])
        np.testing.assert_array_equal(torch.cat(list(observations.values())).numpy(), step.obs)
        np.testing.assert_array_equal(torch.cat(list(rewards.values())).numpy()[:, 0], step.rewards)
        assert [bool(flag) for flag in truncated.values()] == step.truncations.tolist()


@pytest.mark.parametrize("mode", ["NextStep", "SameStep"])
@pytest.mark.parametrize("wrap", [lambda env: env, wrappers.clip_reward_v0])
@pytest.mark.parametrize("name", ["CartPole", "Pendulum"])
def test_vector_environments(name: str, wrap: Any, mode: str, tmp_path: Path) -> None:
    inside = within_bounds(wrap(pearl_marl.make_vec(name, 4, autoreset_mode=mode, max_cycles=5)))
    env = wrap_env(inside, wrapper="gymnasium", verbose=False)
    Runner(env, config(tmp_path, "PPO", inside.single_action_space)).run()
