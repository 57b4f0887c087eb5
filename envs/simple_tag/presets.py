"""Settings of trainings, found by trial on one machine."""

from __future__ import annotations

from typing import Any

from pearl_marl.envs.simple_spread.presets import PARTICLES

PRESETS: dict[str, dict[str, Any]] = {
    "ppo": PARTICLES | {"n_agents": 1024, "iterations": 100},
}
