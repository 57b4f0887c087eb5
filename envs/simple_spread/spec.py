"""The spec of SimpleSpread: what the platform has to know besides the dynamics in ``step.py``."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from gymnasium.spaces import Box, Discrete

from pearl_marl.checks import checked_flag, checked_integer, checked_number
from pearl_marl.layout import Real
from pearl_marl.spec import EnvSpec

from .presets import PRESETS
from .step import make_golden

MOST_AGENTS = 6


def configure(N: int = 3, local_ratio: float = 0.5, continuous_actions: bool = False) -> EnvSpec:  # noqa: N803
    """Return the spec under MPE's keyword arguments.

    Parameters
    ----------
    N
        How many agents there are, and how many landmarks, 2 to 6.
    local_ratio
        How much an agent's own collisions count, 0 to 1; the rest is for what all share.
    continuous_actions
        Whether an action says how much to push each way, rather than which.
    """
    n = checked_integer("N", N, 2, MOST_AGENTS)
    local_ratio = checked_number("local_ratio", local_ratio, 0, 1)
    continuous = checked_flag("continuous_actions", continuous_actions)

    def draw(state: Any) -> npt.NDArray[np.uint8]:
        """Draw a state as MPE does; it needs MPE2."""
        from pearl_marl.envs import particles_oracle

        return particles_oracle.drawn(state, "simple_spread", N=n)

    return EnvSpec(
        name="SimpleSpread",
        version=0,
        summary="Cover all landmarks, an agent each, without collisions",
        rewards=None,
        reward=Real[-15, 0],
        observation_space=Box(-np.inf, np.inf, (4 + 2 * n + 4 * (n - 1),), np.float32),
        action_space=Box(0, 1, (5,), np.float32) if continuous else Discrete(5),
        golden=make_golden(n, local_ratio),
        agents=n,
        max_cycles=25,
        options={"N": n, "local_ratio": local_ratio, "continuous_actions": continuous},
        configure=configure,
        peers={"MPE2": "mpe2.simple_spread_v3:parallel_env"},
        presets=PRESETS,
        draw=draw,
        follows="MPE2 simple_spread_v3",
        render_modes=("rgb_array",),
        render_fps=10,
    )


SPEC = configure()
