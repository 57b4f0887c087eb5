"""Policy engines for golden functions: rollouts in hardware equal those of the CPU, as fast as said."""

from __future__ import annotations

from typing import Any
from unittest import mock

import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

from pearl_marl import get_spec
from pearl_marl.devices import BatchConfig, Device, Lockstep, Native, Rtl, Serial, Sharded
from pearl_marl.devices.comm_bram import CommBram
from pearl_marl.devices.identity import check_identity, identity, stated_map
from pearl_marl.errors import ArgumentError, DeviceError
from pearl_marl.golden import Draws
from pearl_marl.hardware import elaboration
from pearl_marl.hardware.build import Build
from pearl_marl.hardware.policy_words import policy_words
from pearl_marl.latency import rollout_step_cycles
from pearl_marl.memory_map import ENGINE_KINDS, Engine, Statistics, memory_map
from pearl_marl.policies.golden_policy import GoldenPolicy
from pearl_marl.spec import EnvSpec

from ..policies.rules import balance, bet, brake, catch, drive, up, walk
from ..rtl.random_policies import random_table
from ..toy_fields import RELAY
from ..toy_world import MEADOW, NIM
from .boards import OwnBoard
from .test_engines import Simulated
from .test_serial import Fake

SPEC = get_spec("CliffWalking")
NEXT = AutoresetMode.NEXT_STEP


def graze(view: Any, draws: Draws) -> Any:
    """Mostly rest where strong, else anywhere; masks forbid some of it."""
    anywhere, tired = draws.below(5), draws.bits(2) > 0
    return 4 if tired and view.energy + view.other < 12 else anywhere


def take(view: Any, draws: Draws) -> Any:
    """Leave a multiple of four."""
    rest = view.heap % 4
    return 0 if rest == 0 else rest - 1


def relay(view: Any, draws: Draws) -> Any:
    """An action of two fields: how far to run, and whether to pass on."""
    return draws.below(5), view.own == view.other or view.waits


def golden(policy: GoldenPolicy) -> Engine:
    return Engine("golden", function=policy)


def opened(device: Device, spec: EnvSpec, **settings: Any) -> Device:
    device.open(BatchConfig(spec=spec, **settings))
    device.reset(seed=3)
    return device


def assert_same(ours: Device, theirs: Device, policy: GoldenPolicy, steps: int) -> int:
    found, due = ours.rollout(policy, steps), theirs.rollout(policy, steps)
    assert (found.episodes, found.truncated.sum()) == (due.episodes, due.truncated.sum())
    assert found.lengths.sum() == due.lengths.sum()
    # The CPU adds up an episode's rewards in single precision, the hardware exactly.
    inexact = 1e-6 * (policy.spec.reward.fraction > 8)
    assert found.returns.sum() == pytest.approx(due.returns.sum(), rel=inexact, abs=0)
    assert ours.tick == theirs.tick
    assert np.array_equal(ours.snapshot().memory, theirs.snapshot().memory)
    return found.episodes


CASES = [
    # Masks, draws, and agents that end one by one.
    (MEADOW, graze, {"n_envs": 7, "max_cycles": 20, "autoreset_mode": NEXT, "first_slot": 5}, 4),
    *(
        pytest.param(*case, marks=pytest.mark.exhaustive)
        for case in (
            (MEADOW, graze, {"n_envs": 7}, 2),
            (NIM, take, {"n_envs": 60, "max_cycles": 9}, 8),
            (RELAY, relay, {"n_envs": 9, "max_cycles": 11}, 4),
            (SPEC, walk, {"n_envs": 1, "max_cycles": 20}, 1),
            (SPEC, walk, {"n_envs": 300, "max_cycles": 20, "initial_states": "stored"}, 4),
            (get_spec("CartPole"), balance, {"n_envs": 300, "max_cycles": 30}, 4),
            (get_spec("CartPole"), balance, {"n_envs": 1, "max_cycles": 9, "autoreset_mode": NEXT}, 1),
            (get_spec("Pendulum"), brake, {"n_envs": 9, "max_cycles": 7}, 2),
            (get_spec("MountainCarContinuous"), drive, {"n_envs": 9, "max_cycles": 7}, 2),
            (get_spec("Catch"), catch, {"n_envs": 200, "max_cycles": 40}, 16),
            (get_spec("Game2048"), up, {"n_envs": 20, "max_cycles": 15}, 4),
            (get_spec("KuhnPoker"), bet, {"n_envs": 100, "max_cycles": 9}, 8),
        )
    ),
]


@pytest.mark.parametrize(
    ("spec", "act", "settings", "pe_num"), CASES, ids=lambda part: getattr(part, "name", None)
)
def test_a_rollout_is_that_of_the_cpu(spec: EnvSpec, act: Any, settings: dict[str, Any], pe_num: int) -> None:
    policy = GoldenPolicy(spec, act)
    hardware = opened(Rtl(pe_num, engine=golden(policy)), spec, **settings)
    native = opened(Native(), spec, **settings)
    layout = memory_map(spec, settings["n_envs"], pe_num, 32, golden(policy))
    taken, episodes = [], 0
    for steps in (50, 20, 21):
        episodes += assert_same(hardware, native, policy, steps)
        taken.append(hardware.cycles)
    assert taken[2] - taken[1] == rollout_step_cycles(spec, layout)
    assert episodes
    # What follows: a reset of some slots.
    mask = np.arange(settings["n_envs"]) % 2 == 0
    hardware.reset(mask=mask)
    native.reset(mask=mask)
    assert_same(hardware, native, policy, 5)
    hardware.close()
    native.close()


