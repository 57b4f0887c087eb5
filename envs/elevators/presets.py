"""Settings of trainings, found by trial on one machine."""

from __future__ import annotations

from typing import Any

PRESETS: dict[str, dict[str, Any]] = {
    # Some hundred is lost in an episode: rewards are made small.
    "ppo": {"minibatch": 2048, "discount": 0.95, "reward_scale": 0.1},
}
