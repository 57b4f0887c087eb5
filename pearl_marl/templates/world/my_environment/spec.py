"""The spec of MyEnvironment: what the platform has to know besides ``step.py``."""

import numpy as np
from gymnasium.spaces import Box, Discrete
from pearl_marl.checks import checked_integer
from pearl_marl.spec import EnvSpec, Golden

from .step import AGENTS, GOAL, State, View, initial, make_step, masks, observe


def configure(slip: int = 1) -> EnvSpec:
    """Return the spec under the environment's arguments, each of which is an option with a default.

    Parameters
    ----------
    slip
        Of eight steps, how many the cart stays where it is, on average.
    """
    slip = checked_integer("slip", slip, 0, 7)
    return EnvSpec(
        name="MyEnvironment",
        version=0,  # a new one for every change of the dynamics
        summary="Pull a cart to the goal together, though each would rather rest",
        agents=AGENTS,  # that share the state; what follows of actions and observations is one agent's
        rewards=(0.0, -1.0, 20.0, -20.0),  # by category; None where the step computes the value itself
        # What an agent sees: an element for each field of View.
        observation_space=Box(0, GOAL, (2,), np.uint8),
        action_space=Discrete(3),
        golden=Golden(State, initial, make_step(slip), observe, masks, View),
        masked="stay",  # masked actions are the step's affair; "refused" has the platform refuse them
        max_cycles=50,  # steps after which an episode is truncated; None for no limit
        options={"slip": slip},
        configure=configure,
    )


SPEC = configure()
