"""Settings of trainings, found by trial on one machine."""

from __future__ import annotations

from typing import Any

# A random player brings a shelf in one episode of sixty: rewards are made large, so that the first few count.
# Robots that hardly see each other earn by chance: only large batches show the value of an action.
AGENTS: dict[str, Any] = {
    "n_agents": 4096,
    "rollout_length": 64,
    "iterations": 240,
    "minibatch": 8192,
    "learning_rate": 3e-3,
    "discount": 0.99,
    "gae_lambda": 0.95,
    "entropy": 0.01,
    "reward_scale": 10.0,
    "sharing": "indicator",
    "temperature": 0.7,
}

TEAM: dict[str, Any] = {
    "n_agents": 1024,
    "rollout_length": 32,
    "iterations": 150,
    "minibatch": 2048,
    "learning_rate": 2e-3,
    "q_lambda": 0.9,
    "exploration_fraction": 0.4,
    "reward_scale": 10.0,
    "sharing": "indicator",
    "evaluation_epsilon": 0.05,
}

PRESETS: dict[str, dict[str, Any]] = {"ppo": AGENTS, "mappo": AGENTS, "vdn": TEAM, "qmix": TEAM}
