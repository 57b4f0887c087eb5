"""LevelBasedForaging as other libraries have it."""

from __future__ import annotations

import random
from typing import Any

from pearl_marl.spec import EnvSpec

OF_ENVPOOL = "Jumanji's rules: 2 foods and 100 steps; before EnvPool 1.2.6 every game starts alike"


def make(spec: EnvSpec) -> Any:
    """Return lbforaging's environment."""
    from lbforaging.foraging import ForagingEnv

    options = dict(spec.options)
    options["sight"] = options["sight"] or max(options["field_size"])
    return ForagingEnv(**options)


def choose(game: Any, chance: random.Random) -> Any:
    """Return a legal action of each player."""
    return chance.choice(game.get_valid_actions())
