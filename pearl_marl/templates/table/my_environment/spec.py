"""The spec of MyEnvironment: what the platform has to know besides ``step.py``."""

@spec_imports@
from .step import @step_names@
from .tables import REWARDS
@pose@

def configure() -> EnvSpec:
    """Return the spec."""
    return EnvSpec(
        name="MyEnvironment",
        version=0,  # a new one for every change of the dynamics
        summary="@summary@",
        rewards=REWARDS,
        observation_space=@observation_space@,
        action_space=@action_space@,
        golden=Golden(State, initial, step, observe@golden_view@),
        max_cycles=@max_cycles@,  # steps after which an episode is truncated; None for no limit
        configure=configure,
@more@    )


SPEC = configure()
