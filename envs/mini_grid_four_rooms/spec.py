"""The spec of MiniGridFourRooms: MiniGrid's time limit."""

from __future__ import annotations

from functools import partial

from pearl_marl.envs.mini_grid import THINGS, Rules
from pearl_marl.envs.mini_grid_spec import checked_max_steps, rewards_until, spec_parts
from pearl_marl.spec import EnvSpec

from .presets import PRESETS
from .step import SIZE, boxes, make_golden


def configure(max_steps: int = 100) -> EnvSpec:
    """Return the spec under MiniGrid's keyword argument, the time limit."""
    rules = Rules(SIZE, SIZE, checked_max_steps(max_steps, 100))
    return EnvSpec(
        **spec_parts("FourRooms", "FourRooms", THINGS, partial(boxes, rules), {"max_steps": rules.max_steps}),
        summary="Find a goal in four rooms",
        rewards=rewards_until(rules.max_steps),
        golden=make_golden(rules),
        max_cycles=rules.max_steps,
        configure=configure,
        presets=PRESETS,
    )


SPEC = configure()
