"""Importing this registers MinAtar's environments with Gymnasium, which does not find them by itself.

Gymnasium imports it for the id ``"pearl_marl.envs.seaquest.oracle:MinAtar/Seaquest-v1"``.
"""

from __future__ import annotations

import gymnasium

from pearl_marl.errors import PearlError

try:
    from minatar.gym import register_envs
except ImportError as error:
    raise PearlError("Seaquest is drawn by MinAtar: pip install '.[render]'") from error

if "MinAtar/Seaquest-v1" not in gymnasium.registry:
    register_envs()
