"""The spec of MiniGridMemory: MiniGrid's arguments."""

from __future__ import annotations

from functools import partial
from typing import Any

from pearl_marl.checks import checked_flag, checked_integer
from pearl_marl.envs.mini_grid import Rules
from pearl_marl.envs.mini_grid_spec import checked_max_steps, rewards_until, spec_parts
from pearl_marl.errors import ArgumentError
from pearl_marl.spec import EnvSpec

from .step import THINGS, boxes, make_golden

SIZES = (7, 31)


def configure(size: int = 13, random_length: bool = False, max_steps: int | None = None) -> EnvSpec:
    """Return the spec under MiniGrid's keyword arguments.

    Parameters
    ----------
    size
        Columns and rows with the outer walls, an odd number from 7 to 31.
    random_length
        Whether the length of the hall is drawn.
    max_steps
        The time limit; None is ``5 * size**2``.
    """
    size = checked_integer("size", size, *SIZES)
    if size % 2 == 0:
        raise ArgumentError(f"size is {size}; it must be odd, so that the hall is in the middle")
    rules = Rules(size, size, checked_max_steps(max_steps, 5 * size**2))

    def pose_ends(game: Any, state: Any) -> None:
        """Tell MiniGrid's game where the episode ends."""
        above, below = ((state.hall + 1, size // 2 + down) for down in (-1, 1))
        same_above = state.shows_key == state.key_above
        game.success_pos, game.failure_pos = (above, below) if same_above else (below, above)

    return EnvSpec(
        **spec_parts(
            "Memory",
            "MemoryS13",
            THINGS,
            partial(boxes, rules),
            {
                "size": size,
                "random_length": checked_flag("random_length", random_length),
                "max_steps": max_steps,
            },
            pose_more=pose_ends,
        ),
        summary="Remember a thing, and go to its like at the end of a hall",
        rewards=rewards_until(rules.max_steps),
        golden=make_golden(rules, random_length),
        max_cycles=rules.max_steps,
        configure=configure,
    )


SPEC = configure()
