"""The contract that every environment keeps: part 5 of PORTING.md, once all is filled in."""

import pytest
from pearl_marl.testing import ContractSuite

import my_environment


@pytest.mark.skipif(not hasattr(my_environment, "SPEC"), reason="not registered yet: see PORTING.md")
class TestContract(ContractSuite):
    """What every environment must do; on the simulated hardware, where this machine can build it."""

    environments = ("my_environment:MyEnvironment",)
    devices = ("native", "rtl")