def right(place: Any, draws: Draws) -> Any:
    return 1


def test_a_board_says_which_function_it_has() -> None:
    """So the host refuses another one, and takes the same one made anew."""
    policy, other = GoldenPolicy(SPEC, walk), GoldenPolicy(SPEC, right)
    device = opened(OwnBoard(4, 32, engine=golden(policy)), SPEC, n_envs=7, max_cycles=13)
    native = opened(Native(), SPEC, n_envs=7, max_cycles=13)
    assert device.has_engine
    assert_same(device, native, GoldenPolicy(SPEC, walk), 30)
    table = random_table(np.random.default_rng(0), SPEC, 6, drawn=False)
    for wrong, sentence in (
        (other, f"computes the golden function {policy.number:#x}, and this is {other.number:#x}"),
        (table, "computes a golden function, and this policy is a IntegerNetwork"),
    ):
        with pytest.raises(ArgumentError, match=sentence):
            device.rollout(wrong, 3)
    assert_same(device, native, policy, 30)
    device.close()


@pytest.mark.parametrize("way", ["serial", "sharded", "lockstep"])
def test_an_engine_is_found_behind_every_link(way: str) -> None:
    """And does the rollouts: the host does no step of them."""
    policy = GoldenPolicy(SPEC, walk)
    engine, settings = golden(policy), {"n_envs": 7, "max_cycles": 13}
    fake = Fake()
    device: Device
    if way == "serial":
        fake.memory = Simulated(engine)  # type: ignore[assignment]
        device = Serial(fake.port, timeout=20)
    elif way == "sharded":
        settings["n_envs"] = 8
        device = Sharded([OwnBoard(2, 32, engine=engine), Rtl(2, 32, engine=engine)])
    else:
        device = Lockstep(Rtl(4, 32, engine=engine), "reference")
    opened(device, SPEC, **settings)
    native = opened(Native(), SPEC, **settings)
    assert device.has_engine
    with mock.patch.object(CommBram, "_step", side_effect=AssertionError("a step by the host")):
        assert assert_same(device, native, policy, 30)
    device.close()
    fake.unplug()


def test_functions_have_the_same_number_if_they_do_the_same() -> None:
    def also_right(where: Any, chance: Draws) -> Any:
        anywhere = where & 0
        return anywhere + 1

    numbers = [GoldenPolicy(SPEC, act).number for act in (right, also_right, walk)]
    assert numbers[0] == numbers[1] != numbers[2]


def test_what_cannot_be_built_is_said() -> None:
    policy = GoldenPolicy(SPEC, walk)
    table = Engine("table", table_rows=64, logit_bits=8)
    with pytest.raises(ArgumentError, match="takes tables of integers, and this policy is a golden function"):
        policy_words(policy, table)
    with pytest.raises(ArgumentError, match=r"is built of its policy, and this one has the number 5: give"):
        elaboration.sources(SPEC, engine=Engine("golden", stated=5))
    lake = get_spec("FrozenLake")
    with pytest.raises(ArgumentError, match=r"is for CliffWalking-v0 with .*, and the build for FrozenLake"):
        elaboration.sources(lake, engine=golden(policy))


def test_what_hardware_states_is_read_again() -> None:
    engine, other = golden(GoldenPolicy(SPEC, walk)), golden(GoldenPolicy(SPEC, right))
    build = Build.of(SPEC, 7, 4, 32, engine)
    memory = np.zeros(build.layout.end("statistics") // 4, np.uint32)
    memory[: len(identity(build))] = identity(build)
    at = build.layout["statistics"].offset // 4 + Statistics.ENGINE
    memory[at : at + len(engine.words)] = engine.words

    def read(offset: int, data: Any) -> None:
        data[:] = memory.view(np.uint8)[offset : offset + data.size]

    stated = stated_map(read, SPEC, 7)
    assert stated == memory_map(SPEC, 7, 4, 32, engine._replace(function=None, stated=engine.number))
    check_identity("xdma", read, Build(SPEC, stated))
    check_identity("xdma", read, build)
    with pytest.raises(DeviceError, match="another policy engine than this batch has been opened for"):
        check_identity("xdma", read, Build.of(SPEC, 7, 4, 32, other))
    kind = ENGINE_KINDS.index("golden")
    assert Engine.of_words(kind, engine.words) == engine._replace(function=None, stated=engine.number)
    first, *sizes = engine.words
    for words in ([first | 1, *sizes], [first, 0, *sizes[1:]]):
        with pytest.raises(DeviceError, match="states an impossible policy engine"):
            Engine.of_words(kind, words)
    with pytest.raises(DeviceError, match="states an impossible policy engine"):
        Engine.of_words(1, engine.words)
