"""Importing this registers PettingZoo's Connect Four with Gymnasium, as one that moves for both players.

Gymnasium imports it for the id ``"pearl_marl.envs.connect_four.oracle:PettingZoo/ConnectFour-v3"``.
"""

from __future__ import annotations

from typing import Any

import gymnasium
from pettingzoo.classic.connect_four import connect_four


class BothPlayers(gymnasium.Env[Any, Any]):
    """PettingZoo's ``connect_four_v3``, whose player on turn is the one that acts and observes."""

    metadata = connect_four.raw_env.metadata

    def __init__(self, render_mode: str | None = None) -> None:
        self.render_mode = render_mode
        self.game = connect_four.raw_env(render_mode=render_mode)
        player = self.game.possible_agents[0]
        self.observation_space = self.game.observation_space(player)["observation"]
        self.action_space = self.game.action_space(player)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, Any]:
        """Begin a game."""
        super().reset(seed=seed)
        self.game.reset(seed=seed)
        return self._observed(), {}

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Drop a disc; in a full column it loses the game, as in PettingZoo's own wrapper."""
        player = self.game.agent_selection
        if self.game.board[action]:
            return self._observed(), -1.0, True, False, {}
        self.game.step(int(action))
        return self._observed(), self.game.rewards[player], self.game.terminations[player], False, {}

    def render(self) -> Any:
        """Draw the board as PettingZoo does."""
        return self.game.render()

    def close(self) -> None:
        """Close the window, if there is one."""
        self.game.close()

    def _observed(self) -> Any:
        return self.game.observe(self.game.agent_selection)["observation"]


if "PettingZoo/ConnectFour-v3" not in gymnasium.registry:
    gymnasium.register("PettingZoo/ConnectFour-v3", entry_point=f"{__name__}:{BothPlayers.__name__}")
