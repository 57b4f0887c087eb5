"""The spec of Acrobot: what the platform has to know besides the dynamics in ``step.py``."""

from __future__ import annotations

from typing import Any

import numpy as np
from gymnasium import Env
from gymnasium.spaces import Box, Discrete

from pearl_marl.checks import checked_choice
from pearl_marl.spec import EnvSpec, Golden

from .presets import PRESETS
from .step import MAX_VEL_1, MAX_VEL_2, State, View, initial, make_step, observe

HIGH = np.array([1, 1, 1, 1, MAX_VEL_1, MAX_VEL_2], np.float32)


def pose(oracle: Env[Any, Any], state: State) -> None:
    """Put Gymnasium's Acrobot into a state, for rendering."""
    oracle.state = np.array(state)  # type: ignore[attr-defined]


def configure(book_or_nips: str = "book") -> EnvSpec:
    """Return the spec; the argument is an attribute of Gymnasium's environment.

    Parameters
    ----------
    book_or_nips
        Whose equations: ``"book"`` for Sutton and Barto's book, ``"nips"`` for Sutton's paper.
    """
    checked_choice("book_or_nips", book_or_nips, ("book", "nips"))
    return EnvSpec(
        name="Acrobot",
        version=0,
        summary="Swing two links up by a torque at the joint between them",
        rewards=(-1.0, 0.0),
        observation_space=Box(-HIGH, HIGH, dtype=np.float32),
        action_space=Discrete(3),
        golden=Golden(State, initial, make_step(book_or_nips == "nips"), observe, view=View),
        max_cycles=500,
        options={"book_or_nips": book_or_nips},
        configure=configure,
        peers={"EnvPool": "Acrobot-v1", "gymnax": "Acrobot-v1"},
        presets=PRESETS,
        oracle="pearl_marl.envs.acrobot.oracle:Gymnasium/Acrobot-v1",
        follows="Gymnasium Acrobot-v1",
        pose=pose,
        render_modes=("human", "rgb_array"),
        render_fps=15,
    )


SPEC = configure()
