"""Settings of trainings, found by trial on one machine."""

from __future__ import annotations

from typing import Any

from pearl_marl.envs.minatar import PQN_PRESET, PRESET

PRESETS: dict[str, dict[str, Any]] = {
    "ppo": PRESET,
    "pqn": PQN_PRESET,
    # As many steps in memory as MinAtar's own DQN keeps; for each that is taken, four are learned from.
    "dqn": {
        "n_agents": 256,
        "iterations": 6000,
        "memory": 400,
        "learning_rate": 5e-4,
        "target_update": 200,
        "final_epsilon": 0.05,
        "exploration_fraction": 0.1,
        "width": 128,
    },
}
