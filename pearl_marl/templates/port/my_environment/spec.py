"""The spec of MyEnvironment: what the platform has to know besides ``step.py``."""

@spec_imports@
from .original import pose
from .step import @step_names@


def configure() -> EnvSpec:
    """Return the spec; give this function arguments, and it has options."""
    return EnvSpec(
        name="MyEnvironment",
        version=0,  # a new one for every change of the dynamics
        summary="@summary@",
@spec_agents@        rewards=REWARDS,@reward@
        observation_space=@observation_space@,
        action_space=@action_space@,@action@
        golden=Golden(State, initial, step, observe@golden_view@),
        max_cycles=@max_cycles@,  # steps after which an episode is truncated; None for no limit
        configure=configure,
        pose=pose,
@more@    )


SPEC = configure()
