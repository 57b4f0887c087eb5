"""The contract as a class, or what of it is about devices, to be subclassed over environments and devices."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from pearl_marl.envs import get_spec
from pearl_marl.spec import EnvSpec
from pearl_marl.testing.agreement import AgreementContract
from pearl_marl.testing.buffers import BuffersContract
from pearl_marl.testing.case import Case
from pearl_marl.testing.determinism import DeterminismContract
from pearl_marl.testing.golden_functions import GoldenContract
from pearl_marl.testing.interfaces import InterfacesContract
from pearl_marl.testing.lifetimes import LifetimesContract
from pearl_marl.testing.saved_states import SavedStatesContract
from pearl_marl.testing.spaces import SpacesContract


class DeviceSuite(GoldenContract, AgreementContract, DeterminismContract):
    """The tests of the contract that need no interface; a subclass named ``Test...`` says of what.

    Attributes
    ----------
    environments
        Names as :func:`pearl_marl.get_spec` takes them: ``"MyEnv"``, or ``"my_package:MyEnv"``.
    devices
        Names of devices. ``"rtl"`` tests are skipped, with the reason, where there is no core or where it
        cannot be simulated. ``"lockstep"`` is the native device in lockstep with the reference.
    """

    environments: tuple[str, ...] = ()
    devices: tuple[str, ...] = ("native", "rtl")

    def pytest_generate_tests(self, metafunc: pytest.Metafunc) -> None:
        """Make a test of each pair, or of each environment where devices have no part in it."""
        if not self.environments:
            raise pytest.Collector.CollectError(f"{type(self).__name__}.environments names no environment")
        if "env_id" in metafunc.fixturenames:
            metafunc.parametrize("env_id", self.environments)
        if "device_name" in metafunc.fixturenames:
            metafunc.parametrize("device_name", self.devices)

    @pytest.fixture
    def spec(self, env_id: str) -> EnvSpec:
        """Return the spec of an environment, where devices have no part in the test."""
        return get_spec(env_id)

    @pytest.fixture
    def case(self, env_id: str, device_name: str) -> Iterator[Case]:
        """Yield an environment on a device."""
        case = Case(env_id, device_name)
        yield case
        case.close()

    @pytest.fixture
    def native(self, env_id: str) -> Iterator[Case]:
        """Yield an environment on the CPU, where the test is about that device."""
        case = Case(env_id, "native")
        yield case
        case.close()


class ContractSuite(
    DeviceSuite,
    SpacesContract,
    LifetimesContract,
    SavedStatesContract,
    BuffersContract,
    InterfacesContract,
):
    """Every test of the contract; a subclass says of what, as one of :class:`DeviceSuite` does."""
