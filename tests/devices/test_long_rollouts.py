"""Rollouts of 1,000 steps are as many single steps, of every environment, on devices of every kind."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from typing import Any

import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

import pearl_marl
from pearl_marl.devices import Device, Lockstep, Native, Rtl, Sharded
from pearl_marl.devices.ray import Ray
from pearl_marl.errors import ArgumentError
from pearl_marl.hardware.build import Build
from pearl_marl.hardware.engines import with_engine
from pearl_marl.memory_map import Engine
from pearl_marl.policies.integer_network import IntegerNetwork

from ..rtl.random_policies import random_network as network
from ..rtl.random_policies import random_table
from .rolling import NETWORK, TABLE, Stepping, assert_same, assert_same_place, opened, policy_for

pytestmark = pytest.mark.exhaustive

STEPS = 1_000

ON_THE_CPU: list[Callable[[], Device]] = [
    lambda: Native(threads=1),
    lambda: Lockstep(Native(threads=2), Sharded([Native(threads=1), Native(threads=1)])),
]
"""Devices whose rollouts are one call; lockstep compares what both of its devices did."""


@pytest.mark.parametrize("n_agents", [1, 1_000, 43_008])
@pytest.mark.parametrize("name", pearl_marl.list_envs())
def test_one_call_is_single_steps(name: str, n_agents: int) -> None:
    policy = policy_for(name)
    worlds = -(-n_agents // policy.spec.agents)
    slow = opened(Stepping(), name, worlds)
    due = slow.rollout(policy, STEPS)
    for make in ON_THE_CPU if worlds > 1 else ON_THE_CPU[:1]:  # a shard needs a world
        fast = opened(make(), name, worlds)
        assert_same(fast.rollout(policy, STEPS), due)
        assert_same_place(fast, slow)
        fast.close()


@pytest.mark.parametrize("mode", [AutoresetMode.SAME_STEP, AutoresetMode.NEXT_STEP])
@pytest.mark.parametrize("how", [{}, {"max_cycles": 37}, {"initial_states": "stored"}])
@pytest.mark.parametrize("name", pearl_marl.list_envs())
def test_limits_starts_and_resets(name: str, how: dict[str, Any], mode: AutoresetMode) -> None:
    policy = policy_for(name)
    n, how = -(-1_000 // policy.spec.agents), how | {"autoreset_mode": mode}
    slow = opened(Stepping(), name, n, **how)
    due = slow.rollout(policy, STEPS)
    for make in ON_THE_CPU:
        fast = opened(make(), name, n, **how)
        assert_same(fast.rollout(policy, STEPS), due)
        assert_same_place(fast, slow)
        fast.close()


@pytest.mark.usefixtures("ray_cluster")
@pytest.mark.parametrize(
    ("name", "n_agents"),
    [
        *((name, 1_000) for name in pearl_marl.list_envs()),
        *((name, 43_008) for name in ("CliffWalking", "ConnectFour", "LevelBasedForaging", "Seaquest")),
    ],
)
def test_in_a_cluster(name: str, n_agents: int) -> None:
    policy = policy_for(name)
    n = -(-n_agents // policy.spec.agents)
    shared, alone = opened(Ray(["native", "native"]), name, n), opened(Native(), name, n)
    assert_same(shared.rollout(policy, STEPS), alone.rollout(policy, STEPS))
    assert_same_place(shared, alone)
    shared.close()


@pytest.mark.parametrize("name", pearl_marl.list_envs())
def test_in_simulated_hardware(name: str) -> None:
    """By the policy engine, of those policies that one takes, else through the host."""
    policy, n = policy_for(name), 3
    build = Build.of(policy.spec, n)
    with suppress(ArgumentError):  # which says why no engine takes the policy
        build = with_engine(build, policy)
    layout = build.layout
    hardware = opened(Rtl(layout.pe_num, layout.data_wl, engine=layout.engine), name, n)
    slow = opened(Stepping(), name, n)
    assert_same_in_hardware(hardware, slow, policy, STEPS)


@pytest.mark.parametrize(
    ("name", "engine", "hidden", "n", "steps"),
    [
        *(("CliffWalking", TABLE, None, n, STEPS) for n in (1, 1_000, 43_008)),
        *(("CartPole", NETWORK, [8, 6], n, steps) for n, steps in ((1, STEPS), (1_000, STEPS), (43_008, 20))),
        *(("LevelBasedForaging", NETWORK, [8], n, STEPS) for n in (1, 1_000)),
    ],
)
def test_many_slots_in_simulated_hardware(
    name: str, engine: Engine, hidden: list[int] | None, n: int, steps: int
) -> None:
    spec, random = pearl_marl.get_spec(name), np.random.default_rng(24)
    policy = random_table(random, spec, 6, True) if hidden is None else network(random, spec, hidden, True)
    assert_same_in_hardware(opened(Rtl(engine=engine), name, n), opened(Native(), name, n), policy, steps)


def assert_same_in_hardware(hardware: Device, other: Device, policy: IntegerNetwork, steps: int) -> None:
    """Compare a rollout on both; hardware has the sums of all agents together. Closes both."""
    found, due = hardware.rollout(policy, steps), other.rollout(policy, steps)
    assert (found.episodes, found.truncated.sum()) == (due.episodes, due.truncated.sum())
    assert found.lengths.sum() == due.lengths.sum()
    assert found.returns.sum() == pytest.approx(due.returns.sum(), rel=1e-12)
    assert np.array_equal(hardware.snapshot().memory, other.snapshot().memory)
    hardware.close()
    other.close()
