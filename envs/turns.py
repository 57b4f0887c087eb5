"""Importing this registers PettingZoo's games of turns with Gymnasium, as ones that move for both players.

Gymnasium imports it for an id such as ``"pearl_marl.envs.turns:PettingZoo/ConnectFour-v3"``.
"""

from __future__ import annotations

import importlib
from typing import Any

import gymnasium

GAMES = {"ConnectFour-v3": "connect_four", "TicTacToe-v3": "tictactoe"}
"""Modules of ``pettingzoo.classic``, by the names here."""


class BothPlayers(gymnasium.Env[Any, Any]):
    """A game of PettingZoo's, whose player on turn is the one that acts and observes."""

    metadata = {"render_modes": ["human", "rgb_array"]}  # noqa: RUF012 - Gymnasium's own way to say it

    def __init__(self, module: str, render_mode: str | None = None) -> None:
        self.render_mode = render_mode
        self.game = importlib.import_module(f"pettingzoo.classic.{module}.{module}").raw_env(
            render_mode=render_mode
        )
        self.metadata = self.game.metadata
        player = self.game.possible_agents[0]
        self.observation_space = self.game.observation_space(player)["observation"]
        self.action_space = self.game.action_space(player)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, Any]:
        """Begin a game."""
        super().reset(seed=seed)
        self.game.reset(seed=seed)
        return self._view()["observation"], {}

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Move; an illegal move loses the game, as in PettingZoo's own wrapper."""
        player = self.game.agent_selection
        if not self._view()["action_mask"][action]:
            return self._view()["observation"], -1.0, True, False, {}
        self.game.step(int(action))
        reward, over = self.game.rewards[player], self.game.terminations[player]
        return self._view()["observation"], reward, over, False, {}

    def render(self) -> Any:
        """Draw the board as PettingZoo does."""
        return self.game.render()

    def close(self) -> None:
        """Close the window, if there is one."""
        self.game.close()

    def _view(self) -> Any:
        """Return the observation and the mask of the player on turn."""
        return self.game.observe(self.game.agent_selection)


for name, module in GAMES.items():
    if f"PettingZoo/{name}" not in gymnasium.registry:
        gymnasium.register(
            f"PettingZoo/{name}",
            entry_point=f"{__name__}:{BothPlayers.__name__}",
            kwargs={"module": module},
        )
