"""Settings of trainings, found by trial on one machine."""

from __future__ import annotations

from typing import Any

# A player that always does the same is seen through: much entropy, and actions stay random.
POKER: dict[str, Any] = {
    "n_agents": 1024,
    "rollout_length": 16,
    "iterations": 100,
    "minibatch": 1024,
    "learning_rate": 1e-3,
    "discount": 1.0,
    "entropy": 0.1,
    "width": 32,
    "join_every": 5,
    "temperature": 1.0,
}

PRESETS: dict[str, dict[str, Any]] = {"self-play": POKER}
