"""Settings of trainings, found by trial on one machine."""

from __future__ import annotations

from typing import Any

from pearl_marl.envs.mini_grid_spec import PRESET

PRESETS: dict[str, dict[str, Any]] = {
    # Many places look alike: actions are sampled, so that an agent does not walk in circles.
    "ppo": PRESET | {"gae_lambda": 0.95, "temperature": 1.0},
}
