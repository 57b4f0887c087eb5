"""Importing this registers MinAtar's environments with Gymnasium, which does not find them by itself.

Gymnasium imports it for ids such as ``"pearl_marl.envs.minatar_oracle:MinAtar/Seaquest-v1"``.
"""

from __future__ import annotations

import gymnasium
from minatar.gym import register_envs

if "MinAtar/Seaquest-v1" not in gymnasium.registry:
    register_envs()
