"""Settings of trainings, found by trial on one machine."""

from __future__ import annotations

from typing import Any

PRESETS: dict[str, dict[str, Any]] = {
    # Two players that share nothing: each has a network of its own.
    "ppo": {
        "n_agents": 512,
        "rollout_length": 16,
        "minibatch": 2048,
        "entropy": 0.01,
        "sharing": "none",
        "temperature": 1.0,
    },
}
