"""Settings of trainings, found by trial on one machine."""

from __future__ import annotations

from typing import Any

from pearl_marl.envs.kuhn_poker.presets import POKER

PRESETS: dict[str, dict[str, Any]] = {
    "self-play": POKER | {"iterations": 200, "reward_scale": 0.2, "width": 64},
}
