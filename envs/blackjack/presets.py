"""Settings of trainings, found by trial on one machine."""

from __future__ import annotations

from typing import Any

PRESETS: dict[str, dict[str, Any]] = {
    "ppo": {},  # which `pearl train` takes, as it is the first
    # Rewards are random: entries have to become means of many targets.
    "q-learning": {"learning_rate": 1.0, "learning_rate_decay": 0.2, "epsilon": 0.5},
}
