"""Rollouts in simulated hardware: equal to steps one by one, and as fast as the formula says."""

from __future__ import annotations

import dataclasses
import itertools
from typing import Any
from unittest import mock

import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

from pearl_marl import get_spec
from pearl_marl.devices import BatchConfig, Native, Rtl, make_device
from pearl_marl.devices.base import Device
from pearl_marl.errors import ArgumentError, DeviceError
from pearl_marl.hardware.policy_words import policy_words, quanta
from pearl_marl.latency import rollout_step_cycles, step_cycles
from pearl_marl.memory_map import (
    STATISTICS_WORDS,
    Control,
    Engine,
    Mode,
    Statistics,
    Status,
    StatusError,
    memory_map,
)
from pearl_marl.policies.device_policy import policy_draws
from pearl_marl.policies.integer_network import AgentNetworks, IntegerNetwork

from ..rtl.random_policies import random_network, random_planes, random_table
from ..toy_world import MEADOW
from .rolling import NETWORK, TABLE

PLANES = NETWORK._replace(kind="planes", filters=6)
NEXT, SAME = AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP


class Expected:
    """Sums over the episodes of agents that are stepped one by one, ``agents`` in each of ``n`` worlds."""

    def __init__(self, n: int, agents: int) -> None:
        self.running, self.length = np.zeros((n, agents)), np.zeros((n, agents), int)
        # Whether an agent has ended in this episode, and whether its world spends the next step resetting.
        self.over, self.resetting = np.zeros((n, agents), bool), np.zeros(n, bool)
        self.begin(True)

    def begin(self, limited: bool) -> None:
        """Begin a rollout: what has begun before does not count; without a time limit it does from here."""
        if not limited:
            self.running[:] = self.length[:] = 0
        self.whole = self.length == 0
        self.returns = self.lengths = self.ended = self.truncated = 0

    def step(self, result: Any, resets: bool) -> None:
        """Take up a step; with ``resets`` worlds that ended spend the next one resetting."""
        rewards, terminated, truncated = (
            np.asarray(part).reshape(self.over.shape)
            for part in (result.rewards, result.terminations, result.truncations)
        )
        part = ~self.over & ~self.resetting[:, None]
        self.resetting[:] = False
        self.running[part] += rewards[part]
        self.length[part] += 1
        ends = part & (terminated | truncated).astype(bool)
        counted = ends & self.whole
        self.returns += self.running[counted].sum()
        self.lengths += self.length[counted].sum()
        self.ended += counted.sum()
        self.truncated += (counted & ~terminated.astype(bool)).sum()
        self.over |= ends
        worlds = self.over.all(1)
        self.over[worlds], self.resetting[worlds] = False, resets
        # An agent that ends before its world begins with it again.
        self.running[ends], self.length[ends], self.whole[ends] = 0, 0, True


def step_by_step(device: Device, obs: Any, policy: IntegerNetwork, steps: int, sums: Expected) -> Any:
    """Act and step; return what is observed at the end."""
    spec, n = policy.spec, device.config.n_envs
    slots, agents = np.repeat(np.arange(n, dtype=np.uint32), spec.agents), np.tile(np.arange(spec.agents), n)
    slots += np.uint32(device.config.first_slot)
    sums.begin(device.config.limit > 0)
    for _ in range(steps):
        draws = policy_draws(policy.draws, device.seed, device.tick, slots, agents, spec.agents)
        choice = policy.choose(np.asarray(obs), agents, device.action_masks, draws)
        result = device.step(choice.words[:, 0])
        sums.step(result, device.config.autoreset_mode is NEXT)
        obs = result.observed.obs
    return obs


