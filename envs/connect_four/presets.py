"""Settings of trainings, found by trial on one machine."""

from __future__ import annotations

from typing import Any

PRESETS: dict[str, dict[str, Any]] = {
    # One game is like another unless some moves are random.
    "self-play": {
        "n_agents": 512,
        "iterations": 80,
        "epochs": 2,
        "minibatch": 512,
        "learning_rate": 2e-3,
        "discount": 0.99,
        "entropy": 0.03,
        "reward_scale": 0.3,
        "width": 128,
        "random_moves": 0.3,
    },
}
