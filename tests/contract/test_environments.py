"""The contract, over every environment of the registry and the toys, on every device of this machine.

Its tests are those of :mod:`pearl_marl.testing`, which environments of other packages run too.
"""

from __future__ import annotations

import pytest

import pearl_marl
from pearl_marl.testing import Case, ContractSuite, assert_same_trajectory, rows, trajectory

from ..toy import TOYS


class TestEnvironments(ContractSuite):
    environments = tuple(pearl_marl.envs())
    devices = ("native", "rtl")

    @pytest.mark.slow
    def test_a_million_slots(self, native: Case) -> None:
        # A million, but no more than 100 MB of observations.
        row = native.spec.observation_size * native.spec.observation_dtype.itemsize
        n, small = min(1_000_000, 100_000_000 // row), 1000
        actions = native.actions(12, n)
        runs = []
        for size in (n, small):
            device = native.open(size, max_cycles=5)
            device.reset(seed=8)
            runs.append(trajectory(device, actions[:, :size].copy()))
        assert_same_trajectory(rows(runs[0], 0, small), runs[1])


@pytest.mark.usefixtures("toys")
class TestToys(ContractSuite):
    """What the environments are in every respect that matters to a device, in a few small ones."""

    environments = tuple(spec.name for spec in TOYS)
    devices = ("native",)


@pytest.mark.usefixtures("toys")
class TestSlowDevices(ContractSuite):
    """The devices that compare. Above, every environment is compared with them.

    What is left to show is that they are devices as the others are, and for that the toys, which have
    one of everything, do as well as all environments.
    """

    environments = ("CliffWalking", *(spec.name for spec in TOYS))
    devices = ("reference", "lockstep")
