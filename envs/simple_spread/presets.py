"""Settings of trainings, found by trial on one machine."""

from __future__ import annotations

from typing import Any

# An episode of 25 steps is a rollout. An agent has to know which of the landmarks is its own, or its role.
PARTICLES: dict[str, Any] = {
    "rollout_length": 25,
    "minibatch": 2048,
    "learning_rate": 2e-3,
    "discount": 0.95,
    "entropy": 0.01,
    "reward_scale": 0.1,
    "sharing": "indicator",
}

PRESETS: dict[str, dict[str, Any]] = {
    "ppo": PARTICLES | {"n_agents": 1536, "iterations": 150},
}
