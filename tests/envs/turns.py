"""What the tests of PettingZoo's games of turns share."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from pearl_marl.porting.oracle import Ours, Outcome

Array = npt.NDArray[Any]


def seen(game: Any) -> Outcome:
    """Return what PettingZoo's game shows both players."""
    players = game.possible_agents
    views = [game.observe(player) for player in players]
    return Outcome(
        [view["observation"] for view in views],
        [game.rewards[player] for player in players],
        [game.terminations[player] for player in players],
        masks=[view["action_mask"] for view in views],
    )


def move(game: Any, actions: list[int], draws: list[int]) -> Outcome:
    """Move by the action of whose turn it is."""
    game.step(actions[game.possible_agents.index(game.agent_selection)])
    return seen(game)


def begin(game: Any, state: Any) -> None:
    assert not any(state.boards), "a game begins on an empty board"
    game.reset()


def legal(ours: Ours, generator: np.random.Generator) -> Array:
    """Choose any legal move of whose turn it is; and anything for the other player."""
    masks = ours.masks()
    chances = generator.random(masks.shape) * masks
    anything = generator.integers(masks.shape[2], size=masks.shape[:2])
    return np.where(masks.any(2), chances.argmax(2), anything)
