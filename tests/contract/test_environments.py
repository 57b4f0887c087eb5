"""The contract, over every environment of the registry and the toys, on every device of this machine.

Its tests are those of :mod:`pearl_marl.testing`, which environments of other packages run too.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import pytest

import pearl_marl
from pearl_marl.compiler.cuda_kernels import simulated
from pearl_marl.devices import Device, Lockstep, Sharded
from pearl_marl.spec import EnvSpec
from pearl_marl.testing import (
    HALF,
    SIZE,
    STEPS,
    Case,
    ContractSuite,
    DeviceSuite,
    assert_same_trajectory,
)
from pearl_marl.testing.golden_functions import GoldenContract
from pearl_marl.verification import runs, verify

from .. import sampling
from ..devices.boards import OwnBoard
from ..sampling import KINDS
from ..toy import TOYS
from ..toy_fields import FIELDS, RELAY, ROVER
from ..toy_world import MEADOW, WORLDS

TWO_SIZES = ("CliffWalking", "LevelBasedForaging", "Pendulum")
"""What is simulated at two sizes, of three processing elements and of one: an environment without draws,
one of several agents, and one of wide words. How slots fall to elements is no matter of an environment."""


class TwoSizesCase(Case):
    """A simulated device has another model for each size."""

    @property
    def sizes(self) -> tuple[int, ...]:
        return (HALF, SIZE) if self.device_name == "rtl" else super().sizes

    @property
    def splits(self) -> tuple[int, ...]:
        return (HALF,) if self.device_name == "rtl" else super().splits


class OfTwoSizes:
    """A suite whose simulated devices have two sizes where that may matter."""

    @pytest.fixture
    def case(self, env_id: str, device_name: str) -> Iterator[Case]:
        case = (TwoSizesCase if env_id in TWO_SIZES else Case)(env_id, device_name)
        yield case
        case.close()


class TestEnvironments(ContractSuite):
    environments = KINDS
    devices = ("native",)

    @pytest.mark.slow
    def test_a_million_agents(self, native: Case) -> None:
        # A million, but no more than 100 MB of observations. Of those only the first are kept.
        row = native.spec.observation_size * native.spec.observation_dtype.itemsize
        agents, small = native.spec.agents, 1000
        n, first = min(1_000_000, 100_000_000 // row) // agents, slice(small * agents)
        actions = native.actions(7, n)
        runs = []
        for size in (n, small):
            device = native.open(size, max_cycles=5, copy=False)
            device.reset(seed=8)
            given = actions[:, : size * agents]
            runs.append([device.step(row).map(lambda array: array[first].copy()) for row in given])
        assert_same_trajectory(*runs)


OTHER_ENVIRONMENTS = tuple(name for name in pearl_marl.list_envs() if name not in KINDS)


class TestOtherEnvironments(GoldenContract):
    """Their golden functions; what is compiled of these is compared below."""

    @pytest.fixture(params=OTHER_ENVIRONMENTS)
    def spec(self, request: pytest.FixtureRequest) -> EnvSpec:
        return pearl_marl.get_spec(request.param)


@pytest.mark.parametrize("name", OTHER_ENVIRONMENTS)
def test_other_environments_step_as_the_reference(name: str) -> None:
    """One mode of four with a time limit; what the contract asks besides is asked of each kind above."""
    plan = runs(pearl_marl.get_spec(name), 60, 192)
    if not sampling.exhaustive:
        limited = [run for run in plan if run.config.max_cycles]
        plan = [limited[OTHER_ENVIRONMENTS.index(name) % len(limited)]]
    for run in plan:
        for _ in verify(run, Lockstep("native", "reference"), seed=3):
            pass
        assert run.exact
    assert sum(run.episodes for run in plan) > 60, "the comparison has to see episodes end"


@pytest.mark.exhaustive
class TestOtherEnvironmentsInEveryForm(ContractSuite):
    environments = OTHER_ENVIRONMENTS
    devices = ("native",)


IN_EVERY_FORM = ("Blackjack", "CliffWalking", "ConnectFour", "Pendulum")
"""Which have observations and actions of all kinds, draws, masks and turns."""
OTHERS = tuple(name for name in pearl_marl.list_envs() if name not in IN_EVERY_FORM)


class TestSimulated(OfTwoSizes, ContractSuite):
    """The hardware behind every interface; in ``make test`` of one environment with turns, one of reals."""

    environments = IN_EVERY_FORM if sampling.exhaustive else ("ConnectFour", "Pendulum")
    devices = ("rtl",)


class TestSimulatedDevices(OfTwoSizes, DeviceSuite):
    """The hardware of other kinds. Interfaces ask no device which environment it has.

    In ``make test`` that is one of worlds, and planes. ``tests/rtl/test_cores.py`` holds the cores of all
    environments against their golden functions.
    """

    environments = (
        tuple(name for name in KINDS if name not in IN_EVERY_FORM) if sampling.exhaustive else ("Overcooked",)
    )
    devices = ("rtl",)


@pytest.mark.exhaustive
class TestSimulatedInEveryForm(OfTwoSizes, ContractSuite):
    environments = OTHERS
    devices = ("rtl",)


@pytest.mark.usefixtures("toys")
class TestToys(ContractSuite):
    """What the environments are in every respect that matters to a device, in a few small ones."""

    environments = tuple(spec.name for spec in TOYS)
    devices = ("native",)


@pytest.mark.usefixtures("toys")
class TestSlowDevices(ContractSuite):
    """The devices that compare. Above, every environment is compared with them.

    What is left to show is that they are devices as the others are, and for that a few do as well as all.
    """

    environments = ("CliffWalking", "Drift", "Ladder") if sampling.exhaustive else ("Ladder",)
    devices = ("reference", "lockstep")


@pytest.mark.usefixtures("toys")
class TestWorlds(DeviceSuite):
    """Slots of several agents, wherever they step; in ``make test`` in hardware, as others have the rest."""

    environments = (MEADOW.name,)
    devices = ("rtl", "lockstep", "reference") if sampling.exhaustive else ("rtl",)

    @pytest.fixture
    def case(self, env_id: str, device_name: str) -> Iterator[Case]:
        case = TwoSizesCase(env_id, device_name)
        yield case
        case.close()


@pytest.mark.usefixtures("toys")
class TestWorldsInEveryForm(ContractSuite):
    """Agents of several roles that end one by one, and those that take turns."""

    environments = tuple(spec.name for spec in WORLDS)
    devices = ("native",)


@pytest.mark.usefixtures("toys")
class TestFieldsInEveryForm(ContractSuite):
    """Actions of several fields, and observations of several numbers or flags."""

    environments = tuple(spec.name for spec in FIELDS) if sampling.exhaustive else (ROVER.name, RELAY.name)
    devices = ("native",)


@pytest.mark.usefixtures("toys")
class TestFields(DeviceSuite):
    """The same wherever they step: fields of one agent, and of two, side by side in a word."""

    environments = (ROVER.name, RELAY.name)
    devices = ("rtl", "reference")


class ShortCase(Case):
    """Steps are few, as a simulated GPU takes a hundredth of a second for each."""

    def actions(self, steps: int = STEPS, n: int = SIZE, seed: int = 0) -> Any:
        return super().actions(min(steps, STEPS // 2), n, seed)

    def habits(self, steps: int = STEPS, n: int = SIZE) -> Any:
        return super().habits(min(steps, STEPS // 2), n)


@pytest.mark.exhaustive
@pytest.mark.usefixtures("toys")
class TestGpu(ContractSuite):
    """A GPU, or where there is none the simulator, which is slow: one small environment that draws.

    There ``make test-cuda`` has all the steps, as everywhere else.
    """

    environments = ("Ladder",)
    devices = ("cuda",)

    @pytest.fixture
    def case(self, env_id: str, device_name: str, request: pytest.FixtureRequest) -> Iterator[Case]:
        short = simulated() and not request.config.getoption("--simulated-gpu")
        case = (ShortCase if short else Case)(env_id, device_name)
        yield case
        case.close()


@pytest.mark.simulatable
class TestGpuEnvironments(ContractSuite):
    """Every environment on a GPU; what the simulator has no time for in every run of the tests.

    ``tests/devices/test_cuda.py`` holds every environment on it against the reference.
    """

    environments = tuple(pearl_marl.list_envs())
    devices = ("cuda",)


@pytest.mark.simulatable
@pytest.mark.usefixtures("toys")
class TestGpuWorlds(DeviceSuite):
    """Slots of several agents on a GPU; ``tests/devices/test_worlds.py`` has a few of them simulated."""

    environments = (MEADOW.name,)
    devices = ("cuda",)


MADE: dict[str, Callable[[int], Device]] = {
    "xdma": lambda n: OwnBoard(3 if n > HALF else 1),
    "sharded": lambda n: Sharded(["native", "native"] if n > 1 else ["native"]),
}
"""Devices that no name alone makes, by the number of their slots."""


class MadeCase(Case):
    sizes, splits = (HALF, SIZE), (HALF,)

    def device(self, n: int = SIZE, **options: Any) -> Device:
        return MADE[self.device_name](n)


class TestLinks(ContractSuite):
    """A board behind files, and slots shared among devices, with the environment that draws most.

    ``tests/devices/test_sharded.py`` has more of the second, so in ``make test`` there is only the board.
    """

    environments = ("Blackjack",)
    devices = tuple(MADE) if sampling.exhaustive else ("xdma",)

    @pytest.fixture
    def case(self, env_id: str, device_name: str) -> Iterator[Case]:
        case = MadeCase(env_id, device_name)
        yield case
        case.close()
