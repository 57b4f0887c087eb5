"""Settings of trainings, found by trial on one machine."""

from __future__ import annotations

from typing import Any

from pearl_marl.envs.minatar import PQN_PRESET, PRESET

PRESETS: dict[str, dict[str, Any]] = {
    # To come up for air is of no use until the air is gone: much entropy, and a long view. With half the
    # entropy, two trainings of ten did not get to what MinAtar's DQN reached; with this, none of eight.
    "ppo": PRESET | {"iterations": 250, "discount": 0.995, "entropy": 0.06},
    "pqn": PQN_PRESET | {"iterations": 250},
}
