"""MyEnvironment: the contract that every environment keeps, and every transition of the original."""

from pearl_marl import get_spec
from pearl_marl.porting import Original, first_wrong_transition
from pearl_marl.testing import ContractSuite

ENVIRONMENT = "my_environment:MyEnvironment"


class TestContract(ContractSuite):
    """What every environment must do; on the simulated hardware, where this machine can build it."""

    environments = (ENVIRONMENT,)
    devices = ("native", "rtl")


def test_every_transition() -> None:
    """Next state, reward and end are the original's, and probabilities within 2**-31 of its own."""
    original = Original(@original_arguments@)
    assert first_wrong_transition(get_spec(ENVIRONMENT), original) is None
