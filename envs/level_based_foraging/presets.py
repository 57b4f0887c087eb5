"""Settings of trainings, found by trial on one machine."""

from __future__ import annotations

from typing import Any

# Two agents that want to be in the same cell need to know which gives way, or act at random.
AGENTS: dict[str, Any] = {
    "n_agents": 512,
    "rollout_length": 16,
    "iterations": 120,
    "minibatch": 1024,
    "entropy": 0.01,
    "sharing": "indicator",
    "temperature": 1.0,
}

# Rewards are made large, to outdo the values that networks begin with. Two agents that want to be in the same
# cell need some random actions.
TEAM: dict[str, Any] = {
    "n_agents": 512,
    "rollout_length": 16,
    "iterations": 120,
    "minibatch": 512,
    "learning_rate": 2e-3,
    "discount": 0.95,
    "q_lambda": 0.8,
    "exploration_fraction": 0.3,
    "reward_scale": 10.0,
    "sharing": "indicator",
    "evaluation_epsilon": 0.1,
}

# Where two foods take two players, some runs learn to fetch one of them and stay with it. Of eight seeds, one
# of MAPPO did so with an entropy of 0.01, none with this.
CENTRAL: dict[str, Any] = {**AGENTS, "entropy": 0.02}

# Of eight seeds of QMIX, two did so with VDN's learning rate, agents and minibatch, none with these.
MIXED: dict[str, Any] = {
    **TEAM,
    "n_agents": 1024,
    "minibatch": 1024,
    "learning_rate": 4e-3,
    "discount": 0.9,
}

PRESETS: dict[str, dict[str, Any]] = {"ppo": AGENTS, "mappo": CENTRAL, "vdn": TEAM, "qmix": MIXED}
