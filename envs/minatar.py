"""What MinAtar's games have in common: their board, their actions and options, and MinAtar's own renderer.

Follows https://github.com/kenjyoung/MinAtar (1.0.15): K. Young and T. Tian, *MinAtar: An Atari-Inspired
Testbed for Thorough and Reproducible Reinforcement Learning Experiments*, 2019.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from gymnasium import Env
from gymnasium.spaces import Box, Discrete

from pearl_marl.checks import checked_flag, checked_number
from pearl_marl.golden import Draws, Word
from pearl_marl.spec import snake_case

SIDE, LAST = 10, 9
"""Cells of a row and a column of the board, and the last of them."""
NOTHING, LEFT, UP, RIGHT, DOWN, FIRE = range(6)
"""MinAtar's actions. Those that have an effect in a game are its minimal action set."""
FLAGS = "difficulty_ramping", "use_minimal_action_set"
"""The options that are true or false, in the order of a game's arguments."""

PRESET: dict[str, Any] = {
    "n_agents": 512,
    "iterations": 120,
    "minibatch": 1024,
    "learning_rate": 1e-3,
    "discount": 0.99,
    "gae_lambda": 0.95,
    "entropy": 0.01,
    "width": 128,
}
"""Settings of PPO for pictures of ten by ten, and points that come one at a time."""

PQN_PRESET: dict[str, Any] = {
    "n_agents": 512,
    "iterations": 120,
    "minibatch": 256,
    "learning_rate": 1e-3,
    "exploration_fraction": 0.1,
    "width": 128,
}
"""Settings of PQN for the same; small minibatches, since values take many updates to travel back."""


def checked_options(sticky_action_prob: float, *flags: bool) -> dict[str, Any]:
    """Return the options of a game after a check of each: a probability, and whether the others hold.

    The ``flags`` are those of :data:`FLAGS`, in their order; Seaquest has the first one only.
    """
    return {"sticky_action_prob": checked_number("sticky_action_prob", sticky_action_prob, 0, 1)} | {
        name: checked_flag(name, flag) for name, flag in zip(FLAGS[: len(flags)], flags, strict=True)
    }


def action_table(minimal: Sequence[int], use_minimal_action_set: bool) -> tuple[int, ...]:
    """Return for each number that an action's bits can hold its place in the minimal action set.

    Actions without effect are those of place 0, where nothing is done.
    """
    actions = list(minimal) if use_minimal_action_set else list(range(6))
    actions += [NOTHING] * (2 ** (len(actions) - 1).bit_length() - len(actions))
    return tuple(minimal.index(action) if action in minimal else 0 for action in actions)


def sticky(action: Word, last_action: Word, draws: Draws, probability: float) -> Word:
    """Return the action, or the last one with a probability; where that is 0, without a draw."""
    if probability == 0:
        return action
    return last_action if draws.chance(probability) else action


def spec_parts(
    name: str,
    channels: int,
    minimal: Sequence[int],
    attributes: Callable[[Any], dict[str, Any]],
    **options: Any,
) -> dict[str, Any]:
    """Return what the specs of the games have in common.

    Parameters
    ----------
    name
        The game's, ours and MinAtar's.
    channels
        How many the observation has.
    minimal
        The minimal action set.
    attributes
        Returns the attributes that MinAtar's game has in a state of ours.
    options
        As :func:`checked_options` returns them.
    """

    def pose(oracle: Env[Any, Any], state: Any) -> None:
        """Put MinAtar's game into a slot's state, for rendering."""
        game = oracle.game  # type: ignore[attr-defined]
        vars(game.env).update(attributes(state))
        game.last_action = minimal[state.last_action]

    return {
        "name": name,
        "version": 0,
        "observation_space": Box(0.0, 1.0, (SIDE, SIDE, channels), np.bool_),
        "action_space": Discrete(len(minimal) if options.get("use_minimal_action_set", True) else 6),
        "options": options,
        "oracle": f"pearl_marl.envs.minatar_oracle:MinAtar/{name}-v1",
        "follows": f"MinAtar {name}-v1",
        "peers": {"gymnax": f"{name}-MinAtar", "pgx": f"minatar-{snake_case(name)}"},
        "presets": {"ppo": PRESET, "pqn": PQN_PRESET},
        "pose": pose,
        "render_modes": ("human", "rgb_array"),
    }
