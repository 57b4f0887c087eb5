"""Settings of trainings, found by trial on one machine."""

from __future__ import annotations

from typing import Any

from pearl_marl.envs.mini_grid_spec import PRESET

PRESETS: dict[str, dict[str, Any]] = {
    # For a size of 5.
    "ppo": PRESET | {"iterations": 120},
}