CASES = [
    ("CartPole", NETWORK, [8, 6], {"n_envs": 37}, 64),
    ("CartPole", NETWORK, [8, 6], {"n_envs": 37, "max_cycles": 0}, 64),
    ("CliffWalking", TABLE, None, {"n_envs": 7, "max_cycles": 13, "first_slot": 5}, 32),
    # Planes, which the host unpacks for others.
    ("Breakout", PLANES, [8], {"n_envs": 19, "max_cycles": 15}, 64),
    # Agents that end one by one.
    ("Meadow", NETWORK, [8], {"n_envs": 7, "max_cycles": 20, "autoreset_mode": NEXT}, 32),
    *(
        pytest.param(*case, marks=pytest.mark.exhaustive)
        for case in (
            ("CartPole", NETWORK, [5], {"n_envs": 37, "max_cycles": 9, "autoreset_mode": NEXT}, 1024),
            ("CartPole", NETWORK, [], {"n_envs": 37, "initial_states": "stored"}, 64),
            ("CartPole", NETWORK._replace(products=3, side=1, drawn=False), [8], {"n_envs": 9}, 64),
            ("Meadow", NETWORK, [8], {"n_envs": 7}, 32),
            # Masks, and rewards that are no whole numbers.
            ("LevelBasedForaging", NETWORK, [8], {"n_envs": 7, "max_cycles": 20}, 32),
            ("ConnectFour", PLANES._replace(products=3), [8, 5], {"n_envs": 7, "autoreset_mode": NEXT}, 64),
            (
                "LevelBasedForaging",
                NETWORK,
                [8],
                {"n_envs": 7, "max_cycles": 20, "autoreset_mode": NEXT},
                32,
            ),
            ("RobotWarehouse", NETWORK, [8], {"n_envs": 3, "max_cycles": 11}, 32),
            ("Seaquest", PLANES, [8], {"n_envs": 9, "max_cycles": 25}, 64),
            ("FrozenLake", TABLE, None, {"n_envs": 20}, 32),
            ("Blackjack", TABLE._replace(table_rows=1024), None, {"n_envs": 20}, 32),
            (
                "Taxi",
                TABLE._replace(table_rows=512),
                None,
                {"n_envs": 20, "max_cycles": 17, "autoreset_mode": NEXT, "initial_states": "stored"},
                32,
            ),
        )
    ),
]


@pytest.mark.parametrize(
    ("device", "mode"),
    [
        *itertools.product(["native", "reference"], [AutoresetMode.SAME_STEP, NEXT]),
        ("cuda", NEXT),
        pytest.param("cuda", AutoresetMode.SAME_STEP, marks=pytest.mark.exhaustive),
    ],
)
def test_agents_that_end_one_by_one_are_counted(mode: AutoresetMode, device: str) -> None:
    """As by the count of single steps, which shares nothing with those of rollouts; also begun at a reset."""
    if device == "cuda":
        pytest.importorskip("numba_cuda", reason="numba-cuda is not installed: pip install '.[cuda]'")
    settings: dict[str, Any] = {"spec": MEADOW, "n_envs": 5, "max_cycles": 20, "autoreset_mode": mode}
    policy = random_network(np.random.default_rng(2), MEADOW, [8], False)
    rolling, stepping = make_device(device), Native()
    rolling.open(BatchConfig(**settings))
    stepping.open(BatchConfig(**settings | {"spec": MEADOW.in_elements}))
    rolling.reset(seed=3)
    obs, due = stepping.reset(seed=3), Expected(5, MEADOW.agents)
    for steps in (45, 1, 1, 1, 1, 1, 40):
        found = rolling.rollout(policy, steps)
        obs = step_by_step(stepping, obs, policy, steps, due)
        assert (found.episodes, found.truncated.sum()) == (due.ended, due.truncated)
        assert (found.lengths.sum(), found.returns.sum()) == (due.lengths, due.returns)


@pytest.mark.parametrize(("env", "engine", "hidden", "settings", "data_wl"), CASES)
def test_a_rollout_is_its_steps(
    env: str, engine: Engine, hidden: list[int] | None, settings: dict[str, Any], data_wl: int
) -> None:
    spec = MEADOW if env == "Meadow" else get_spec(env)
    random = np.random.default_rng(24)
    pe_num = min(4, settings["n_envs"])
    hardware, native = Rtl(pe_num, data_wl, engine=engine), Native()
    hardware.open(BatchConfig(spec=spec, **settings))
    native.open(BatchConfig(spec=spec.in_elements, **settings))
    hardware.reset(seed=3)
    obs, sums = native.reset(seed=3), Expected(native.config.n_envs, spec.agents)
    widths = [engine.inputs(spec), *(hidden or []), *spec.action_counts]
    layout = memory_map(spec, settings["n_envs"], pe_num, data_wl, engine)
    cycles = rollout_step_cycles(spec, layout, widths)
    last = episodes = 0
    for steps, drawn in ((50, engine.drawn), (1, engine.drawn), (20, False), (21, False)):
        if not drawn or steps == 50:
            policy = (
                random_table(random, spec, 6, drawn)
                if hidden is None
                else random_planes(random, spec, int(random.integers(4, 7)), hidden, drawn)
                if engine.kind == "planes"
                else random_network(random, spec, hidden, drawn)
            )
        found = hardware.rollout(policy, steps)
        obs = step_by_step(native, obs, policy, steps, sums)
        assert (found.episodes, *found.truncated) == (sums.ended, sums.truncated)
        assert (found.lengths.sum(), found.returns.sum()) == (sums.lengths, sums.returns)
        episodes += found.episodes
        assert hardware.tick == native.tick
        assert np.array_equal(hardware.snapshot().memory, native.snapshot().memory)
        assert np.array_equal(hardware.in_episode, native.in_episode)
        if native.action_masks is not None:
            assert np.array_equal(hardware.action_masks, native.action_masks)
        if steps == 21:
            # Of a layer alone, what comes in and what goes out get in each other's way.
            off = 0 if hidden != [] else 0.02 * cycles
            assert abs(hardware.cycles - last - cycles) <= off
        last = hardware.cycles
    assert episodes or settings.get("initial_states")
    # What follows: a reset of some slots, a rollout, and steps.
    mask = np.arange(settings["n_envs"]) % 2 == 0
    hardware.reset(mask=mask)
    obs = native.reset(mask=mask)
    hardware.rollout(policy, 5)
    step_by_step(native, obs, policy, 5, sums)
    idle = [0] * native.config.n_agents
    if native.action_masks is not None:
        idle = native.action_masks.argmax(1).tolist()
    ours, theirs = hardware.step(idle), native.step(idle)
    if env == "CliffWalking":  # no random numbers are waited for
        assert hardware.cycles == step_cycles(spec, layout), "a step is as fast as without an engine"
    assert np.array_equal(ours.rewards, theirs.rewards)
    assert np.array_equal(hardware.snapshot().memory, native.snapshot().memory)
    hardware.close()
    native.close()


