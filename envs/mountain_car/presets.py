"""Settings of trainings, found by trial on one machine."""

from __future__ import annotations

from typing import Any

PRESETS: dict[str, dict[str, Any]] = {
    # First, as it learns this sooner than PPO, with every seed.
    "pqn": {
        "n_agents": 2048,
        "rollout_length": 16,
        "iterations": 150,
        "epochs": 4,
        "learning_rate": 2e-3,
        "q_lambda": 0.95,
    },
    "ppo": {
        # The goal is far: its value has to travel back through some 200 steps.
        "n_agents": 2048,
        "rollout_length": 16,
        "iterations": 150,
        "learning_rate": 1e-3,
        "discount": 0.99,
        "gae_lambda": 0.98,
    },
}
