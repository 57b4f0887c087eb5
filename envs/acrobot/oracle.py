"""Importing this registers Gymnasium's Acrobot with an argument for the attribute ``book_or_nips``.

Gymnasium imports it for the id ``"pearl_marl.envs.acrobot.oracle:Gymnasium/Acrobot-v1"``.
"""

from __future__ import annotations

import gymnasium
from gymnasium.envs.classic_control.acrobot import AcrobotEnv


class Acrobot(AcrobotEnv):
    """Gymnasium's ``Acrobot-v1``."""

    def __init__(self, render_mode: str | None = None, book_or_nips: str = "book") -> None:
        super().__init__(render_mode)
        self.book_or_nips = book_or_nips


if "Gymnasium/Acrobot-v1" not in gymnasium.registry:
    limit = gymnasium.spec("Acrobot-v1").max_episode_steps
    entry_point = f"{__name__}:{Acrobot.__name__}"
    gymnasium.register("Gymnasium/Acrobot-v1", entry_point=entry_point, max_episode_steps=limit)