def test_nothing_but_sums_crosses_the_link() -> None:
    """Of a rollout with the policy that is there already: settings, a doorbell, status and sums."""
    spec = get_spec("CliffWalking")
    policy = random_table(np.random.default_rng(0), spec, 6, drawn=False)
    device = Rtl(4, 32, engine=TABLE)
    device.open(BatchConfig(spec=spec, n_envs=7, max_cycles=13))
    device.reset(seed=3)
    device.rollout(policy, 5)
    transport, layout = device._protocol.transport, memory_map(spec, 7, 4, 32, TABLE)
    moved: dict[str, set[str]] = {"read": set(), "write": set()}
    counts = {"read": 0, "write": 0}

    def counting(way: str) -> Any:
        real = getattr(transport, way)

        def move(offset: int, data: Any) -> None:
            region = next(r for r in layout.regions if r.offset <= offset < layout.end(r.name))
            moved[way].add(region.name)
            counts[way] += data.nbytes * (region.name != "status")
            real(offset, data)

        return move

    with mock.patch.multiple(transport, read=counting("read"), write=counting("write")):
        device.rollout(policy, 400)
    assert moved == {"read": {"status", "statistics"}, "write": {"control", "policy", "doorbell"}}
    assert counts["read"] == 4 * Statistics.ENGINE
    assert counts["write"] < 100
    device.close()


def test_without_an_engine_the_host_acts() -> None:
    spec = get_spec("CliffWalking")
    policy = random_table(np.random.default_rng(0), spec, 8, drawn=True)
    results = []
    for device in (Rtl(4, 32), Native()):
        device.open(BatchConfig(spec=spec, n_envs=7, max_cycles=9))
        device.reset(seed=1)
        results.append((device.rollout(policy, 30), device.snapshot().memory))
        device.close()
    (ours, memory), (theirs, wanted) = results
    assert np.array_equal(ours.returns, theirs.returns)
    assert np.array_equal(ours.lengths, theirs.lengths)
    assert np.array_equal(memory, wanted)


