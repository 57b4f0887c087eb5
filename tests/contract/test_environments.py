"""The contract, over every environment of the registry and the toys, on every device of this machine.

Its tests are those of :mod:`pearl_marl.testing`, which environments of other packages run too.
"""

from __future__ import annotations

import pytest

from pearl_marl.testing import Case, ContractSuite, assert_same_trajectory, rows, trajectory

from ..helpers import ENVIRONMENTS
from ..toy import TOYS


@pytest.mark.usefixtures("toys")
class TestEnvironments(ContractSuite):
    environments = ENVIRONMENTS
    devices = ("native", "rtl")

    @pytest.mark.slow
    def test_a_million_slots(self, native: Case) -> None:
        n, small = 1_000_000, 1000
        actions = native.actions(12, n)
        runs = []
        for size in (n, small):
            device = native.open(size, max_cycles=5)
            device.reset(seed=8)
            runs.append(trajectory(device, actions[:, :size].copy()))
        assert_same_trajectory(rows(runs[0], 0, small), runs[1])


@pytest.mark.usefixtures("toys")
class TestSlowDevices(ContractSuite):
    """The devices that compare: every environment is held against them above, and is nothing new to them.

    What the interfaces do with them is shown by environments that have one of everything.
    """

    environments = ("CliffWalking", *(spec.name for spec in TOYS))
    devices = ("reference", "lockstep")
