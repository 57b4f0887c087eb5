"""The spec of MyEnvironment: what the platform has to know besides ``step.py``."""

from gymnasium.spaces import Discrete
from pearl_marl.checks import checked_integer
from pearl_marl.spec import EnvSpec, Golden

from .step import State, initial, make_step, observe


def configure(slip: int = 1) -> EnvSpec:
    """Return the spec under the environment's arguments, each of which is an option with a default.

    Parameters
    ----------
    slip
        Of eight steps, how many the robot stays where it is, on average.
    """
    slip = checked_integer("slip", slip, 0, 7)
    return EnvSpec(
        name="MyEnvironment",
        version=0,  # a new one for every change of the dynamics
        summary="Walk along a slippery corridor, away from the pit",
        rewards=(-1.0, 20.0, -20.0),  # by category; None where the step computes the value itself
        observation_space=Discrete(16),
        action_space=Discrete(2),
        golden=Golden(State, initial, make_step(slip), observe),
        max_cycles=50,  # steps after which an episode is truncated; None for no limit
        options={"slip": slip},
        configure=configure,
    )


SPEC = configure()
