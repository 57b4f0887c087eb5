"""Settings of trainings, found by trial on one machine."""

from __future__ import annotations

from typing import Any

PRESETS: dict[str, dict[str, Any]] = {
    # Fast rather than frugal: every step is learned from once, so another one costs little.
    "ppo": {
        "n_agents": 512,
        "epochs": 1,
        "minibatch": 512,
        "learning_rate": 1e-2,
        "width": 32,
    },
    "pqn": {
        "n_agents": 512,
        "epochs": 1,
        "minibatch": 512,
        "learning_rate": 1e-2,
        "q_lambda": 0.9,
        "width": 32,
    },
}
