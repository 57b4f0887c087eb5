"""Settings of trainings, found by trial on one machine."""

from __future__ import annotations

from typing import Any

PRESETS: dict[str, dict[str, Any]] = {
    # The goal is far: its value has to travel back. It is worth 100.
    "ppo": {
        "n_agents": 2048,
        "rollout_length": 16,
        "iterations": 100,
        "learning_rate": 1e-3,
        "discount": 0.99,
        "gae_lambda": 0.98,
        "reward_scale": 0.1,
    },
}