def test_what_an_engine_does_not_take_is_said() -> None:
    random = np.random.default_rng(25)
    cart, cliff = get_spec("CartPole"), get_spec("CliffWalking")
    network, table = (
        random_network(random, cart, [8, 8], drawn=True),
        random_table(random, cliff, 8, drawn=False),
    )
    assert policy_words(network, NETWORK)
    assert policy_words(table, TABLE)
    planes = random_planes(random, get_spec("Breakout"), 6, [8, 8], drawn=True)
    assert policy_words(planes, PLANES)
    colours, floats = (
        random_planes(random, get_spec(name), 6, [8, 8], drawn=True) for name in ("MiniGridEmpty", "Snake")
    )
    apart = AgentNetworks(
        tuple(random_network(random, MEADOW, [8], drawn=False) for _ in range(MEADOW.agents))
    )
    wide = dataclasses.replace(table, layers=(table.layers[0]._replace(bias=np.full(4, 200, np.int32)),))
    two = tuple(
        layer._replace(activation=np.full(1024, k, np.int16)) for k, layer in enumerate(network.layers[:2])
    )
    for policy, engine, sentence in (
        (network, NETWORK._replace(drawn=False), "takes the best action, and this policy draws"),
        (network, TABLE, "takes tables, and this policy is a network"),
        (table, NETWORK, "takes networks, and this policy is a table"),
        (network, PLANES, "takes networks on planes, and this policy is a network;"),
        (planes, NETWORK, "the host unpacks those of Breakout-v.; take Engine..planes"),
        (planes, TABLE, "the host unpacks those of Breakout-v.; take Engine..planes"),
        (colours, PLANES, "takes planes of 0 and 1, and observations of MiniGridEmpty.* reach 255;"),
        (floats, PLANES, "takes planes of 0 and 1, and observations of Snake.* are float32"),
        (apart, NETWORK, "no policy engine takes a network for each agent of a world"),
        (planes, PLANES._replace(filters=5), "has 5 filters, and this policy 6"),
        (planes, PLANES._replace(weight_bits=4), "has weights of 4 bits, and this policy has"),
        (network, NETWORK._replace(layers=2), "has 2 layers, and this policy 3"),
        (network, NETWORK._replace(hidden=4), "has layers of 4 units, and this policy one of 8"),
        (network, NETWORK._replace(weight_bits=4), "has weights of 4 bits, and this policy has"),
        (network, NETWORK._replace(value_bits=8), "has inputs of 8 bits, and this policy has"),
        (table, TABLE._replace(table_rows=63), "has room for 63 rows, and this table has 64"),
        (wide, TABLE, "has logits of 8 bits, and this policy has"),
        (dataclasses.replace(network, layers=(*two, network.layers[2])), NETWORK, "one table of activations"),
    ):
        with pytest.raises(ArgumentError, match=sentence):
            policy_words(policy, engine)
    for env, sentence in (
        ("Seaquest", "the host unpacks those of Seaquest-v.; take Engine..planes"),
        ("Pendulum", "one of so many actions"),
    ):
        of_env = object.__new__(IntegerNetwork)
        object.__setattr__(of_env, "spec", get_spec(env))
        with pytest.raises(ArgumentError, match=sentence):
            policy_words(of_env, NETWORK)
    with pytest.raises(
        ArgumentError, match=r"observations of CartPole-v. have the shape \(4,\); take another"
    ):
        memory_map(cart, 4, 4, 64, PLANES)


def test_rewards_become_whole_numbers() -> None:
    spec = get_spec("CliffWalking")
    for rewards in ([-1.0, -100.0], [0.5, -0.75], [0.1, 3.0], [0.0, 0.0]):
        table = np.array(rewards, np.float32)
        words, quantum = quanta(spec, table, 1000)
        numbers = [int(low) | int(high) << 32 for low, high in words.reshape(-1, 2)]
        signed = [number - (1 << 64 if number >> 63 else 0) for number in numbers]
        assert [number * quantum for number in signed] == table.tolist()
    with pytest.raises(ArgumentError, match="too much to add up 1,000 of them"):
        quanta(spec, np.array([1e-30, 1.0], np.float32), 1000)


def test_a_rollout_tells_how_far_it_is_and_a_reset_ends_it() -> None:
    spec, random = get_spec("CliffWalking"), np.random.default_rng(26)
    policy = random_table(random, spec, 6, drawn=True)
    device = Rtl(4, 32, engine=TABLE)
    device.open(BatchConfig(spec=spec, n_envs=7, max_cycles=13))
    device.reset(seed=3)
    first = device.rollout(policy, 30)
    layout, transport = memory_map(spec, 7, 4, 32, TABLE), device._protocol.transport

    def words(region: str, count: int) -> Any:
        found = np.zeros(4 * count, np.uint8)
        transport.read(layout[region].offset, found)
        return found.view("<u4")

    # A rollout of very many steps, of which none is waited for.
    transport.write(4 * Control.STEPS, np.array([1 << 30], "<u4").view(np.uint8))
    sequence = int(words("status", 1)[0])
    doorbell = np.array([Mode.ROLLOUT, sequence + 1], "<u4").view(np.uint8)
    transport.write(layout["doorbell"].offset, doorbell)
    done = [int(words("statistics", STATISTICS_WORDS)[Statistics.STEPS]) for _ in range(60)]
    assert done == sorted(done)
    assert 0 < done[-1] < 1 << 30
    assert words("status", 1)[0] == sequence, "the rollout is not over"
    with pytest.raises(DeviceError, match="the hardware refused a transfer"):
        transport.write(layout["policy"].offset, np.zeros(4, np.uint8))
    transport.write(4 * Control.RESET, np.array([1], "<u4").view(np.uint8))
    for _ in range(20):
        words("status", 3)
    assert words("status", 3)[Status.ERROR] == StatusError.RESET
    device.reset(seed=3)
    again = device.rollout(policy, 30)
    assert (again.episodes, again.returns.sum()) == (first.episodes, first.returns.sum())
    device.close()
