"""The spec of MyEnvironment: what the platform has to know besides ``step.py``."""

from gymnasium.spaces import Discrete
from pearl_marl.errors import ArgumentError
from pearl_marl.spec import EnvSpec, Field, Golden

from .step import initial, make_step, observe


def configure(slip: int = 1) -> EnvSpec:
    """Return the spec under the environment's arguments, each of which is an option with a default.

    Parameters
    ----------
    slip
        Of eight steps, how many the robot stays where it is, on average.
    """
    if isinstance(slip, bool) or not isinstance(slip, int) or not 0 <= slip <= 7:
        raise ArgumentError(f"slip is {slip!r}; it must be an integer from 0 to 7")
    return EnvSpec(
        name="MyEnvironment",
        version=0,  # a new one for every change of the dynamics
        summary="Walk along a slippery corridor, away from the pit",
        # The words, field by field, the first in the lowest bits. These widths are the hardware's.
        state=(Field("cell", 4),),
        action=Field("action", 1),
        observation=(Field("cell", 4),),
        reward=Field("category", 2),
        rewards=(-1.0, 20.0, -20.0),  # by category; None where the reward field is the value itself
        # What an agent sees of it: a field a Discrete, a field an element of a Box.
        observation_space=Discrete(16),
        action_space=Discrete(2),
        golden=Golden(initial, make_step(slip), observe),
        reset_draws=1,
        step_draws=1,
        max_cycles=50,  # steps after which an episode is truncated; None for no limit
        options={"slip": slip},
        configure=configure,
    )


SPEC = configure()
