"""The spec of SimpleTag: what the platform has to know besides the dynamics in ``step.py``."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from gymnasium.spaces import Box, Discrete

from pearl_marl.checks import checked_flag, checked_integer
from pearl_marl.layout import Real
from pearl_marl.spec import EnvSpec, Role

from .presets import PRESETS
from .step import CAUGHT, make_golden

MOST_OF_A_KIND = 4


def configure(
    num_good: int = 1,
    num_adversaries: int = 3,
    num_obstacles: int = 2,
    continuous_actions: bool = False,
    terminate_on_success: bool = False,
) -> EnvSpec:
    """Return the spec under MPE's keyword arguments.

    Parameters
    ----------
    num_good, num_adversaries, num_obstacles
        How many agents are chased, how many chase them, and how many obstacles are in their way, 1 to 4 of
        each. Adversaries are the first agents of a world.
    continuous_actions
        Whether an action says how much to push each way, rather than which.
    terminate_on_success
        Whether an episode ends when adversaries touch all good agents at once.
    """
    good = checked_integer("num_good", num_good, 1, MOST_OF_A_KIND)
    adversaries = checked_integer("num_adversaries", num_adversaries, 1, MOST_OF_A_KIND)
    obstacles = checked_integer("num_obstacles", num_obstacles, 1, MOST_OF_A_KIND)
    continuous = checked_flag("continuous_actions", continuous_actions)
    terminates = checked_flag("terminate_on_success", terminate_on_success)
    options = {"num_good": good, "num_adversaries": adversaries, "num_obstacles": obstacles}

    size = 4 + 2 * obstacles + 2 * (good + adversaries - 1) + 2 * good
    all_elements, without_own_velocity = (Box(-np.inf, np.inf, (k,), np.float32) for k in (size, size - 2))
    action_space = Box(0, 1, (5,), np.float32) if continuous else Discrete(5)
    chasing = Role("adversary", all_elements, action_space)
    chased = Role("agent", without_own_velocity, action_space)

    def draw(state: Any) -> npt.NDArray[np.uint8]:
        """Draw a state as MPE does; it needs MPE2."""
        from pearl_marl.envs import particles_oracle

        return particles_oracle.drawn(state, "simple_tag", **options)

    return EnvSpec(
        name="SimpleTag",
        version=0,
        summary="Chase agents that are faster, or get away from all who chase",
        rewards=None,
        reward=Real[-CAUGHT * adversaries - 20, CAUGHT * adversaries * good],
        observation_space=all_elements,
        action_space=action_space,
        roles=(*[chasing] * adversaries, *[chased] * good),
        golden=make_golden(good, adversaries, obstacles, terminates),
        agents=good + adversaries,
        max_cycles=25,
        options={**options, "continuous_actions": continuous, "terminate_on_success": terminates},
        configure=configure,
        peers={"MPE2": "mpe2.simple_tag_v3:parallel_env"},
        presets=PRESETS,
        draw=draw,
        follows="MPE2 simple_tag_v3",
        render_modes=("rgb_array",),
        render_fps=10,
    )


SPEC = configure()
