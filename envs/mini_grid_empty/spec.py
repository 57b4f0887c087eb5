"""The spec of MiniGridEmpty: MiniGrid's arguments."""

from __future__ import annotations

from functools import partial

from pearl_marl.checks import checked_integer
from pearl_marl.envs.mini_grid import THINGS, Rules
from pearl_marl.envs.mini_grid_spec import checked_max_steps, checked_start, rewards_until, spec_parts
from pearl_marl.spec import EnvSpec

from .step import boxes, make_golden

SIZES = (4, 32)


def configure(
    size: int = 8,
    agent_start_pos: tuple[int, int] | None = (1, 1),
    agent_start_dir: int = 0,
    max_steps: int | None = None,
) -> EnvSpec:
    """Return the spec under MiniGrid's keyword arguments.

    Parameters
    ----------
    size
        Columns and rows with the outer walls, 4 to 32.
    agent_start_pos, agent_start_dir
        Column and row where the agent starts, and its direction: 0 right, 1 down, 2 left, 3 up. With a
        position of None both are drawn.
    max_steps
        The time limit; None is ``4 * size**2``.
    """
    size = checked_integer("size", size, *SIZES)
    start = checked_start(size, agent_start_pos, agent_start_dir)
    rules = Rules(size, size, checked_max_steps(max_steps, 4 * size**2))
    return EnvSpec(
        **spec_parts(
            "Empty",
            "Empty-8x8",
            THINGS,
            partial(boxes, rules),
            {
                "size": size,
                "agent_start_pos": start and start[:2],
                "agent_start_dir": agent_start_dir,
                "max_steps": max_steps,
            },
        ),
        summary="Walk to a goal through an empty room",
        rewards=rewards_until(rules.max_steps),
        golden=make_golden(rules, start),
        max_cycles=rules.max_steps,
        configure=configure,
    )


SPEC = configure()
