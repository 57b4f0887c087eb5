"""EnvPool's environments of one agent, as Gymnasium's vector environments."""

from __future__ import annotations

from typing import Any

import envpool

NAMES = {"CartPole": "CartPole-v1", "MountainCar": "MountainCar-v0", "FrozenLake": "FrozenLake-v1"}
"""EnvPool's names of environments, by ours."""


def environments(env_id: str, n: int, seed: int) -> Any:
    """Return EnvPool's form of an environment of ours, ``n`` of it."""
    return envpool.make(NAMES.get(env_id, env_id), env_type="gymnasium", num_envs=n, seed=seed)
