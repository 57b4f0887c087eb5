"""Settings of trainings, found by trial on one machine."""

from __future__ import annotations

from typing import Any

PRESETS: dict[str, dict[str, Any]] = {
    # For a grid of 6 by 6.
    "ppo": {
        "n_agents": 512,
        "minibatch": 2048,
        "learning_rate": 1e-3,
        "discount": 0.99,
        "entropy": 0.01,
        "iterations": 80,
    },
}
