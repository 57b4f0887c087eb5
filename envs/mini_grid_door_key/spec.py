"""The spec of MiniGridDoorKey: MiniGrid's arguments."""

from __future__ import annotations

from functools import partial

from pearl_marl.checks import checked_integer
from pearl_marl.envs.mini_grid import Rules
from pearl_marl.envs.mini_grid_spec import checked_max_steps, rewards_until, spec_parts
from pearl_marl.spec import EnvSpec

from .presets import PRESETS
from .step import KEY, THINGS, boxes, make_golden

SIZES = (5, 32)


def configure(size: int = 8, max_steps: int | None = None) -> EnvSpec:
    """Return the spec under MiniGrid's keyword arguments.

    Parameters
    ----------
    size
        Columns and rows with the outer walls, 5 to 32.
    max_steps
        The time limit; None is ``10 * size**2``.
    """
    size = checked_integer("size", size, *SIZES)
    rules = Rules(size, size, checked_max_steps(max_steps, 10 * size**2))
    return EnvSpec(
        **spec_parts(
            "DoorKey",
            "DoorKey-8x8",
            THINGS,
            partial(boxes, rules),
            {"size": size, "max_steps": max_steps},
            carried=lambda state: THINGS[KEY] if state.key.carried else None,
        ),
        summary="Fetch the key that opens the door to the goal",
        rewards=rewards_until(rules.max_steps),
        golden=make_golden(rules),
        max_cycles=rules.max_steps,
        configure=configure,
        presets=PRESETS,
    )


SPEC = configure()
